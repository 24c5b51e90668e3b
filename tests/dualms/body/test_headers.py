"""Headers: plain pipes by their closed forms, tapers, and every collision refused by name."""

from __future__ import annotations

import igl
import numpy as np
import pytest
import trimesh
from pydantic import ValidationError

from dualms.body.body import Body, make_body
from dualms.body.headers import headers_of
from dualms.domain import Domain
from dualms.errors import InvalidSpec
from dualms.measure.separation import separation
from dualms.mesh import DomainMesh
from dualms.spec import FluidsSpec, ShellSpec, Unit
from dualms.surface import extract_surface
from tests.dualms.shapes import box_mesh, domain_of, end_ports, halves, shared_ends, small_spec, with_headers

WALL = 0.02
SHELL_MM = 2.4
PLAIN = {"radius": 8, "length": 20, "wall": 1.5}
TAPERED = {"radius": 5, "length": 22, "wall": 1.5, "flange": {"radius": 11, "thickness": 3}}
WIDENED = {"radius": 10, "length": 22, "wall": 1.5}


def built(fluids: FluidsSpec, side: str = "inside") -> tuple[Domain, Body]:
    """Two ducts side by side in the box, a plane wall between them."""
    domain = domain_of(box_mesh(), fluids)
    shell = SHELL_MM / 80
    grid = domain.grid(64, padding=4 + (3 if side == "outside" else 0))
    surface = extract_surface(domain, halves(grid), grid, 0.06, shell)
    headers = headers_of(domain, fluids, Unit.MM, ShellSpec(thickness=SHELL_MM))
    return domain, make_body(domain, surface, WALL, shell, side == "outside", headers)


