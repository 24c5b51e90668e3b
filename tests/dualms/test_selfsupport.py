"""Self-support: the map is exact, and walls designed in the compressed space stand steeper."""

from __future__ import annotations

import numpy as np
import pytest

from dualms.cut.partition import max_cut
from dualms.domain import Domain
from dualms.field.field import Field, History
from dualms.field.network import Network
from dualms.field.samples import GridSamples
from dualms.field.solve import solve_field
from dualms.flow import flow_field
from dualms.graph.graph import site_graph
from dualms.grid import Grid
from dualms.measure.printing import OVERHANG_DEGREES
from dualms.progress import Silent
from dualms.selfsupport import Compression, compression, random_share
from dualms.skeletons import skeletons
from dualms.spec import DirectionFlow, GraphSpec, PartitionSpec, PhaseField, PotentialFlow, SelfSupportSpec
from dualms.steps import step_keys
from dualms.surface import extract_surface
from tests.dualms.shapes import box_mesh, domain_of, end_ports, shared_ends, small_spec

UP = np.array([0.0, 0.0, 1.0])
OBLIQUE = np.array([1.0, 2.0, 2.0])


@pytest.fixture(scope="module")
def box() -> Domain:
    return domain_of(box_mesh(), end_ports())


def test_points_come_back(box: Domain) -> None:
    points = np.random.default_rng(0).uniform(-0.1, 1.1, (100, 3))
    frame = Compression.of(box, OBLIQUE, 1.7)
    np.testing.assert_allclose(frame.back(frame.points(points)), points, atol=1e-12)


@pytest.mark.parametrize("steepness", [1.5, 2.0])
def test_a_box_is_lower_by_the_factor_and_fits_the_unit_cube(box: Domain, steepness: float) -> None:
    inner = Compression.of(box, UP, steepness).domain(box)
    np.testing.assert_allclose(inner.bounds[0], 0, atol=1e-12)
    np.testing.assert_allclose(inner.bounds[1], [1, 0.75, 0.5 / steepness], atol=1e-12)
    assert inner.volume == pytest.approx(box.volume / steepness)
    for ours, theirs in zip(inner.ports, box.ports, strict=True):
        assert np.abs(inner.signed_distance(ours.samples)).max() < 1e-9
        np.testing.assert_allclose(ours.normal, theirs.normal, atol=1e-9)
        # The end faces stand along the build direction: they lose height.
        assert ours.area == pytest.approx(theirs.area / steepness)


def test_an_oblique_compression_keeps_normals_normal(box: Domain) -> None:
    frame = Compression.of(box, OBLIQUE, 2.0)
    for port in frame.domain(box).ports:
        flat = port.samples - port.samples.mean(axis=0)
        assert np.abs(flat @ port.normal).max() < 1e-9


def test_guidance_turns_with_the_space(box: Domain) -> None:
    flow = flow_field(box, DirectionFlow(kind="direction", vector=(1, 0, 1)))
    assert flow is not None
    frame = Compression.of(box, UP, 2.0)
    turned = frame.flow(flow, frame.domain(box))
    lines = turned.lines(turned.grid.points(turned.inside)[::50])
    expected = np.array([2.0, 0, 1]) / np.sqrt(5)
    np.testing.assert_allclose(np.abs(lines @ expected), 1, atol=1e-6)


def test_a_field_comes_back_as_the_same_surface(box: Domain) -> None:
    frame = Compression.of(box, OBLIQUE, 2.0)
    inner = frame.domain(box)
    low, high = inner.bounds
    grid = Grid.around(low - 0.07, high + 0.07, 48)
    normal = np.array([0.6, 0.0, 0.8])
    values = ((grid.points() - inner.vertices.mean(axis=0)) @ normal).reshape(grid.shape).astype(np.float32)
    field = Field(GridSamples(grid, values), "phase-field", History(("iteration",), np.zeros((1, 1))), "cpu")
    back = frame.field_back(field, box, inner)
    target = box.grid(40)
    points = target.points()
    expected = frame.scale * ((frame.points(points) - inner.vertices.mean(axis=0)) @ normal)
    inside = box.contains(points)
    np.testing.assert_allclose(back.on(target).ravel()[inside], expected[inside], atol=1e-4)


