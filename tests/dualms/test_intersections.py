"""The exact test for crossing triangles: known cases, and agreement with CGAL by way of libigl."""

from __future__ import annotations

import igl.copyleft.cgal as cgal
import numpy as np
import pytest
import trimesh

from dualms.intersections import crossing_triangles
from dualms.triangles import TriangleMesh

STEP = 2.0**-20


def _mesh(*triangles: list[list[float]]) -> TriangleMesh:
    """Triangles by their corners; equal corners are one vertex."""
    corners = np.array(triangles, dtype=float).reshape(-1, 3)
    vertices, faces = np.unique(corners, axis=0, return_inverse=True)
    return TriangleMesh(vertices, faces.reshape(-1, 3).astype(np.int64))


FLAT = [[0, 0, 0], [4, 0, 0], [0, 4, 0]]


@pytest.mark.parametrize(
    ("other", "crosses"),
    [
        ([[1, 1, -1], [1, 1, 1], [5, 5, 0]], True),  # pierces it
        ([[1, 1, 1], [2, 1, 2], [1, 2, 2]], False),  # floats above it
        ([[1, 1, 0], [2, 1, 2], [1, 2, 2]], True),  # touches its inside with a corner
        ([[1, 1, 0], [2, 1, 0], [1, 2, 0]], True),  # lies in it
        ([[5, 5, 0], [6, 5, 0], [5, 6, 0]], False),  # lies beside it, in its plane
        ([[4, 0, 0], [0, 0, 0], [0, -4, 0]], False),  # goes on across a common edge, flat
        ([[4, 0, 0], [0, 0, 0], [1, 1, 0]], True),  # folded back over a common edge
        ([[4, 0, 0], [0, 0, 0], [1, 1, 1e-6]], False),  # nearly folded back
        ([[0, 0, 0], [-4, 0, 0], [0, -4, 0]], False),  # shares a corner only
        ([[0, 0, 0], [3, 3, 1], [3, 3, -1]], True),  # cuts it from a common corner
    ],
)
def test_two_triangles(other: list[list[float]], crosses: bool) -> None:
    assert crossing_triangles(_mesh(FLAT, other), STEP).tolist() == [crosses, crosses]


def test_a_triangle_without_area_is_found() -> None:
    assert crossing_triangles(_mesh([[0, 0, 0], [1, 1, 1], [2, 2, 2]]), STEP).all()


def test_a_sphere_crosses_nothing_and_two_that_overlap_do() -> None:
    ball = trimesh.creation.icosphere(4)
    assert not crossing_triangles(TriangleMesh(ball.vertices, ball.faces.astype(np.int64)), STEP).any()
    both = trimesh.util.concatenate([ball, ball.copy().apply_translation((0.5, 0.1, 0.2))])
    found = crossing_triangles(TriangleMesh(both.vertices, both.faces.astype(np.int64)), STEP)
    assert 0 < found.sum() < len(found) / 4


@pytest.mark.parametrize("seed", range(3))
def test_random_triangles_agree_with_cgal(seed: int) -> None:
    generator = np.random.default_rng(seed)
    centres = generator.integers(0, 4000, (1500, 1, 3))
    vertices = (centres + generator.integers(-120, 120, (1500, 3, 3))).reshape(-1, 3).astype(float)
    faces = np.arange(4500).reshape(-1, 3)
    _, _, pairs, _, _ = cgal.remesh_self_intersections(vertices, faces, detect_only=True, cutoff=10**9)
    expected = np.zeros(len(faces), dtype=bool)
    expected[np.unique(pairs)] = True
    assert 0 < expected.sum() < len(faces)
    assert (crossing_triangles(TriangleMesh(vertices, faces), 1.0) == expected).all()


def test_a_lattice_that_is_too_fine_is_refused() -> None:
    with pytest.raises(ValueError, match="wider"):
        crossing_triangles(_mesh(FLAT), 1e-12)


def test_asking_for_some_finds_all_that_they_cross() -> None:
    generator = np.random.default_rng(7)
    corners = (generator.integers(0, 4000, (1500, 1, 3)) + generator.integers(-150, 151, (1500, 3, 3))) * STEP
    mesh = TriangleMesh(corners.reshape(-1, 3), np.arange(4500, dtype=np.int64).reshape(-1, 3))
    asked = generator.random(1500) < 0.1
    whole, some, others = (crossing_triangles(mesh, STEP, a) for a in (None, asked, ~asked))
    assert 100 < whole.sum() < 1400
    assert (some[asked] == whole[asked]).all()
    assert not (some & ~whole).any()
    assert ((some | others) == whole).all()
    assert not crossing_triangles(mesh, STEP, np.zeros(1500, dtype=bool)).any()
