"""Curvature against closed forms: rates on smooth meshes, and meshes of marching cubes as in the pipeline."""

import numpy as np
import pytest
import trimesh
from skimage.measure import marching_cubes

from dualms.grid import Grid
from dualms.measure.curvature import away_from_boundary, curvature_measure, mean_curvature, vertex_areas
from dualms.tpms import tpms_field


def tube(n: int, radius_of, length: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """A surface of revolution about z, facing outward, with ``n`` steps along and about 3n round."""
    z = np.linspace(-length / 2, length / 2, n + 1)
    m = 3 * n
    angle = 2 * np.pi * (np.arange(m)[None] + 0.5 * np.arange(n + 1)[:, None]) / m
    r = radius_of(z)[:, None]
    vertices = np.stack([r * np.cos(angle), r * np.sin(angle), np.broadcast_to(z[:, None], angle.shape)], -1)
    i, j = np.meshgrid(np.arange(n), np.arange(m), indexing="ij")
    a, b, c, d = i * m + j, i * m + (j + 1) % m, (i + 1) * m + (j + 1) % m, (i + 1) * m + j
    faces = np.concatenate([np.stack([a, b, d], -1).reshape(-1, 3), np.stack([b, c, d], -1).reshape(-1, 3)])
    return vertices.reshape(-1, 3), faces


def sphere(subdivisions: int) -> tuple[np.ndarray, np.ndarray]:
    ball = trimesh.creation.icosphere(subdivisions=subdivisions, radius=0.5)
    return np.array(ball.vertices), np.array(ball.faces)


def cylinder(n: int) -> tuple[np.ndarray, np.ndarray]:
    return tube(n, lambda z: np.full(z.shape, 0.4))


def catenoid(n: int) -> tuple[np.ndarray, np.ndarray]:
    return tube(n, lambda z: 0.4 * np.cosh(z / 0.4))


def error(mesh: tuple[np.ndarray, np.ndarray], exact: float, strip: float = 0.2) -> float:
    inner = away_from_boundary(*mesh, strip)
    return float(np.abs(mean_curvature(*mesh)[inner] - exact).max())


@pytest.mark.parametrize(
    ("make", "sizes", "exact", "order"),
    # On the catenoid the cubic terms do not cancel, and its error is small to begin with: 0.3 % of k1.
    [(sphere, (3, 4), 2.0, 1.7), (cylinder, (24, 48), 1.25, 1.7), (catenoid, (24, 48), 0.0, 0.9)],
)
def test_quadric_fit_converges(make, sizes: tuple[int, int], exact: float, order: float) -> None:
    coarse, fine = (error(make(n), exact) for n in sizes)
    assert fine < 0.07
    assert np.log2(coarse / fine) > order


def test_curvature_changes_sign_with_orientation_and_scales_inversely_with_size() -> None:
    vertices, faces = catenoid(24)
    h = mean_curvature(vertices + 0.1 * vertices**2, faces)
    flipped = mean_curvature(vertices + 0.1 * vertices**2, faces[:, ::-1])
    np.testing.assert_allclose(flipped, -h, atol=1e-6)
    np.testing.assert_allclose(mean_curvature(3 * (vertices + 0.1 * vertices**2), faces), h / 3, atol=1e-6)


def test_curvature_of_a_marching_cubes_sphere() -> None:
    x = (np.indices((64, 64, 64)) - 31.3) / 64
    vertices, faces, _, _ = marching_cubes((0.4 - np.sqrt((x**2).sum(0))).astype(np.float32), 0.0)
    h = mean_curvature(vertices / 64, faces)
    assert np.median(np.abs(h)) == pytest.approx(2.5, rel=0.01)
    assert np.abs(np.abs(h) - 2.5).max() < 0.1


@pytest.mark.parametrize(("make", "size", "exact"), [(sphere, 4, 2.0), (cylinder, 48, 1.25), (catenoid, 48, 0.0)])
def test_curvature_measure_over_the_balls_area_agrees(make, size: int, exact: float) -> None:
    vertices, faces = make(size)
    at = np.flatnonzero(away_from_boundary(vertices, faces, 0.25))[::97]
    h = curvature_measure(vertices, faces, 0.12, at)
    # A ball's edges are few, and the surface in it is a little larger than the flat disk.
    assert h.mean() == pytest.approx(exact, abs=0.04)
    assert np.abs(h - exact).max() < 0.2


def test_areas_of_the_vertices_add_up() -> None:
    vertices, faces = sphere(4)
    assert vertex_areas(vertices, faces).sum() == pytest.approx(np.pi, rel=0.01)


def test_boundary_strip_is_left_out() -> None:
    vertices, faces = cylinder(12)
    inner = away_from_boundary(vertices, faces, 0.2)
    assert np.array_equal(inner, np.abs(vertices[:, 2]) < 0.3 - 1e-9)
    assert away_from_boundary(*sphere(1), 0.2).all()


def test_a_lone_triangle_has_no_fit() -> None:
    assert np.isnan(mean_curvature(np.eye(3), np.array([[0, 1, 2]]))).all()


def nodal_p(n: int) -> tuple[np.ndarray, np.ndarray]:
    """One cell of cos 2πx + cos 2πy + cos 2πz = 0 by marching cubes."""
    vertices, faces, _, _ = marching_cubes(tpms_field("p", Grid(np.zeros(3), 1 / n, (n + 1,) * 3), 1.0), 0.0)
    return vertices.astype(float) / n, faces.astype(np.int64)


def exact_nodal_p(points: np.ndarray) -> np.ndarray:
    """H of the level set through each point, half the divergence of its normal, from the formula's derivatives."""
    gradient = -2 * np.pi * np.sin(2 * np.pi * points)
    second = -((2 * np.pi) ** 2) * np.cos(2 * np.pi * points)
    length = np.linalg.norm(gradient, axis=1)
    return (second.sum(axis=1) - (gradient**2 * second).sum(axis=1) / length**2) / (2 * length)


def test_quadric_fit_converges_on_a_periodic_surface_from_marching_cubes() -> None:
    errors = []
    for n in (64, 128):
        vertices, faces = nodal_p(n)
        inner = away_from_boundary(vertices, faces, 0.2)
        errors.append(np.abs(mean_curvature(vertices, faces) - exact_nodal_p(vertices))[inner].max())
    # |H| of this surface goes to 0.36 there.
    assert errors[1] < 0.02
    assert np.log2(errors[0] / errors[1]) > 1.6


def test_curvature_measure_converges_on_a_periodic_surface_in_first_order() -> None:
    errors = []
    for n in (32, 128):
        vertices, faces = nodal_p(n)
        at = np.flatnonzero(away_from_boundary(vertices, faces, 0.2))
        at = at[:: len(at) // 60]
        error = curvature_measure(vertices, faces, 0.1, at) - exact_nodal_p(vertices[at])
        errors.append(np.sqrt((error**2).mean()))
    assert errors[1] < 0.05
    assert np.log2(errors[0] / errors[1]) / 2 > 0.8