def test_a_networks_field_comes_back_as_samples(box: Domain) -> None:
    frame = Compression.of(box, UP, 1.5)
    inner = frame.domain(box)
    rng = np.random.default_rng(0)
    frequencies = rng.normal(size=(3, 4)).astype(np.float32)
    weights = rng.normal(size=(8, 1)).astype(np.float32)
    network = Network(frequencies, ((weights, np.zeros(1, dtype=np.float32)),))
    field = Field(network, "neural", History(("iteration",), np.zeros((1, 1))), "cpu")
    back = frame.field_back(field, box, inner)
    points = box.vertices.mean(axis=0) + 0.1 * rng.uniform(-1, 1, (50, 3))
    assert isinstance(back.source, GridSamples)
    got = back.source.grid.sample(back.source.values, points)
    exact = frame.scale * network.at(frame.points(points))
    np.testing.assert_allclose(got, exact, atol=5e-3)


def test_share_of_flat_area_of_evenly_spread_normals() -> None:
    assert random_share(1.0) == pytest.approx(1 - 1 / np.sqrt(2), abs=1e-4)
    # By sampling a stretched sphere.
    rng = np.random.default_rng(0)
    n = rng.normal(size=(400_000, 3))
    n /= np.linalg.norm(n, axis=1)[:, None]
    turned = n * [2, 2, 1]  # cofactors of the stretch diag(1, 1, 2)
    area = np.linalg.norm(turned, axis=1)
    flat = np.abs(turned[:, 2]) / area > np.sqrt(0.5)
    assert random_share(2.0) == pytest.approx(area[flat].sum() / area.sum(), abs=2e-3)


def flat_share(domain: Domain, steepness: float) -> float:
    """Share of the separating surface of a small design that lies flatter than 45° to z."""
    frame = compression(domain, SelfSupportSpec(steepness=steepness), (0, 0, 1))
    assert frame is not None
    inner = frame.domain(domain)
    flow = flow_field(domain, PotentialFlow())
    assert flow is not None
    graph = site_graph(inner, frame.flow(flow, inner), GraphSpec(sites=60), 0)
    partition = max_cut(graph, PartitionSpec(seconds=0.05), 0)
    bones = skeletons(inner, graph, partition)
    spec = PhaseField(method="phase-field", resolution=48)
    field = frame.field_back(solve_field(inner, bones, spec, 0, "cpu", None, Silent()), domain, inner)
    grid = domain.grid(64, padding=4)
    mesh = extract_surface(domain, field.on(grid), grid, 0.06).mesh
    steep = np.abs(mesh.crosses[:, 2]) / (2 * mesh.areas) <= np.sin(np.radians(OVERHANG_DEGREES))
    return float(mesh.areas[~steep].sum() / mesh.area)


def test_walls_designed_in_the_compressed_space_stand_steeper() -> None:
    domain = domain_of(box_mesh(), shared_ends())
    plain, steep = flat_share(domain, 1.0), flat_share(domain, 2.0)
    assert steep < 0.5 * plain


def test_the_build_direction_belongs_to_prepare_only_with_self_support() -> None:
    directions = {"build_direction": (0, 0, 1)}, {"build_direction": (1, 0, 0)}
    plain = [step_keys("0" * 64, small_spec(end_ports(), **d)) for d in directions]
    steep = [step_keys("0" * 64, small_spec(end_ports(), self_support={}, **d)) for d in directions]
    assert plain[0]["prepare"] == plain[1]["prepare"]
    assert steep[0]["prepare"] != steep[1]["prepare"]
    assert plain[0]["prepare"] not in (steep[0]["prepare"], steep[1]["prepare"])
