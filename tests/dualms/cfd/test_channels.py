import numpy as np
import pytest

from dualms.body.headers import bounds, headers_of
from dualms.cfd.baselines import tpms_exchanger
from dualms.cfd.channels import STEPS, voxelise
from dualms.errors import ChannelBlocked
from dualms.grid import Grid
from dualms.spec import ShellSpec, Unit
from tests.dualms.cfd.conftest import BOX, box_design
from tests.dualms.shapes import box_mesh, domain_of, end_ports, halves, with_headers


@pytest.mark.parametrize("shared", [True, False])
def test_every_voxel_has_one_label_and_openings_belong_to_their_fluid(shared) -> None:
    domain, _ = box_design(BOX, shared)
    grid = domain.grid(40, 2)
    found = tpms_exchanger(domain, "gyroid", 0.25, grid, 0.02)
    inside = domain.inside(grid)
    assert ((found.labels != 0) == inside).all()
    assert (found.labels[found.distance_m > found.wall_m / 2] != -1).all()
    for fluid in (1, -1):
        openings = found.openings(fluid)
        for faces in (openings.inlet, openings.outlet):
            cells = faces[:, :3]
            assert (found.labels[tuple(cells.T)] == fluid).all()
            assert (found.labels[tuple((cells + STEPS[faces[:, 3]]).T)] == 0).all()
            assert len(np.unique(faces, axis=0)) == len(faces)
        # Hot enters at x = 0 and leaves at the other end; cold the other way round.
        assert set(openings.inlet[:, 3]) == ({0} if fluid == 1 else {1})
        assert np.allclose(openings.inlet_normals, [-1.0 if fluid == 1 else 1.0, 0, 0])
        if not shared:
            height = found.origin_m[2] + found.spacing_m * openings.inlet[:, 2]
            assert (height > 0.03).all() if fluid == 1 else (height < 0.03).all()


def test_shared_openings_are_divided_without_overlap() -> None:
    domain, _ = box_design(BOX, True)
    found = tpms_exchanger(domain, "gyroid", 0.25, domain.grid(40, 2), 0.02)
    hot, cold = (set(map(tuple, faces)) for faces in (found.hot.inlet, found.cold.outlet))
    assert not hot & cold
    end = int((found.labels[2] != 0).sum())
    wall = int((found.labels[2] == 2).sum())
    assert len(hot) + len(cold) + wall == pytest.approx(end, abs=0.02 * end)


def test_port_faces_cover_the_ports_area() -> None:
    domain, _ = box_design(BOX, False)
    grid = domain.grid(60, 2)
    distance = np.full(grid.shape, 0.5) * np.sign(grid.points()[:, 2].reshape(grid.shape) - 0.25)
    found = voxelise(domain, distance, grid, 0.001)
    ports = {port.fluid: port for port in domain.ports if port.inlet}
    for fluid in (1, -1):
        area = len(found.openings(fluid).inlet) * grid.spacing**2
        assert area == pytest.approx(ports[fluid].area, rel=0.06)


def test_pockets_become_wall_and_are_counted() -> None:
    domain, _ = box_design(BOX, True)
    grid = domain.grid(40, 2)
    points = grid.points().reshape(*grid.shape, 3)
    pocket = np.linalg.norm(points - [0.5, 0.25, 0.12], axis=-1) < 0.08
    distance = np.where((points[..., 2] > 0.25) | pocket, 0.5, -0.5)
    found = voxelise(domain, distance, grid, 0.001)
    assert (found.labels[pocket] == 2).all()
    hot = int((distance > 0)[domain.inside(grid)].sum())
    assert found.dropped_hot == pytest.approx(pocket.sum() / hot)
    assert found.dropped_cold == 0


def test_a_blocked_fluid_is_refused_with_its_name() -> None:
    domain, _ = box_design(BOX, True)
    grid = domain.grid(40, 2)
    across = np.where(grid.points()[:, 0] < 0.5, 0.5, -0.5).reshape(grid.shape)
    with pytest.raises(ChannelBlocked, match="hot channel") as caught:
        voxelise(domain, across, grid, 0.001)
    assert caught.value.measured["fluid"] == "hot"


def test_the_solid_share_of_a_thin_plane_does_not_depend_on_the_grid() -> None:
    domain, _ = box_design(BOX, True)
    shares = []
    for resolution in (30, 47, 64):
        grid = domain.grid(resolution, 2)
        distance = (grid.points()[:, 2] - 0.247).reshape(grid.shape)
        shares.append(voxelise(domain, distance, grid, 0.01).solid_fraction)
    assert np.allclose(shares, 0.01 / 0.5, rtol=0.03)


def test_a_shell_closes_the_envelope_but_not_the_ports() -> None:
    domain, _ = box_design(BOX, False)
    grid = domain.grid(48, 2)
    distance = (grid.points()[:, 2] - 0.25).reshape(grid.shape)
    bare = voxelise(domain, distance, grid, 0.01)
    shelled = voxelise(domain, distance, grid, 0.01, 0.05)
    assert (shelled.labels == 1).sum() < 0.9 * (bare.labels == 1).sum()
    assert len(shelled.hot.inlet) >= 0.6 * len(bare.hot.inlet)


def test_a_fluid_enters_at_the_end_of_its_header() -> None:
    size = (120.0, 60.0, 60.0)
    fluids = with_headers(end_ports(size), {"radius": 6, "length": 30, "wall": 2})
    domain = domain_of(box_mesh(size), fluids)
    headers = headers_of(domain, fluids, Unit.MM, ShellSpec(thickness=2))
    grid = Grid.around(*bounds(domain, headers, 0.0), 120, 2)
    found = voxelise(domain, halves(grid, 0.25), grid, 0.02, 2 / 120, headers)
    bare = voxelise(domain, halves(grid, 0.25), grid, 0.02, 2 / 120)
    for openings in (found.hot, found.cold):
        assert len(openings.inlet) * found.spacing_m**2 == pytest.approx(np.pi * 0.006**2, rel=0.05)
    x = found.origin_m[0] + found.spacing_m * (found.hot.inlet[:, 0] - 0.5)
    np.testing.assert_allclose(x, -0.030, atol=0.6 * found.spacing_m)
    gained = (found.labels == 1).sum() - (bare.labels == 1).sum()
    # From the port's circle of 8 mm over three straight voxels and a cone of 2 mm to the pipe's 6 mm.
    cone = np.pi / 3 * 2 * (64 + 48 + 36)
    assert gained == pytest.approx(2 * np.pi * 64 * 3 + 2 * cone + 2 * np.pi * 36 * 25, rel=0.03)
    assert found.solid_fraction == pytest.approx(bare.solid_fraction, rel=0.01)
    assert found.dropped_hot == found.dropped_cold == 0
