"""Awkward geometry: a sound body, or a refusal with a stable code and advice; never a broken mesh."""

from __future__ import annotations

from collections.abc import Callable

import networkx as nx
import numpy as np
import pytest
import trimesh

from dualms.body.body import Body, make_body
from dualms.cut.partition import Partition, max_cut
from dualms.domain import Domain
from dualms.errors import (
    ChannelBlocked,
    DisconnectedDomain,
    DualMSError,
    InfeasiblePartition,
    InvalidSpec,
    OverlappingPorts,
    PortNotOnBoundary,
    WallTooThick,
)
from dualms.flow import flow_field
from dualms.graph.graph import Graph, site_graph
from dualms.grid import Grid
from dualms.mesh import DomainMesh
from dualms.ports import resolve_ports
from dualms.progress import Silent
from dualms.skeletons import skeletons
from dualms.spec import FluidsSpec, GraphSpec, PartitionSpec, PotentialFlow, Unit
from dualms.surface import extract_surface
from tests.dualms.shapes import box_mesh, domain_of, end_ports, gyroid, halves, shared_ends

WALL, SHELL = 0.02, 0.03  # of the box's 80 mm: 1.6 and 2.4 mm
RIM = 80 * SHELL
Values = Callable[[Grid], np.ndarray]


def _disk(x: float, y: float, z: float, radius: float) -> dict[str, object]:
    return {"center": (x, y, z), "radius": radius}


def _fluids(**ports: dict[str, object]) -> FluidsSpec:
    """Counter-flow through four disks, some of them replaced: ``hot_inlets=…``."""
    base = end_ports().model_dump()
    for key, port in ports.items():
        fluid, role = key.split("_")
        base[fluid][role] = [port]
    return FluidsSpec.model_validate(base)


def _body(
    domain: Domain, values: Values = halves, wall: float = WALL, shell: float = SHELL, resolution: int = 40
) -> Body:
    """A sound body of the domain, whatever its shape: all that is asserted here holds or it was refused."""
    grid = domain.grid(resolution, padding=4)
    surface = extract_surface(domain, values(grid), grid, wall / 2 + 2.5 * grid.spacing, shell)
    body = make_body(domain, surface, wall, shell, unit_m=1e-3)
    assert all(mesh.is_closed for mesh in (body.solid, body.hot.mesh, body.cold.mesh))
    assert body.crossing == body.hot.crossing == body.cold.crossing == 0
    assert body.hot.components == body.cold.components == 1
    assert body.leak_m3 == 0
    filled = body.solid.volume + body.hot.mesh.volume + body.cold.mesh.volume + body.dropped_m3
    assert filled == pytest.approx(body.outline_m3, rel=1e-5)
    return body


def _opening(body: Body, side: str, name: str) -> float:
    """Area of one opening, mm²."""
    fluid = body.hot if side == "hot" else body.cold
    return 1e6 * float(fluid.mesh.areas[fluid.patch == fluid.patches.index(name)].sum())


def _refusal(kind: type[DualMSError], make: Callable[[], object]) -> DualMSError:
    """The refusal, which must say what to try and give its figures."""
    with pytest.raises(kind) as refused:
        make()
    assert refused.value.code == kind.code
    assert refused.value.advice
    assert refused.value.measured
    return refused.value


# --- ports that touch or overlap ----------------------------------------------------------------------------------


def test_disks_that_touch_are_both_opened_and_do_not_leak() -> None:
    body = _body(domain_of(box_mesh(), _fluids(hot_inlets=_disk(0, 20, 20, 10), cold_outlets=_disk(0, 40, 20, 10))))
    # Each disk of 10 mm ends where the wall does, 0.8 mm before the plane in which they touch.
    cut = 100 * np.arccos(0.92) - 9.2 * np.sqrt(100 - 9.2**2)
    for side, name in (("hot", "inlet-0"), ("cold", "outlet-0")):
        assert _opening(body, side, name) == pytest.approx(np.pi * 100 - cut, rel=0.02)


@pytest.mark.parametrize("shell", [0.0, SHELL])
def test_boxes_with_a_common_side_are_both_opened_up_to_wall_and_shell(shell: float) -> None:
    fluids = _fluids(hot_inlets={"box": [(0, 0, 0), (0, 30, 40)]}, cold_outlets={"box": [(0, 30, 0), (0, 60, 40)]})
    body = _body(domain_of(box_mesh(), fluids), shell=shell)
    rim = 80 * shell
    for side, name in (("hot", "inlet-0"), ("cold", "outlet-0")):
        assert _opening(body, side, name) == pytest.approx((30 - 0.8 - rim) * (40 - 2 * rim), rel=0.02)