@pytest.fixture(scope="module", params=["inside", "outside"])
def side(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture(scope="module")
def plain(side: str) -> tuple[Body, Body]:
    """The same body without and with plain pipes as wide as the ports."""
    return built(end_ports(), side)[1], built(with_headers(end_ports(), PLAIN), side)[1]


def test_pipes_add_their_closed_volume(plain: tuple[Body, Body]) -> None:
    bare, piped = plain
    added = piped.outline_m3 - bare.outline_m3
    assert added == pytest.approx(4 * np.pi * 0.0095**2 * 0.020, rel=2e-3)


def test_the_fluid_gains_the_bores(plain: tuple[Body, Body], side: str) -> None:
    bare, piped = plain
    # A bare opening through an outer shell is already part of the fluid.
    for fluid in ("hot", "cold"):
        gain = getattr(piped, fluid).mesh.volume - getattr(bare, fluid).mesh.volume
        assert gain == pytest.approx(2 * np.pi * 0.008**2 * 0.020, rel=0.02)


def test_solid_and_fluids_fill_the_outline_and_do_not_meet(plain: tuple[Body, Body]) -> None:
    for body in plain:
        filled = body.solid.volume + body.hot.mesh.volume + body.cold.mesh.volume + body.dropped_m3
        assert filled == pytest.approx(body.outline_m3, rel=1e-5)
        assert body.leak_m3 == 0
        assert all(mesh.is_closed for mesh in (body.solid, body.hot.mesh, body.cold.mesh))


@pytest.mark.parametrize(("header", "radius"), [(PLAIN, 0.008), (TAPERED, 0.005), (WIDENED, 0.010)])
def test_the_port_lies_at_the_pipes_end(header: dict[str, object], radius: float, side: str) -> None:
    _, body = built(with_headers(end_ports(), header), side)
    skin = SHELL_MM * 1e-3 if side == "outside" else 0.0
    for fluid in (body.hot, body.cold):
        for k in (2, 3):
            port = fluid.mesh.part(fluid.patch == k)
            assert port.area == pytest.approx(np.pi * radius**2, rel=1e-3)
            along = port.vertices[:, 0]
            assert np.ptp(along) < 1e-12
            end = float(header["length"]) * 1e-3 + skin
            assert min(abs(along[0] + end), abs(along[0] - 0.08 - end)) < 1e-8  # single precision at 0.12 m
        assert fluid.components == 1


def test_the_wall_of_a_taper_is_as_thick_as_asked() -> None:
    _, body = built(with_headers(end_ports(), TAPERED))
    # Between the outer and the inner surface of the pipe, seen along the way of the hot inlet (x < 0).
    inner = body.hot.mesh.part(body.hot.patch == 1).vertices
    inner = inner[(inner[:, 0] < -0.004) & (inner[:, 0] > -0.0185)]
    outer = body.solid.part(body.solid_side == 0)
    squared, _, _ = igl.point_mesh_squared_distance(np.ascontiguousarray(inner), outer.vertices, outer.faces)
    assert len(inner) > 100
    assert np.sqrt(squared).min() > 0.98 * 0.0015


@pytest.mark.parametrize(
    "box",
    [
        [(0, 6, 12), (0, 24, 28)],
        [(80, 6, 12), (80, 24, 28)],
        [(20, 0, 12), (38, 0, 28)],
        [(20, 6, 0), (38, 22, 0)],
        [(20, 6, 40), (38, 22, 40)],
    ],
    ids=["-x", "+x", "-y", "-z", "+z"],
)
def test_a_box_port_tapers_to_a_round_pipe(box: list[tuple[int, int, int]]) -> None:
    radius, length, wall = 6.0, 25.0, 1.5
    document = end_ports().model_dump()
    header = {"radius": radius, "length": length, "wall": wall}
    document["hot"]["inlets"] = [{"box": box, "header": header}]
    document["hot"]["outlets"] = [{"center": (60, 0, 20), "radius": 8}]
    _, body = built(FluidsSpec.model_validate(document))
    inlet = body.hot.mesh.part(body.hot.patch == 2)
    assert inlet.area == pytest.approx(np.pi * (1e-3 * radius) ** 2, rel=1e-3)
    # Between a round pipe and a prism over the port.
    round_area, box_area = np.pi * (radius + wall) ** 2, (18 + 2 * wall) * (16 + 2 * wall)
    added = 1e9 * (body.outline_m3 - 0.080 * 0.060 * 0.040)
    assert round_area * length < added < box_area * length
    assert body.hot.components == 1
    assert body.leak_m3 == 0
    assert body.solid.is_closed
    assert (body.crossing, body.hot.crossing, body.cold.crossing) == (0, 0, 0)


def test_solid_faces_of_the_bores_belong_to_their_fluid() -> None:
    _, body = built(with_headers(end_ports(), PLAIN))
    middle = body.solid.centroids
    bore = (middle[:, 0] < -0.002) & (np.hypot(middle[:, 1] - 0.015, middle[:, 2] - 0.02) < 0.0081)
    bore &= middle[:, 0] > -0.0199
    assert bore.any()
    assert (body.solid_side[bore] == 1).all()


@pytest.mark.parametrize(
    ("header", "message"),
    [
        ({"radius": 2, "length": 6, "wall": 1.5}, "taper at 45°"),
        ({"radius": 8, "length": 20, "wall": 1.5, "flange": {"radius": 9, "thickness": 2}}, "flange"),
        ({"radius": 8, "length": 20, "wall": 1.5, "flange": {"radius": 25, "thickness": 2}}, "run into each other"),
        ({"radius": 8, "length": 20, "wall": 15}, "stands on port"),
    ],
)
def test_a_header_that_cannot_stand_is_refused(header: dict[str, object], message: str) -> None:
    with pytest.raises(InvalidSpec, match=message):
        built(with_headers(end_ports(), header))


def test_a_disk_that_runs_over_an_edge_cannot_carry_a_pipe() -> None:
    document = end_ports().model_dump()
    document["hot"]["inlets"] = [{"center": (0, 3, 20), "radius": 8, "header": PLAIN}]
    with pytest.raises(InvalidSpec, match="runs over an edge"):
        built(FluidsSpec.model_validate(document))


def test_a_shared_opening_with_a_header_is_refused_at_once() -> None:
    with pytest.raises(ValidationError, match="both fluids share"):
        with_headers(shared_ends(), PLAIN)


def test_a_header_without_a_shell_is_refused_at_once() -> None:
    with pytest.raises(ValidationError, match="needs a shell"):
        small_spec(with_headers(end_ports(), PLAIN), shell=None)


def test_a_whole_facet_tapers_to_a_round_pipe_and_shuts_the_other_fluid_out() -> None:
    mesh = box_mesh()
    end = next(k for k, facet in enumerate(mesh.facets) if facet.normal[0] < -0.9)
    document = end_ports().model_dump()
    document["hot"]["inlets"] = [{"facet": end, "header": {"radius": 10, "length": 50, "wall": 1.5}}]
    document["cold"]["outlets"] = [{"center": (20, 60, 20), "radius": 8}]
    _, body = built(FluidsSpec.model_validate(document))
    inlet = body.hot.mesh.part(body.hot.patch == 2)
    assert inlet.area == pytest.approx(np.pi * 0.010**2, rel=1e-3)
    assert np.ptp(inlet.vertices[:, 0]) < 1e-12
    # The plenum lies over the cold channel too, a shell's thickness away from it.
    assert body.leak_m3 == 0
    assert body.cold.mesh.vertices[:, 0].min() == pytest.approx(SHELL_MM * 1e-3, rel=0.02)
    assert body.solid.is_closed
    found = separation(body, 0.001)
    assert (found.hot_to_cold, found.to_outside, found.ports_apart) == (0, 0, 0)


def test_pipes_stand_on_a_curved_envelope(side: str) -> None:
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.03)
    mesh = DomainMesh(np.asarray(ball.vertices), ball.faces.astype(np.int64), Unit.MM)
    at = 30 / np.sqrt(2)
    header = {"radius": 5, "length": 25, "wall": 1.5}

    def port(x: float, y: float) -> dict[str, object]:
        return {"center": (x * at, y * at, 0), "radius": 7, "header": header}

    fluids = FluidsSpec.model_validate(
        {
            "hot": {"inlets": [port(1, -1)], "outlets": [port(-1, -1)]},
            "cold": {"inlets": [port(1, 1)], "outlets": [port(-1, 1)]},
        }
    )
    domain = domain_of(mesh, fluids)
    shell = 1.8 / 60
    grid = domain.grid(64, padding=7)
    surface = extract_surface(domain, halves(grid, 0.5), grid, 0.06, shell)
    headers = headers_of(domain, fluids, Unit.MM, ShellSpec(thickness=1.8))
    body = make_body(domain, surface, WALL, shell, side == "outside", headers)
    reach = 0.030 + 0.025 + (0.0018 if side == "outside" else 0.0)
    for fluid in (body.hot, body.cold):
        for k in (2, 3):
            end = fluid.mesh.part(fluid.patch == k)
            assert end.area == pytest.approx(np.pi * 0.005**2, rel=1e-3)
            middle = np.average(end.centroids, axis=0, weights=end.areas)
            assert np.linalg.norm(middle) == pytest.approx(reach, rel=0.01)
    assert body.leak_m3 == 0
    assert body.solid.is_closed
    found = separation(body, 0.001)
    assert (found.hot_to_cold, found.to_outside, found.ports_apart) == (0, 0, 0)
