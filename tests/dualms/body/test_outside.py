"""A shell outside the envelope: Steiner's volumes, a room that is the envelope itself, ports of one fluid only."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from dualms.body.body import Body, make_body
from dualms.domain import Domain
from dualms.mesh import DomainMesh
from dualms.spec import FluidsSpec, Unit
from dualms.surface import extract_surface
from tests.dualms.shapes import box_mesh, domain_of, end_ports, halves, shared_ends

WALL = 0.02
SHELL = 0.03


def built(mesh: DomainMesh, fluids: FluidsSpec, at: float = 0.375) -> tuple[Domain, Body]:
    domain = domain_of(mesh, fluids)
    grid = domain.grid(64, padding=4 + int(np.ceil(SHELL * 64)))
    surface = extract_surface(domain, halves(grid, at), grid, 0.06, SHELL)
    return domain, make_body(domain, surface, WALL, SHELL, outside=True)


@pytest.fixture(scope="module")
def box() -> tuple[Domain, Body]:
    return built(box_mesh(), end_ports())


def test_a_box_grows_by_steiners_formula(box: tuple[Domain, Body]) -> None:
    a, b, c, t = 0.08, 0.06, 0.04, SHELL * 0.08
    grown = a * b * c + 2 * (a * b + b * c + c * a) * t + np.pi * (a + b + c) * t**2 + 4 / 3 * np.pi * t**3
    # Chords of the rounded edges, 1.9 voxels in radius, cut off a little.
    assert box[1].outline_m3 == pytest.approx(grown, rel=6e-4)


def test_a_sphere_grows_by_its_radius() -> None:
    ball = trimesh.creation.icosphere(subdivisions=5, radius=0.03)
    mesh = DomainMesh(np.asarray(ball.vertices), ball.faces.astype(np.int64), Unit.MM)
    ports = {
        "hot": {"inlets": [{"center": (20, -20, 0), "radius": 8}], "outlets": [{"center": (-20, -20, 0), "radius": 8}]},
        "cold": {"inlets": [{"center": (20, 20, 0), "radius": 8}], "outlets": [{"center": (-20, 20, 0), "radius": 8}]},
    }
    for fluid in ports.values():
        for role in fluid.values():
            for port in role:
                port["center"] = tuple(1.5 * x / np.sqrt(2) for x in port["center"])
    _, body = built(mesh, FluidsSpec.model_validate(ports), at=0.5)
    radius = 0.03 + SHELL * 0.06
    assert body.outline_m3 == pytest.approx(4 / 3 * np.pi * radius**3, rel=2e-3)
    assert body.solid.is_closed


def test_the_fluids_have_the_whole_envelope_less_the_wall(box: tuple[Domain, Body]) -> None:
    _, body = box
    passages = 4 * np.pi * 0.008**2 * SHELL * 0.08  # the openings through the shell
    inside = 0.08 * 0.06 * 0.04 - 0.08 * 0.04 * WALL * 0.08
    assert body.hot.mesh.volume + body.cold.mesh.volume == pytest.approx(inside + passages, rel=1e-3)
    filled = body.solid.volume + body.hot.mesh.volume + body.cold.mesh.volume + body.dropped_m3
    assert filled == pytest.approx(body.outline_m3, rel=1e-5)


def test_a_port_opens_to_its_own_fluid_and_is_closed_to_the_other(box: tuple[Domain, Body]) -> None:
    _, body = box
    for fluid, middle in ((body.hot, 0.015), (body.cold, 0.045)):
        for k in (2, 3):
            opening = fluid.mesh.part(fluid.patch == k)
            assert opening.area == pytest.approx(np.pi * 0.008**2, rel=0.02)
            assert np.abs(opening.vertices[:, 1] - middle).max() < 0.0081
    assert body.leak_m3 == 0


def test_a_port_over_both_channels_is_open_to_one() -> None:
    # The disk lies half over the other fluid's channel: that half stays closed.
    document = end_ports().model_dump()
    document["hot"]["inlets"] = [{"center": (0, 28, 20), "radius": 8}]
    document["cold"]["outlets"] = [{"center": (0, 48, 20), "radius": 8}]
    for side in ("inside", "outside"):
        domain = domain_of(box_mesh(), FluidsSpec.model_validate(document))
        grid = domain.grid(64, padding=7)
        surface = extract_surface(domain, halves(grid), grid, 0.06, SHELL)
        body = make_body(domain, surface, WALL, SHELL, side == "outside")
        inlet = body.hot.mesh.part(body.hot.patch == 2)
        edge = 0.03 - WALL / 2 * 0.08
        assert inlet.vertices[:, 1].max() == pytest.approx(edge, abs=2e-4)
        x = np.array([edge - 0.028])
        segment = float((0.008**2 * (np.pi - np.arccos(x / 0.008)) + x * np.sqrt(0.008**2 - x**2))[0])
        assert inlet.area == pytest.approx(segment, rel=0.02)
        cold = body.cold.mesh.part(body.cold.patch == 3)
        assert cold.area == pytest.approx(np.pi * 0.008**2, rel=0.02)


def test_an_opening_shared_by_both_fluids_is_divided_by_the_wall() -> None:
    _, body = built(box_mesh(), shared_ends())
    areas = [f.mesh.part(f.patch == k).area for f in (body.hot, body.cold) for k in (2, 3)]
    rim = 1 / 64 * 0.08
    expected = (0.03 - WALL / 2 * 0.08 - rim) * (0.04 - 2 * rim)
    assert areas == pytest.approx([expected] * 4, rel=0.03)
    assert body.leak_m3 == 0


def test_the_shells_inner_faces_know_their_fluid(box: tuple[Domain, Body]) -> None:
    _, body = box
    middle = body.solid.centroids
    floor = (np.abs(middle[:, 2]) < 1e-9) & (middle[:, 0] > 0) & (middle[:, 0] < 0.08)
    floor &= (middle[:, 1] > 0) & (middle[:, 1] < 0.06)
    assert floor.any()
    assert np.array_equal(body.solid_side[floor], np.where(middle[floor, 1] < 0.03, 1, -1))