def _cut(fluids: FluidsSpec) -> tuple[Graph, Partition]:
    domain = domain_of(box_mesh(), fluids)
    flow = flow_field(domain, PotentialFlow(), 1e-3, progress=Silent())
    graph = site_graph(domain, flow, GraphSpec(sites=40), 0, progress=Silent())
    partition = max_cut(graph, PartitionSpec(seconds=0.05), 0, progress=Silent())
    skeletons(domain, graph, partition)
    return graph, partition


def test_touching_ports_get_fluids_of_one_piece() -> None:
    graph, partition = _cut(_fluids(hot_inlets=_disk(0, 20, 20, 10), cold_outlets=_disk(0, 40, 20, 10)))
    whole = nx.Graph(graph.edges.tolist())
    for side in (1, -1):
        assert nx.is_connected(whole.subgraph(np.flatnonzero(partition.labels == side).tolist()))


def test_touching_ports_below_a_sites_cell_are_refused_by_name() -> None:
    with pytest.raises(InfeasiblePartition, match=r"cold-outlet-0 .* hot-inlet-0") as refused:
        _cut(_fluids(hot_inlets=_disk(0, 29, 20, 1), cold_outlets=_disk(0, 31, 20, 1)))
    assert "more sites" in refused.value.advice


@pytest.mark.parametrize(
    ("ports", "share"),
    [
        ({"hot_inlets": _disk(0, 30, 20, 12), "cold_outlets": _disk(0, 34, 20, 4)}, 1.0),
        ({"hot_inlets": _disk(0, 30, 20, 100)}, 1.0),
        ({"hot_outlets": _disk(0, 15, 20, 8)}, 1.0),
    ],
    ids=["one in another", "one over the whole face", "inlet is outlet"],
)
def test_ports_that_overlap_are_refused(ports: dict[str, dict[str, object]], share: float) -> None:
    error = _refusal(OverlappingPorts, lambda: resolve_ports(box_mesh(), _fluids(**ports), Unit.MM))
    assert error.measured["overlap"] == pytest.approx(share)
    assert ("share the opening" in error.advice) == ("hot_outlets" not in ports)


# --- ports in the wrong place or of the wrong size ----------------------------------------------------------------


@pytest.mark.parametrize(
    "port", [_disk(-20, 15, 20, 8), {"box": [(30, 20, 10), (50, 40, 30)]}], ids=["beside the box", "inside the box"]
)
def test_a_port_off_the_surface_is_refused_with_the_nearest_point(port: dict[str, object]) -> None:
    error = _refusal(PortNotOnBoundary, lambda: resolve_ports(box_mesh(), _fluids(hot_inlets=port), Unit.MM))
    assert "nearest boundary point" in error.message
    assert error.measured["gap_m"] > 0.009


@pytest.mark.parametrize("port", [_disk(0, 30, 20, 100), {"box": [(-50, -50, -50), (0, 110, 90)]}], ids=["disk", "box"])
def test_a_port_larger_than_its_face_opens_the_face_up_to_the_shell(port: dict[str, object]) -> None:
    body = _body(domain_of(box_mesh(), _fluids(hot_inlets=port, cold_outlets=_disk(40, 60, 20, 8))))
    assert _opening(body, "hot", "inlet-0") == pytest.approx((30 - 0.8 - RIM) * (40 - 2 * RIM), rel=0.02)


def test_a_port_round_the_whole_domain_is_refused() -> None:
    port = {"box": [(-50, -50, -50), (110, 110, 90)]}
    error = _refusal(InvalidSpec, lambda: resolve_ports(box_mesh(), _fluids(hot_inlets=port), Unit.MM))
    assert "opposite directions" in error.message


@pytest.mark.parametrize(
    ("port", "turned"),
    [({"box": [(0, 0, 0), (8, 8, 8)]}, 3), ({"box": [(0, 0, 10), (8, 8, 30)]}, 2)],
    ids=["corner", "edge"],
)
def test_a_box_over_a_corner_or_an_edge_is_refused(port: dict[str, object], turned: int) -> None:
    error = _refusal(InvalidSpec, lambda: resolve_ports(box_mesh(), _fluids(hot_inlets=port), Unit.MM))
    assert "edge or a corner" in error.message
    assert error.measured["facing"] == 0  # all faces turn from the mean by acos(1/√turned), 45° or more


