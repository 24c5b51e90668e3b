"""The body: closed, exact in volume, of even wall, and open where its ports are."""

from __future__ import annotations

import manifold3d
import numpy as np
import pytest

from dualms.body.body import Body, make_body
from dualms.body.patches import INTERFACE
from dualms.body.walls import wall_thickness
from dualms.booleans import Solid
from dualms.domain import Domain
from dualms.errors import ChannelBlocked, WallTooThick
from dualms.measure.printing import best_build_direction, overhang_fraction, wall_thicknesses
from dualms.spec import Unit, WallFraction
from dualms.surface import Surface, extract_surface
from dualms.triangles import TriangleMesh
from tests.dualms.shapes import box_mesh, domain_of, end_ports, gyroid, halves, shared_ends

WALL = 0.02
SHELL = 0.03


def _surface(domain: Domain, resolution: int = 64, cell: float = 0.5) -> Surface:
    grid = domain.grid(resolution, padding=4)
    return extract_surface(domain, gyroid(grid, cell), grid, WALL / 2 + 2.5 * grid.spacing, SHELL)


@pytest.fixture(scope="module")
def shared() -> tuple[Domain, Body]:
    domain = domain_of(box_mesh(), shared_ends())
    return domain, make_body(domain, _surface(domain, 96), WALL, SHELL)


def test_solid_and_fluids_fill_the_envelope_exactly(shared: tuple[Domain, Body]) -> None:
    domain, body = shared
    total = body.solid.volume + body.hot.mesh.volume + body.cold.mesh.volume + body.dropped_m3
    # Exact but for the rounding to single precision, in which the meshes are written.
    assert total == pytest.approx(domain.volume * domain.scale_m**3, rel=1e-5)
    assert body.leak_m3 == 0


def test_all_meshes_are_closed_and_manifold(shared: tuple[Domain, Body]) -> None:
    _, body = shared
    for mesh in (body.solid, body.hot.mesh, body.cold.mesh):
        assert mesh.is_closed
        assert Solid.of(mesh).manifold.status() == manifold3d.Error.NoError


def test_no_face_is_folded_over_at_the_openings(shared: tuple[Domain, Body]) -> None:
    _, body = shared
    middle = body.solid.centroids
    end = (np.abs(middle[:, 0]) < 1e-9) & (body.solid_side == 0)
    along = body.solid.crosses[end, 0] / 2
    assert np.abs(along).sum() == pytest.approx(abs(along.sum()), rel=1e-9)


def test_the_wall_has_the_asked_thickness(shared: tuple[Domain, Body]) -> None:
    domain, body = shared
    low, high = np.quantile(wall_thicknesses(body, seed=0), (0.01, 0.99)) / (WALL * domain.scale_m)
    assert low > 0.97
    assert high < 1.03


def test_openings_leave_a_rim_of_the_shell(shared: tuple[Domain, Body]) -> None:
    domain, body = shared
    faces = [f.mesh.part(f.patch == f.patches.index("inlet-0")) for f in (body.hot, body.cold)]
    rim = SHELL * domain.scale_m
    free = (0.06 - 2 * rim) * (0.04 - 2 * rim)
    assert 0.5 * free < sum(part.area for part in faces) < free
    for part in faces:
        assert part.vertices[:, 1].min() == pytest.approx(rim, rel=0.02)


def test_a_dedicated_port_opens_to_its_own_fluid_only() -> None:
    domain = domain_of(box_mesh(), end_ports())
    grid = domain.grid(64, padding=4)
    # Hot for y below the middle: four plain ducts' worth of room at each port.
    values = (0.375 - grid.points()[:, 1]).reshape(grid.shape).astype(np.float32)
    body = make_body(domain, extract_surface(domain, values, grid, 0.06, SHELL), WALL, SHELL)
    for fluid, low, high in ((body.hot, 0.0, 0.03), (body.cold, 0.03, 0.06)):
        for k in (2, 3):
            opening = fluid.mesh.part(fluid.patch == k)
            assert opening.area == pytest.approx(np.pi * 0.008**2, rel=0.02)
            assert low < opening.vertices[:, 1].min() < opening.vertices[:, 1].max() < high


