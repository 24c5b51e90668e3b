"""The domain: closed forms of distance and volume, and convergence on the voxel grid."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from dualms.domain import Domain
from dualms.errors import DisconnectedDomain
from dualms.mesh import DomainMesh
from dualms.spec import Unit
from tests.dualms.shapes import box_mesh, domain_of, end_ports, shared_ends


def _sphere() -> Domain:
    sphere = trimesh.creation.icosphere(5)
    return Domain.from_mesh(DomainMesh(sphere.vertices * 0.05, sphere.faces.astype(np.int64), Unit.MM), ())


def test_the_unit_frame_has_longest_side_one() -> None:
    domain = domain_of(box_mesh(), end_ports())
    np.testing.assert_allclose(domain.bounds[1], [1, 0.75, 0.5])
    assert domain.scale_m == pytest.approx(0.08)
    assert domain.volume * domain.scale_m**3 == pytest.approx(0.08 * 0.06 * 0.04)
    assert domain.ports[0].area * domain.scale_m**2 == pytest.approx(np.pi * 0.008**2, rel=0.01)


def test_signed_distance_of_a_sphere_is_radius_minus_r() -> None:
    domain = _sphere()
    points = np.random.default_rng(1).uniform(-0.1, 1.1, (500, 3))
    expected = 0.5 - np.linalg.norm(points - 0.5, axis=1)
    np.testing.assert_allclose(domain.signed_distance(points), expected, atol=5e-4)


def test_depth_on_a_grid_equals_the_distance_within_the_band() -> None:
    domain = _sphere()
    grid = domain.grid(40)
    depth = domain.depth(grid, 0.08)
    expected = np.clip(domain.signed_distance(grid.points()), -0.08, 0.08).reshape(grid.shape)
    np.testing.assert_allclose(depth, expected, atol=1e-6)


def test_inside_volume_converges_to_the_mesh_volume() -> None:
    domain = _sphere()
    errors = []
    for resolution in (20, 40, 80):
        grid = domain.grid(resolution)
        errors.append(abs(domain.inside(grid).sum() * grid.spacing**3 / domain.volume - 1))
    assert errors[-1] < 0.002
    assert errors[-1] < errors[0]


def test_a_dumbbell_with_a_hair_for_a_neck_is_refused() -> None:
    blocks = [trimesh.creation.box((1, 1, 1)).apply_translation((k, 0, 0)) for k in (0, 3)]
    hair = trimesh.creation.box((2.5, 0.004, 0.004)).apply_translation((1.5, 0, 0))
    mesh = trimesh.boolean.union([*blocks, hair], engine="manifold")
    domain = Domain.from_mesh(DomainMesh(mesh.vertices * 0.01, mesh.faces.astype(np.int64), Unit.MM), ())
    with pytest.raises(DisconnectedDomain, match="2 parts"):
        domain.inside(domain.grid(40))


def test_port_voxels_touch_the_port() -> None:
    domain = domain_of(box_mesh(), shared_ends())
    grid = domain.grid(32)
    inside = domain.inside(grid)
    voxels = domain.port_voxels(grid, inside)[0]
    assert len(voxels) == 24 * 16
    assert (grid.origin[0] + grid.spacing * voxels[:, 0] < grid.spacing).all()
