"""Meshes as written in single precision: closed, of distinct vertices, and free of crossings by CGAL's word too."""

from __future__ import annotations

from pathlib import Path

import igl.copyleft.cgal as cgal
import numpy as np
import pytest
import trimesh

from dualms.body.body import Body, in_units, make_body
from dualms.body.files import write_3mf, write_stl
from dualms.body.written import as_written, lattice_step
from dualms.booleans import Solid
from dualms.spec import Unit
from dualms.surface import extract_surface
from dualms.triangles import TriangleMesh
from tests.dualms.shapes import box_mesh, domain_of, gyroid, shared_ends

WALL, SHELL = 0.02, 0.03


@pytest.fixture(scope="module")
def body() -> Body:
    domain = domain_of(box_mesh(), shared_ends())
    grid = domain.grid(64, padding=4)
    surface = extract_surface(domain, gyroid(grid, 0.37), grid, WALL / 2 + 2.5 * grid.spacing, SHELL)
    return in_units(make_body(domain, surface, WALL, SHELL, unit_m=1e-3), 1e-3)


def test_the_files_hold_closed_meshes_that_cross_nowhere(body: Body, tmp_path: Path) -> None:
    for name, mesh in (("solid", body.solid), ("hot", body.hot.mesh), ("cold", body.cold.mesh)):
        write_stl(mesh, tmp_path / f"{name}.stl")
        read = trimesh.load_mesh(tmp_path / f"{name}.stl")
        assert read.is_watertight
        assert read.is_winding_consistent
        assert len(read.vertices) == len(mesh.vertices)  # joined by position, none is lost
        assert read.volume == pytest.approx(mesh.volume, rel=1e-6)
        _, _, pairs, _, _ = cgal.remesh_self_intersections(
            np.asarray(read.vertices, dtype=float), np.asarray(read.faces, dtype=np.int64), detect_only=True
        )
        assert len(pairs) == 0
    write_3mf(body.solid, body.solid_side, Unit.MM, tmp_path / "solid.3mf")
    printed = trimesh.load_mesh(tmp_path / "solid.3mf")
    assert printed.is_watertight
    assert printed.volume == pytest.approx(body.solid.volume, rel=1e-6)


def test_coordinates_are_single_precision_already(body: Body) -> None:
    single = np.float32(body.solid.vertices).astype(float)
    assert np.abs(single - body.solid.vertices).max() < 1e-6 * lattice_step(body.solid.vertices)


def test_features_below_single_precision_are_closed_up() -> None:
    # Two boxes that overlap by less than single precision can say at 100 mm: their union has edges of 1e-9.
    a = TriangleMesh(*_box((0, 0, 0), (1, 1, 1)))
    b = TriangleMesh(*_box((1 - 1e-9, 0.2 + 1e-9, 0.2), (2, 0.8, 0.8)))
    mesh, origin, crossing = as_written(Solid.of(a) | Solid.of(b), 100.0, np.zeros(3))
    assert mesh.is_closed
    assert crossing == 0
    assert len(np.unique(origin)) == 2
    assert len(np.unique(np.float32(mesh.vertices), axis=0)) == len(mesh.vertices)
    assert mesh.volume == pytest.approx(1.36e6, rel=1e-5)


def _box(low: tuple[float, ...], high: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
    box = trimesh.creation.box(bounds=[low, high])
    return np.asarray(box.vertices, dtype=float), np.asarray(box.faces, dtype=np.int64)
