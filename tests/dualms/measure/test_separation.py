"""The walk on the grid: a sound body keeps its fluids apart however thin the wall; every kind of hole is found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from dualms.body.body import Body, make_body
from dualms.measure.separation import separation
from dualms.surface import extract_surface
from dualms.triangles import TriangleMesh
from tests.dualms.shapes import box_mesh, domain_of, end_ports, gyroid, halves, shared_ends

SHELL = 0.03


@pytest.fixture(scope="module")
def ducts() -> Body:
    """Two ducts along x, hot for y below 30 mm, in a box of 80 x 60 x 40 mm with a shell of 2.4 mm."""
    domain = domain_of(box_mesh(), end_ports())
    grid = domain.grid(48, padding=4)
    return make_body(domain, extract_surface(domain, halves(grid), grid, 0.07, SHELL), 0.02, SHELL)


def test_a_sound_body_has_no_ways_but_its_ports(ducts: Body) -> None:
    for spacing in (0.0005, 0.0017, 0.004):  # the wall is 1.6 mm
        found = separation(ducts, spacing)
        assert (found.hot_to_cold, found.to_outside, found.ports_apart) == (0, 0, 0)


def test_a_wall_far_thinner_than_a_voxel_stops_the_walk() -> None:
    domain = domain_of(box_mesh(), shared_ends())
    grid = domain.grid(48, padding=4)
    surface = extract_surface(domain, gyroid(grid, 0.5), grid, 0.07, SHELL)
    body = make_body(domain, surface, 0.002, SHELL)
    found = separation(body, 10 * 0.002 * 0.08)
    assert (found.hot_to_cold, found.to_outside, found.ports_apart) == (0, 0, 0)


def pierced(body: Body, at: tuple[float, float, float], radius: float) -> Body:
    """The body without its solid's triangles that reach into a ball."""
    triangles = body.solid.vertices[body.solid.faces]
    centre = np.broadcast_to(np.array(at), (len(triangles), 3))
    keep = np.linalg.norm(trimesh.triangles.closest_point(triangles, centre) - centre, axis=1) > radius
    return replace(body, solid=body.solid.part(keep), solid_side=body.solid_side[keep])


def test_a_hole_in_the_wall_is_a_way_from_hot_to_cold(ducts: Body) -> None:
    found = separation(pierced(ducts, (0.04, 0.03, 0.02), 0.004), 0.001)
    assert found.hot_to_cold == 2  # both of the cold fluid's ports
    assert found.to_outside == 0


def test_a_hole_in_the_shell_is_a_way_out(ducts: Body) -> None:
    # The envelope's own triangles are whole sides: take the floor and the shell over it away.
    found = separation(pierced(pierced(ducts, (0.0, 0.0, 0.0), 0.001), (0.04, 0.015, 0.0024), 0.004), 0.001)
    assert found.to_outside == 1
    assert found.hot_to_cold == 0


def test_a_plate_across_a_channel_parts_its_ports(ducts: Body) -> None:
    plate = trimesh.creation.box((0.001, 0.2, 0.2))
    vertices = np.concatenate([ducts.solid.vertices, plate.vertices + np.array([0.0402, 0.0, 0.0])])
    faces = np.concatenate([ducts.solid.faces, plate.faces + len(ducts.solid.vertices)])
    found = separation(replace(ducts, solid=TriangleMesh(vertices, faces)), 0.001)
    assert found.ports_apart == 2  # one of each fluid
    assert found.hot_to_cold == 0
