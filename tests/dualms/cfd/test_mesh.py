import numpy as np
import pytest

from dualms.cfd.case import FlowControl, inlet_velocity, write_case
from dualms.cfd.channels import STEPS
from dualms.cfd.foamfile import read_field, write_field
from dualms.cfd.mesh import channel_mesh
from tests.dualms.cfd.conftest import BOX, box_design, gyroid_in_box


@pytest.fixture(params=[0.02, 0.002], ids=["thick wall", "touching channels"])
def exchanger(request):
    return gyroid_in_box(request.param), box_design(BOX, True)[1]


def test_every_cell_is_closed(exchanger) -> None:
    found, _ = exchanger
    for fluid in (1, -1):
        mesh = channel_mesh(found, fluid)
        total = np.zeros((len(mesh.cells), 3))
        np.add.at(total, mesh.owner, STEPS[mesh.direction])
        np.add.at(total, mesh.neighbour, -STEPS[mesh.direction[: len(mesh.neighbour)]])
        assert (total == 0).all()
        count = np.bincount(mesh.owner, minlength=len(mesh.cells)) + np.bincount(
            mesh.neighbour, minlength=len(mesh.cells)
        )
        assert (count == 6).all()


def test_face_corners_turn_round_the_outward_normal(exchanger) -> None:
    found, _ = exchanger
    mesh = channel_mesh(found, 1)
    corners = mesh.points_m[mesh.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / mesh.face_area_m2
    assert np.allclose(normal, STEPS[mesh.direction])
    center = found.origin_m + found.spacing_m * mesh.cells[mesh.owner]
    assert np.allclose(corners.mean(axis=1), center + 0.5 * found.spacing_m * STEPS[mesh.direction])


def test_internal_faces_stand_in_upper_triangular_order(exchanger) -> None:
    mesh = channel_mesh(exchanger[0], -1)
    inner = len(mesh.neighbour)
    key = mesh.owner[:inner] * len(mesh.cells) + mesh.neighbour
    assert (np.diff(key) > 0).all()
    assert (mesh.owner[:inner] < mesh.neighbour).all()


def test_faces_that_both_fluids_touch_are_wall_of_both(exchanger) -> None:
    found, _ = exchanger
    hot, cold = channel_mesh(found, 1), channel_mesh(found, -1)
    touching = 0
    for step in STEPS:
        touching += int(((found.labels == 1) & (np.roll(found.labels, tuple(-step), (0, 1, 2)) == -1)).sum())
    for mesh in (hot, cold):
        wall = mesh.patch("wall")
        assert wall.stop - wall.start >= touching
    assert (touching > 0) == (found.wall_m < 0.5 * found.spacing_m)


def test_the_inlet_carries_the_flow(exchanger) -> None:
    mesh = channel_mesh(exchanger[0], 1)
    velocity = inlet_velocity(mesh, 1e-5)
    outward = STEPS[mesh.direction[mesh.patch("inlet")]]
    assert -float((velocity * outward).sum()) * mesh.face_area_m2 == pytest.approx(1e-5)


def test_fields_survive_the_way_to_a_file_and_back(tmp_path) -> None:
    values = np.arange(15.0).reshape(5, 3) / 7
    at = np.array([[1.0, 2.0, 3.0]])
    write_field(tmp_path / "U", values, {"inlet": {"type": "fixedValue", "value": at}, "wall": {"type": "noSlip"}})
    internal, boundary = read_field(tmp_path / "U", 5, {"inlet": 1, "wall": 4})
    assert (internal == values).all()
    assert (boundary["inlet"] == at).all()
    assert "wall" not in boundary
    with pytest.raises(ValueError, match="expected 6"):
        read_field(tmp_path / "U", 6, {})


@pytest.mark.cfd
def test_openfoam_finds_no_fault_with_the_mesh(exchanger, foam, tmp_path) -> None:
    found, fluids = exchanger
    for fluid, spec in ((1, fluids.hot), (-1, fluids.cold)):
        case = tmp_path / f"case{fluid}"
        write_case(case, channel_mesh(found, fluid), spec, FlowControl())
        lines: list[str] = []
        assert foam.run("checkMesh", case, lines.append) == 0
        assert "Mesh OK." in lines