def test_a_box_that_reaches_round_an_edge_opens_its_larger_face_alone() -> None:
    body = _body(domain_of(box_mesh(), _fluids(hot_inlets={"box": [(0, 0, 10), (4, 12, 30)]})))
    assert _opening(body, "hot", "inlet-0") == pytest.approx((12 - RIM) * 20, rel=0.02)
    fluid = body.hot
    opening = fluid.mesh.part(fluid.patch == fluid.patches.index("inlet-0"))
    assert np.abs(opening.vertices[:, 0]).max() < 1e-9


def test_a_disk_on_a_corner_opens_a_quarter_of_it_on_one_face() -> None:
    body = _body(domain_of(box_mesh(), _fluids(hot_inlets=_disk(0, 0, 0, 12))))
    radii = np.linspace(0, 12, 2001)
    # The quarter of the disk beyond the shell of both neighbouring faces.
    y, z = np.meshgrid(radii, radii)
    quarter = float(((y > RIM) & (z > RIM) & (y**2 + z**2 < 144)).mean()) * 144
    assert _opening(body, "hot", "inlet-0") == pytest.approx(quarter, rel=0.05)


@pytest.mark.parametrize(
    "port",
    [_disk(0, 0, 0, 2), _disk(0, 15, 20, 0.5), _disk(0, 45, 20, 8)],
    ids=["within the shell", "below a voxel", "on the other fluid"],
)
def test_a_port_that_does_not_reach_its_fluid_is_named(port: dict[str, object]) -> None:
    fluids = _fluids(hot_inlets=port, cold_outlets=_disk(40, 60, 20, 8))
    error = _refusal(ChannelBlocked, lambda: _body(domain_of(box_mesh(), fluids)))
    assert error.measured["missed"] == ["hot-inlet-0"]
    assert "hot-inlet-0" in error.message


# --- walls and necks ----------------------------------------------------------------------------------------------


def test_a_wall_below_half_the_channels_stands() -> None:
    _body(domain_of(box_mesh(), shared_ends()), lambda grid: gyroid(grid, 0.5), wall=0.3 * 0.25)


@pytest.mark.parametrize("share", [0.9, 1.5])
def test_a_wall_thicker_than_the_channels_is_refused(share: float) -> None:
    """Over the distance between two sheets of the gyroid, half a cell."""
    domain = domain_of(box_mesh(), shared_ends())
    with pytest.raises((WallTooThick, ChannelBlocked)) as refused:
        _body(domain, lambda grid: gyroid(grid, 0.5), wall=share * 0.25)
    assert refused.value.advice
    assert refused.value.measured


def _dumbbell(neck: float) -> DomainMesh:
    """Two boxes of 30 x 60 x 40 mm, joined by a square bar 20 mm long and ``neck`` wide."""
    low, high = np.array([30.0, 20.0]) - neck / 2, np.array([30.0, 20.0]) + neck / 2
    parts = [
        trimesh.creation.box(bounds=[(0, 0, 0), (30, 60, 40)]),
        trimesh.creation.box(bounds=[(50, 0, 0), (80, 60, 40)]),
        trimesh.creation.box(bounds=[(29, *low), (51, *high)]),
    ]
    made = trimesh.boolean.union(parts, engine="manifold")
    return DomainMesh(np.asarray(made.vertices) * 1e-3, np.asarray(made.faces, dtype=np.int64), Unit.MM)


def test_a_neck_wide_enough_for_both_fluids_and_their_walls_is_built() -> None:
    body = _body(domain_of(_dumbbell(16), shared_ends()))
    assert _opening(body, "hot", "inlet-0") > 500


@pytest.mark.parametrize("neck", [4.0, 6.0])
def test_a_neck_that_wall_and_shell_fill_is_refused(neck: float) -> None:
    # Twice the shell and the wall take 6.4 mm.
    error = _refusal(ChannelBlocked, lambda: _body(domain_of(_dumbbell(neck), shared_ends())))
    assert error.measured["ports_reached"] == 1


def test_a_neck_below_the_grid_is_refused_at_once() -> None:
    domain = domain_of(_dumbbell(0.5), shared_ends())
    error = _refusal(DisconnectedDomain, lambda: domain.inside(domain.grid(40)))
    assert error.measured["parts"] == 2
