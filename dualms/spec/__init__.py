"""The specification of a design: what a client sends beside the domain file.

Every field has a default (but ``units`` and the ports), bounds, a unit and its source: a section of the paper, or
"ours" with the reason. Lengths are in the specification's ``units``. Unknown keys are refused.
"""

from dualms.spec.body import (
    GradedAlong,
    GradedAround,
    PicturesSpec,
    ShellSpec,
    SurfaceSpec,
    WallFraction,
    WallGraded,
    WallSpec,
    WallThickness,
)
from dualms.spec.evaluation import EvaluationSpec
from dualms.spec.field import (
    NEURAL_PRESETS,
    AutoField,
    DistilledField,
    FieldSpec,
    NetworkField,
    NeuralField,
    PhaseField,
)
from dualms.spec.flow import DirectionFlow, FlowSpec, NoFlow, PathFlow, PotentialFlow
from dualms.spec.fluids import ColdFluidSpec, FluidSpec, FluidsSpec
from dualms.spec.graph import GRAPH_PRESETS, GraphSpec
from dualms.spec.model import Model, Point, Vector
from dualms.spec.output import MeshFormat, OutputSpec
from dualms.spec.partition import PartitionSpec
from dualms.spec.ports import BoxPort, DiskPort, FacetPort, FlangeSpec, HeaderSpec, PortSpec
from dualms.spec.require import RequireSpec
from dualms.spec.self_support import SelfSupportSpec
from dualms.spec.spec import Spec
from dualms.spec.units import Unit

__all__ = [
    "GRAPH_PRESETS",
    "NEURAL_PRESETS",
    "AutoField",
    "BoxPort",
    "ColdFluidSpec",
    "DirectionFlow",
    "DiskPort",
    "DistilledField",
    "EvaluationSpec",
    "FacetPort",
    "FieldSpec",
    "FlangeSpec",
    "FlowSpec",
    "FluidSpec",
    "FluidsSpec",
    "GradedAlong",
    "GradedAround",
    "GraphSpec",
    "HeaderSpec",
    "MeshFormat",
    "Model",
    "NetworkField",
    "NeuralField",
    "NoFlow",
    "OutputSpec",
    "PartitionSpec",
    "PathFlow",
    "PhaseField",
    "PicturesSpec",
    "Point",
    "PortSpec",
    "PotentialFlow",
    "RequireSpec",
    "SelfSupportSpec",
    "ShellSpec",
    "Spec",
    "SurfaceSpec",
    "Unit",
    "Vector",
    "WallFraction",
    "WallGraded",
    "WallSpec",
    "WallThickness",
]
