"""Distances on the voxels near a mesh: those of libigl's tree, and of closed forms."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from dualms.grid import Grid
from dualms.narrow_band import band_distance
from dualms.nearest import Nearest
from dualms.triangles import TriangleMesh

GRID = Grid.around(np.zeros(3), np.array([1.0, 0.8, 0.6]), 20)
MIDDLE = np.array([0.5, 0.4, 0.3])


def triangles(seed: int, count: int) -> TriangleMesh:
    corners = np.random.default_rng(seed).uniform(-0.2, 1.2, (3 * count, 3))
    return TriangleMesh(corners, np.arange(3 * count).reshape(-1, 3))


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 12), st.floats(0.5, 8.0))
def test_any_triangles_are_as_far_as_the_tree_says(seed: int, count: int, voxels: float) -> None:
    mesh, band = triangles(seed, count), voxels * GRID.spacing
    expected = np.minimum(Nearest(mesh).distance(GRID.points()), band).reshape(GRID.shape)
    np.testing.assert_allclose(band_distance(mesh, GRID, band), expected, atol=1e-12)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 6), st.floats(0, 1))
def test_triangles_without_area_are_as_far_as_their_edges(seed: int, count: int, along: float) -> None:
    a, b, _ = triangles(seed, count).vertices.reshape(-1, 3, 3).swapaxes(0, 1)
    mesh = TriangleMesh(np.concatenate([a, b, a + along * (b - a)]), np.arange(3 * count).reshape(3, -1).T)
    to, way = GRID.points()[:, None] - a, b - a
    share = np.clip((to * way).sum(-1) / (way * way).sum(-1), 0, 1)
    expected = np.linalg.norm(to - share[..., None] * way, axis=-1).min(axis=1)
    np.testing.assert_allclose(band_distance(mesh, GRID, 0.2), np.minimum(expected, 0.2).reshape(GRID.shape), atol=1e-7)


@pytest.mark.parametrize("band", [0.03, 0.2])
def test_a_fine_ball_is_as_far_as_its_radius_says(band: float) -> None:
    ball = trimesh.creation.icosphere(subdivisions=5, radius=0.25)
    mesh = TriangleMesh(ball.vertices + MIDDLE, ball.faces.astype(np.int64))
    away = np.linalg.norm(GRID.points() - MIDDLE, axis=1).reshape(GRID.shape)
    found = band_distance(mesh, GRID, band)
    np.testing.assert_allclose(found, np.minimum(np.abs(away - 0.25), band), atol=2e-4)
    assert (found == band).any()
