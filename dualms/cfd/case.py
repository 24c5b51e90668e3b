"""Writes the OpenFOAM case of one fluid: incompressible laminar flow, steady, on a voxel mesh.

SIMPLEC (Van Doormaal and Raithby 1984) with second-order upwind momentum; the flow enters along the ports' normals at
one speed and leaves against zero pressure.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dualms.cfd.channels import STEPS
from dualms.cfd.foamfile import write_faces, write_field, write_list, write_text
from dualms.cfd.mesh import PATCHES, ChannelMesh
from dualms.grid import Array
from dualms.spec import FluidSpec

STOP_FILE = "stop"
SCHEMES = {"linear-upwind": "bounded Gauss linearUpwind grad(U)", "upwind": "bounded Gauss upwind"}


@dataclass(frozen=True)
class FlowControl:
    """How the flow equations are iterated.

    Parameters
    ----------
    iterations
        At most so many.
    scheme
        Momentum convection: ``linear-upwind`` (second order) or ``upwind``.
    velocity_relaxation, pressure_relaxation
        Factors of the two equations.
    envelope
        ``noSlip``, or ``slip`` for a slice of a wide channel.
    window
        Pressure drops are averaged over so many last iterations.
    drift
        A flow that wanders has settled when the means of two windows differ by less than this share.
    steady
        A flow is steady when the pressure drop varies by less than this share over half a window.
    """

    iterations: int = 400
    scheme: str = "linear-upwind"
    velocity_relaxation: float = 0.9
    pressure_relaxation: float = 1.0
    envelope: str = "noSlip"
    window: int = 50
    drift: float = 0.01
    steady: float = 1e-4

    def __post_init__(self) -> None:
        if self.iterations < 1 or self.scheme not in SCHEMES:
            raise ValueError("a flow needs at least one iteration and a known scheme")
        if self.envelope not in ("noSlip", "slip"):
            raise ValueError("the envelope is noSlip or slip")


def inlet_velocity(mesh: ChannelMesh, volume_flow_m3_s: float) -> Array:
    """(K, 3) velocity of the inlet faces: against the ports' normals, at the one speed that carries the flow."""
    outward = STEPS[mesh.direction[mesh.patch("inlet")]]
    projected = np.einsum("ij,ij->i", outward, mesh.inlet_normals).sum() * mesh.face_area_m2
    return np.asarray(-mesh.inlet_normals * (volume_flow_m3_s / projected))


def write_case(folder: Path, mesh: ChannelMesh, fluid: FluidSpec, control: FlowControl) -> None:
    """Write a case that ``simpleFoam`` runs, starting from rest.

    Parameters
    ----------
    folder
        Is created.
    mesh
        The fluid's cells.
    fluid
        Its properties and mass flow.
    control
        Iteration limits and schemes.
    """
    for name in ("constant/polyMesh", "system", "0"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    _write_mesh(folder / "constant" / "polyMesh", mesh)
    viscosity = fluid.viscosity_pa_s / fluid.density_kg_m3
    write_text(folder / "constant" / "transportProperties", f"transportModel Newtonian;\nnu {viscosity!r};\n")
    write_text(folder / "constant" / "turbulenceProperties", "simulationType laminar;\n")
    write_text(folder / "system" / "controlDict", _control(control))
    write_text(folder / "system" / "fvSchemes", _SCHEMES.format(convection=SCHEMES[control.scheme]))
    write_text(
        folder / "system" / "fvSolution",
        _SOLUTION.format(velocity=control.velocity_relaxation, pressure=control.pressure_relaxation),
    )
    velocity = inlet_velocity(mesh, fluid.mass_flow_kg_s / fluid.density_kg_m3)
    still: dict[str, object] = {"type": "noSlip"}
    slope: dict[str, object] = {"type": "zeroGradient"}
    speeds: dict[str, dict[str, object]] = {
        "inlet": {"type": "fixedValue", "value": velocity},
        "outlet": {"type": "inletOutlet", "inletValue": "uniform (0 0 0)", "value": "uniform (0 0 0)"},
        "wall": still,
        "envelope": {"type": control.envelope},
    }
    pressures: dict[str, dict[str, object]] = {
        "inlet": slope,
        "outlet": {"type": "fixedValue", "value": "uniform 0"},
        "wall": slope,
        "envelope": slope,
    }
    write_field(folder / "0" / "U", None, speeds)
    write_field(folder / "0" / "p", None, pressures)


def _write_mesh(folder: Path, mesh: ChannelMesh) -> None:
    write_list(folder / "points", "vectorField", mesh.points_m)
    write_faces(folder / "faces", mesh.faces)
    write_list(folder / "owner", "labelList", _int(mesh.owner))
    write_list(folder / "neighbour", "labelList", _int(mesh.neighbour))
    entries = "".join(
        f"    {name}\n    {{\n        type {'patch' if name in ('inlet', 'outlet') else 'wall'};\n"
        f"        nFaces {mesh.starts[k + 1] - mesh.starts[k]};\n        startFace {mesh.starts[k]};\n    }}\n"
        for k, name in enumerate(PATCHES)
    )
    write_text(folder / "boundary", f"{len(PATCHES)}\n(\n{entries})\n", kind="polyBoundaryMesh")


def _int(values: NDArray[np.int64]) -> NDArray[np.int32]:
    return values.astype(np.int32)


def _control(control: FlowControl) -> str:
    return _CONTROL.format(iterations=control.iterations, stop=STOP_FILE)


_CONTROL = """application simpleFoam;
startFrom startTime;
startTime 0;
stopAt endTime;
endTime {iterations};
deltaT 1;
writeControl timeStep;
writeInterval {iterations};
purgeWrite 1;
writeFormat binary;
writePrecision 12;
writeCompression off;
timeFormat general;
runTimeModifiable false;
functions
{{
    stop
    {{
        type abort;
        libs (utilityFunctionObjects);
        file "<case>/{stop}";
        action writeNow;
    }}
    inletPressure
    {{
        type surfaceFieldValue;
        libs (fieldFunctionObjects);
        regionType patch;
        name inlet;
        operation weightedAverage;
        weightField phi;
        fields (p);
        writeFields false;
        log true;
    }}
}}
"""

_SCHEMES = """ddtSchemes {{ default steadyState; }}
gradSchemes {{ default Gauss linear; }}
divSchemes
{{
    default none;
    div(phi,U) {convection};
    div((nuEff*dev2(T(grad(U))))) Gauss linear;
}}
laplacianSchemes {{ default Gauss linear orthogonal; }}
interpolationSchemes {{ default linear; }}
snGradSchemes {{ default orthogonal; }}
"""

_SOLUTION = """solvers
{{
    p
    {{
        solver GAMG;
        smoother symGaussSeidel;
        nPreSweeps 1;
        nPostSweeps 2;
        cacheAgglomeration true;
        nCellsInCoarsestLevel 50;
        tolerance 1e-12;
        relTol 0.002;
        maxIter 50;
    }}
    U
    {{
        solver smoothSolver;
        smoother symGaussSeidel;
        tolerance 1e-12;
        relTol 0.1;
        maxIter 5;
    }}
}}
SIMPLE
{{
    consistent yes;
    nNonOrthogonalCorrectors 0;
}}
relaxationFactors
{{
    fields {{ p {pressure}; }}
    equations {{ U {velocity}; }}
}}
"""