def test_interfaces_of_a_plane_are_the_section_less_the_shell() -> None:
    domain = domain_of(box_mesh(), end_ports())
    grid = domain.grid(64, padding=4)
    values = (0.375 - grid.points()[:, 1]).reshape(grid.shape).astype(np.float32)
    body = make_body(domain, extract_surface(domain, values, grid, 0.06, SHELL), WALL, SHELL)
    rim = SHELL * domain.scale_m
    expected = (0.08 - 2 * rim) * (0.04 - 2 * rim)
    assert body.hot.mesh.areas[body.hot.patch == INTERFACE].sum() == pytest.approx(expected, rel=5e-3)


@pytest.mark.parametrize("wall", [0.1, 0.3])
def test_a_wall_thicker_than_the_grids_padding_leaves_the_rest(wall: float) -> None:
    domain = domain_of(box_mesh(), end_ports())
    grid = domain.grid(64, padding=4)
    body = make_body(domain, extract_surface(domain, halves(grid), grid, wall / 2 + 1.5 * grid.spacing), wall, 0.0)
    rest = (0.375 - wall / 2) * 0.5
    for fluid in (body.hot, body.cold):
        assert fluid.mesh.volume / domain.scale_m**3 == pytest.approx(rest, rel=1e-5)


def test_a_fluid_that_misses_a_port_is_refused() -> None:
    domain = domain_of(box_mesh(), end_ports())
    grid = domain.grid(48, padding=4)
    values = (0.45 - grid.points()[:, 0]).reshape(grid.shape).astype(np.float32)  # a plane across the flow
    with pytest.raises(ChannelBlocked, match="reaches 1"):
        make_body(domain, extract_surface(domain, values, grid, 0.08, SHELL), WALL, SHELL)


@pytest.mark.parametrize(("wall", "shell"), [(0.9, 0.0), (0.02, 0.3)])
def test_a_wall_or_shell_that_fills_the_domain_is_refused(wall: float, shell: float) -> None:
    domain = domain_of(box_mesh(), shared_ends())
    grid = domain.grid(32, padding=4)
    surface = extract_surface(domain, gyroid(grid, 0.5), grid, wall / 2 + 2.5 * grid.spacing, shell)
    with pytest.raises((WallTooThick, ChannelBlocked)):
        make_body(domain, surface, wall, shell)


def test_a_wall_by_volume_fraction_takes_that_share() -> None:
    domain = domain_of(box_mesh(), shared_ends())
    wall = wall_thickness(WallFraction(volume_fraction=0.1), Unit.MM, domain, lambda grid: gyroid(grid, 0.5))
    grid = domain.grid(64, padding=4)
    surface = extract_surface(domain, gyroid(grid, 0.5), grid, 0.1)
    body = make_body(domain, surface, wall, 0.0)
    assert body.solid.volume / (domain.volume * domain.scale_m**3) == pytest.approx(0.1, rel=0.01)


def test_overhang_of_a_tilted_roof_is_its_underside() -> None:
    # A cube standing on the plate has no overhang; turned by a rotation that puts a face 30° off the plate it has one.
    points = np.array([[x, y, z] for x in (0.0, 1) for y in (0.0, 1) for z in (0.0, 1)])
    hull = manifold3d.Manifold.hull_points(points).to_mesh64()
    cube = TriangleMesh(np.asarray(hull.vert_properties)[:, :3], np.asarray(hull.tri_verts).astype(np.int64))
    assert overhang_fraction(cube, np.array([0.0, 0, 1])) == 0
    up = np.array([0.0, np.sin(np.radians(30)), np.cos(np.radians(30))])
    assert overhang_fraction(cube, up) == pytest.approx(1 / 6)
    assert best_build_direction(cube)[1] == 0
