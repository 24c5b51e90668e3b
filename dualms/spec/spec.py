"""The whole specification."""

from __future__ import annotations

from pydantic import Field, model_validator

from dualms.spec.body import PicturesSpec, ShellSpec, SurfaceSpec, WallSpec, WallThickness
from dualms.spec.evaluation import EvaluationSpec
from dualms.spec.field import AutoField, FieldSpec
from dualms.spec.flow import FlowSpec, PotentialFlow
from dualms.spec.fluids import FluidsSpec
from dualms.spec.graph import GraphSpec
from dualms.spec.model import Model, Point
from dualms.spec.output import OutputSpec
from dualms.spec.partition import PartitionSpec
from dualms.spec.require import RequireSpec
from dualms.spec.self_support import SelfSupportSpec
from dualms.spec.units import Unit


class Spec(Model):
    """Everything that a design depends on besides the domain file."""

    units: Unit | None = Field(
        None, description="Length unit; required where the file carries none (all but GLB, 3MF)."
    )
    fluids: FluidsSpec
    flow: FlowSpec = Field(default_factory=PotentialFlow)
    graph: GraphSpec = Field(default=GraphSpec())
    partition: PartitionSpec = Field(default=PartitionSpec())
    field: FieldSpec = Field(default_factory=AutoField)
    surface: SurfaceSpec = Field(default=SurfaceSpec())
    wall: WallSpec = Field(default=WallThickness())
    shell: ShellSpec | None = Field(default=ShellSpec())
    build_direction: Point = Field((0.0, 0.0, 1.0), description="Up in the printer.")
    pictures: PicturesSpec = Field(default=PicturesSpec())
    output: OutputSpec = Field(default=OutputSpec())
    self_support: SelfSupportSpec | None = Field(None, description="Make the walls steep along the build direction.")
    require: RequireSpec = Field(default=RequireSpec(), description="What the certificate must also meet.")
    evaluation: EvaluationSpec | None = Field(None, description="Solve the flow too (needs a cfd worker).")
    seed: int = Field(0, ge=0, lt=2**32, description="Seed of everything random.")

    @model_validator(mode="after")
    def _up_is_a_direction(self) -> Spec:
        if not any(self.build_direction):
            raise ValueError("build_direction must not be the zero vector")
        return self

    @model_validator(mode="after")
    def _headers_stand_on_a_shell(self) -> Spec:
        ports = (p for f in (self.fluids.hot, self.fluids.cold) for p in (*f.inlets, *f.outlets))
        if self.shell is None and any(port.header for port in ports):
            raise ValueError("a header needs a shell to stand on: without one the other fluid may lie bare under it")
        return self
