"""Small bodies with known measures, for the tests."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh

from dualms.domain import Domain
from dualms.grid import Grid
from dualms.mesh import DomainMesh
from dualms.ports import resolve_ports
from dualms.reading import read_domain_mesh
from dualms.spec import FluidsSpec, Spec, Unit

_DOMAINS: dict[tuple[bytes, bytes, str], Domain] = {}


def box_mesh(size: tuple[float, float, float] = (80.0, 60.0, 40.0)) -> DomainMesh:
    """A box with its lower corner at the origin, sides in millimetres."""
    box = trimesh.creation.box(size)
    return DomainMesh((box.vertices + np.array(size) / 2) * 1e-3, box.faces.astype(np.int64), Unit.MM)


def end_ports(size: tuple[float, float, float] = (80.0, 60.0, 40.0), radius: float = 8.0) -> FluidsSpec:
    """Counter-flow through four disks on the two ends (x = 0 and x = size) of a box."""
    x, y, z = size

    def disk(at: float, share: float) -> dict[str, object]:
        return {"center": (at, share * y, z / 2), "radius": radius}

    return FluidsSpec.model_validate(
        {
            "hot": {"inlets": [disk(0, 0.25)], "outlets": [disk(x, 0.25)]},
            "cold": {"inlets": [disk(x, 0.75)], "outlets": [disk(0, 0.75)]},
        }
    )


def with_headers(fluids: FluidsSpec, header: dict[str, object]) -> FluidsSpec:
    """The fluids with the same header on every port."""
    document = fluids.model_dump()
    for fluid in document.values():
        for role in ("inlets", "outlets"):
            for port in fluid[role]:
                port["header"] = header
    return FluidsSpec.model_validate(document)


def shared_ends(size: tuple[float, float, float] = (80.0, 60.0, 40.0)) -> FluidsSpec:
    """Counter-flow through both whole ends of a box, shared by the fluids."""
    x, y, z = size
    low = {"box": [(0.0, 0.0, 0.0), (0.0, y, z)]}
    high = {"box": [(x, 0.0, 0.0), (x, y, z)]}
    return FluidsSpec.model_validate(
        {"hot": {"inlets": [low], "outlets": [high]}, "cold": {"inlets": [high], "outlets": [low]}}
    )


def domain_of(mesh: DomainMesh, fluids: FluidsSpec) -> Domain:
    """The domain of a mesh in millimetres with its ports; the same one for the same mesh and ports."""
    asked = (mesh.vertices_m.tobytes(), mesh.faces.tobytes(), fluids.model_dump_json())
    if asked not in _DOMAINS:
        _DOMAINS[asked] = Domain.from_mesh(mesh, resolve_ports(mesh, fluids, Unit.MM))
    return _DOMAINS[asked]


def gyroid(grid: Grid, cell: float) -> np.ndarray:
    """Nodal gyroid of a cell size on a grid, float32."""
    x, y, z = (2 * np.pi / cell * grid.points()).T
    values = np.sin(x) * np.cos(y) + np.sin(y) * np.cos(z) + np.sin(z) * np.cos(x)
    return values.reshape(grid.shape).astype(np.float32)


def halves(grid: Grid, at: float = 0.375) -> np.ndarray:
    """Signed distance to the plane y = ``at``: hot below it, cold above; float32."""
    return (at - grid.points()[:, 1]).reshape(grid.shape).astype(np.float32)


def small_spec(fluids: FluidsSpec, **changes: object) -> Spec:
    """A specification that runs in seconds."""
    document: dict[str, object] = {
        "units": "mm",
        "fluids": fluids.model_dump(),
        "graph": {"sites": 60},
        "partition": {"seconds": 0.05},
        "field": {"method": "phase-field", "resolution": 48},
        "surface": {"resolution": 64},
        "pictures": {"width": 320},
        "wall": {"thickness": 0.8},
        "shell": {"thickness": 1.5},
    }
    return Spec.model_validate(document | changes)


def written(mesh: trimesh.Trimesh, path: Path) -> Path:
    """The mesh as a file, its format from the path's suffix."""
    content = mesh.export(file_type=path.suffix[1:])
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def reread(mesh: trimesh.Trimesh, path: Path) -> DomainMesh:
    """The mesh written and read back as millimetres."""
    return read_domain_mesh(written(mesh, path), Unit.MM)
