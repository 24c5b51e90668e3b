"""Marching cubes, clipping and distance against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from dualms.errors import EmptySurface
from dualms.grid import Grid
from dualms.surface import extract_surface, level_set, signed_distance
from tests.dualms.shapes import box_mesh, domain_of, end_ports, gyroid, shared_ends


def _ball(resolution: int) -> tuple[np.ndarray, Grid]:
    grid = Grid.around(np.zeros(3), np.ones(3), resolution)
    return (0.3 - np.linalg.norm(grid.points() - 0.5, axis=1)).reshape(grid.shape).astype(np.float32), grid


def test_area_of_a_sphere_converges_at_second_order() -> None:
    errors = []
    for resolution in (16, 32, 64):
        values, grid = _ball(resolution)
        errors.append(abs(level_set(values, grid).area / (4 * np.pi * 0.09) - 1))
    rates = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    assert rates.min() > 1.7
    assert errors[-1] < 2e-3


def test_the_level_set_is_closed_even_where_it_leaves_the_grid() -> None:
    grid = Grid.around(np.zeros(3), np.ones(3), 24)
    mesh = level_set(gyroid(grid, 0.5), grid)
    assert mesh.is_closed
    assert mesh.volume > 0


def test_values_of_exactly_zero_do_not_break_the_mesh() -> None:
    grid = Grid.around(np.zeros(3), np.ones(3), 16)
    plane = np.broadcast_to(np.arange(grid.shape[0]) - 8.0, grid.shape[::-1]).T.astype(np.float32)
    mesh = level_set(plane, grid)
    assert mesh.is_closed
    assert (mesh.areas > 0).all()


def test_distance_to_a_plane_is_exact_in_the_band() -> None:
    grid = Grid.around(np.zeros(3), np.ones(3), 20)
    height = (grid.points()[:, 2] - 0.47).reshape(grid.shape).astype(np.float32)
    surface = level_set(height, grid)
    # Away from where the level set is closed at the rim.
    inner = (np.abs(grid.points() - 0.5).max(axis=1) < 0.3).reshape(grid.shape)
    distance = signed_distance(surface, height, grid, 0.12)
    np.testing.assert_allclose(distance[inner], np.clip(height, -0.12, 0.12)[inner], atol=1e-5)


def test_a_plane_clipped_by_a_box_has_the_area_of_the_section() -> None:
    domain = domain_of(box_mesh(), end_ports())
    grid = domain.grid(32)
    values = (grid.points()[:, 2] - 0.23).reshape(grid.shape).astype(np.float32)
    surface = extract_surface(domain, values, grid, 0.1)
    assert surface.mesh.area == pytest.approx(0.08 * 0.06, rel=1e-6)
    assert np.ptp(surface.mesh.vertices[:, 0]) == pytest.approx(0.08, rel=1e-6)


def test_a_field_of_one_sign_is_refused() -> None:
    domain = domain_of(box_mesh(), end_ports())
    grid = domain.grid(24)
    with pytest.raises(EmptySurface):
        extract_surface(domain, np.ones(grid.shape, dtype=np.float32), grid, 0.1)


def test_distances_are_exact_as_far_outside_as_they_are_wanted() -> None:
    domain = domain_of(box_mesh(), shared_ends())
    grid = domain.grid(40, padding=16)
    values, band, outside = gyroid(grid, 0.4), 0.05, 0.06
    surface = extract_surface(domain, values, grid, band, 0.02, outside)
    exact = signed_distance(level_set(values, grid), values, grid, band)
    wanted = surface.depth > -(outside + 2 * grid.spacing)
    np.testing.assert_allclose(surface.distance[wanted], exact[wanted], atol=1e-6)
    # And no further: most of the padding holds no surface.
    assert len(surface.nearest.mesh.faces) < 0.8 * len(level_set(values, grid).faces)
    np.testing.assert_allclose(surface.nearest.distance(surface.nearest.mesh.centroids), 0, atol=1e-12)
