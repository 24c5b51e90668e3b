"""The seven envelopes of the body's benchmark, with ports and walls."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import manifold3d
import numpy as np
import trimesh

from dualms.spec import Spec

ROOT = Path(__file__).parent.parent
FACETS = {"hot": ([{"facet": 0}], [{"facet": 1}]), "cold": ([{"facet": 1}], [{"facet": 0}])}
SHARE = {"wall": {"volume_fraction": 0.12}}


@dataclass(frozen=True)
class Case:
    """An envelope.

    Parameters
    ----------
    source
        A file below the repository, or the name of a shape that :func:`write_domain` makes.
    ports
        For each fluid, its inlets and outlets.
    asked
        What differs from a wall of 0.8 mm and a shell of 1.5 mm.
    """

    source: str
    ports: dict[str, tuple[list[Any], list[Any]]]
    asked: dict[str, Any]

    def spec(self, grid: int) -> Spec:
        """The specification at a grid."""
        document = {
            "units": "mm",
            "graph": {"sites": 300},
            "wall": {"thickness": 0.8},
            "shell": {"thickness": 1.5},
            "field": {"method": "phase-field"},
            "surface": {"resolution": grid},
            "fluids": {f: {"inlets": i, "outlets": o} for f, (i, o) in self.ports.items()},
        }
        return Spec.model_validate(document | self.asked)


def _disk(center: tuple[float, float, float], radius: float = 8.0) -> list[dict[str, Any]]:
    return [{"center": center, "radius": radius}]


def _box(low: tuple[float, float, float], high: tuple[float, float, float]) -> list[dict[str, Any]]:
    return [{"box": [low, high]}]


_END, _START = _box((0.999, 0.55, -1), (1.1, 1, 1)), _box((0.999, -0.1, -1), (1.1, 0.4, 1))
CASES = {
    "u_bend": Case("examples/u_bend.stl", FACETS, {}),
    "zigzag": Case("examples/zigzag.stl", FACETS, SHARE),
    "multi_bend": Case("examples/multi_bend.stl", FACETS, {}),
    # 100 x 80 x 50 mm; each fluid crosses from one long side to the other, the cold one against the hot.
    "box": Case(
        "box",
        {
            "hot": (_disk((0, 22, 25)), _disk((100, 58, 25))),
            "cold": (_disk((100, 22, 25)), _disk((0, 58, 25))),
        },
        {},
    ),
    # 90 mm across with a hole of 36 mm, 40 mm high: both fluids from one face to the other.
    "annulus": Case(
        "annulus",
        {
            "hot": (_box((-50, -50, -0.5), (50, 50, 0.5)), _box((-50, -50, 39.5), (50, 50, 40.5))),
            "cold": (_box((-50, -50, 39.5), (50, 50, 40.5)), _box((-50, -50, -0.5), (50, 50, 0.5))),
        },
        SHARE,
    ),
    # 80 x 50 x 40 mm with a bore of 16 mm.
    "step_block": Case("tests/dualms/data/annulus_block.step", FACETS, {}),
    # In units of 100 mm.
    "u_shape": Case(
        "u_shape",
        {"hot": (_END, _START), "cold": (_START, _END)},
        {"units": "m", "wall": {"thickness": 0.008}, "shell": {"thickness": 0.015}},
    ),
}


def write_domain(case: Case, folder: Path, u_shape: Path | None) -> Path:
    """The file of an envelope; those that are made are written to ``folder``."""
    if case.source == "u_shape" and u_shape:
        return u_shape.resolve()
    if (ROOT / case.source).is_file():
        return ROOT / case.source
    path = folder / f"{case.source}.stl"
    if case.source == "box":
        made = trimesh.creation.box(bounds=[(0, 0, 0), (100, 80, 50)])
    else:
        ring = manifold3d.CrossSection.circle(45, 180) - manifold3d.CrossSection.circle(18, 120)
        mesh = manifold3d.Manifold.extrude(ring, 40).to_mesh64()
        made = trimesh.Trimesh(np.asarray(mesh.vert_properties)[:, :3], np.asarray(mesh.tri_verts), process=False)
    path.write_bytes(trimesh.exchange.stl.export_stl(made))
    return path
