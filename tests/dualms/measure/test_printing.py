"""Overhang and cavities against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from dualms.body.body import make_body
from dualms.measure.printing import best_build_direction, overhang_fraction, trapped_volume, wall_overhang
from dualms.surface import extract_surface
from dualms.triangles import TriangleMesh
from tests.dualms.shapes import box_mesh, domain_of, end_ports, halves

BALL = trimesh.creation.icosphere(subdivisions=6, radius=1.0)


def ball() -> TriangleMesh:
    return TriangleMesh(np.asarray(BALL.vertices), BALL.faces.astype(np.int64))


@pytest.mark.parametrize("up", [(0, 0, 1), (3, -1, 2)])
def test_a_sphere_overhangs_by_its_lower_cap(up: tuple[int, int, int]) -> None:
    # The cap within 45° of the pole: (1 - cos 45°) / 2 of the area.
    assert overhang_fraction(ball(), np.array(up, dtype=float)) == pytest.approx((1 - np.sqrt(0.5)) / 2, abs=2e-3)


def test_a_cone_is_printed_on_its_base() -> None:
    cone = trimesh.creation.cone(radius=1.0, height=0.5)
    mesh = TriangleMesh(np.asarray(cone.vertices), cone.faces.astype(np.int64))
    assert overhang_fraction(mesh, np.array([0.0, 0, 1])) == 0
    # On its tip, the mantle faces down at 63° from the vertical.
    mantle = np.pi * np.hypot(1.0, 0.5)
    assert overhang_fraction(mesh, np.array([0.0, 0, -1])) == pytest.approx(mantle / (mantle + np.pi), rel=0.01)
    assert best_build_direction(mesh)[1] == 0


def test_a_plane_walls_underside_is_half_of_its_two_sides() -> None:
    domain = domain_of(box_mesh(), end_ports())
    grid = domain.grid(48, padding=4)
    body = make_body(domain, extract_surface(domain, halves(grid), grid, 0.07, 0.03), 0.02, 0.03)
    assert wall_overhang(body, np.array([0.0, 0, 1])) == (0, 0)
    area, share = wall_overhang(body, np.array([0.0, 2, 0]))
    assert share == pytest.approx(0.5, rel=0.02)
    rim = 0.03 * 0.08
    assert area == pytest.approx((0.08 - 2 * rim) * (0.04 - 2 * rim), rel=0.02)
    # Tilted by less than 45° it still overhangs, by more it does not.
    assert wall_overhang(body, np.array([0.0, 1, 0.9]))[1] == pytest.approx(0.5, rel=0.05)
    assert wall_overhang(body, np.array([0.0, 0.9, 1]))[1] < 0.01


def test_a_closed_cavity_traps_its_volume() -> None:
    outer, inner = ball(), ball()
    vertices = np.concatenate([outer.vertices, 0.5 * inner.vertices])
    faces = np.concatenate([outer.faces, inner.faces[:, ::-1] + len(outer.vertices)])
    assert trapped_volume(TriangleMesh(vertices, faces)) == pytest.approx(4 / 3 * np.pi / 8, rel=1e-3)
    assert trapped_volume(outer) == 0
