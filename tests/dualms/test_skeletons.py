"""Skeletons: spacing, clearance, ports reached, the JSON for clients."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from dualms.cut.partition import Partition, max_cut
from dualms.domain import Domain
from dualms.graph.graph import Graph, site_graph
from dualms.skeletons import SPACING, Skeletons, sample_segments, skeletons, write_json
from dualms.spec import GraphSpec, PartitionSpec
from tests.dualms.shapes import box_mesh, domain_of, end_ports, shared_ends

Design = tuple[Domain, Graph, Partition, Skeletons]


@pytest.fixture(scope="module", params=["dedicated", "shared"])
def design(request: pytest.FixtureRequest) -> Design:
    domain = domain_of(box_mesh(), end_ports() if request.param == "dedicated" else shared_ends())
    graph = site_graph(domain, None, GraphSpec(sites=80), 0)
    partition = max_cut(graph, PartitionSpec(seconds=0.05), 0)
    return domain, graph, partition, skeletons(domain, graph, partition)


def test_segments_are_sampled_with_both_ends_and_no_gap() -> None:
    points = sample_segments(np.zeros((1, 3)), np.array([[0.1, 0.0, 0.0]]))
    assert len(points) == int(np.ceil(0.1 / SPACING)) + 1
    assert np.diff(points[:, 0]).max() <= SPACING
    np.testing.assert_allclose(points[[0, -1], 0], [0, 0.1])


def test_every_edge_within_a_side_is_covered_once(design: Design) -> None:
    _, graph, partition, found = design
    for side, points, edges in ((1, found.hot, found.hot_edges), (-1, found.cold, found.cold_edges)):
        assert (partition.labels[edges] == side).all()
        assert len(np.unique(edges, axis=0)) == len(edges)
        chosen = (partition.labels[graph.edges] == side).all(axis=1)
        assert cKDTree(points).query(graph.passages[chosen])[0].max() < SPACING
        halfway = (graph.sites[edges] + graph.passages[chosen][:, None]) / 2
        assert cKDTree(points).query(halfway.reshape(-1, 3))[0].max() < SPACING
    cut = (partition.labels[graph.edges[:, 0]] != partition.labels[graph.edges[:, 1]]).sum()
    assert len(found.hot_edges) + len(found.cold_edges) + cut == len(graph.edges)


def test_each_skeleton_is_one_connected_set_of_samples(design: Design) -> None:
    for points in design[3].hot, design[3].cold:
        pairs = cKDTree(points).query_pairs(2.5 * SPACING, output_type="ndarray")
        joined = coo_array((np.ones(len(pairs)), pairs.T), shape=(len(points), len(points)))
        assert connected_components(joined, directed=False)[0] == 1


def test_each_fluid_reaches_each_of_its_ports(design: Design) -> None:
    domain, _, _, found = design
    for port in domain.ports:
        own = found.hot if port.fluid == 1 else found.cold
        distance = cKDTree(own).query(port.samples)[0]
        assert distance.min() < SPACING
        if not port.shared:
            assert np.quantile(distance, 0.9) < 2 * SPACING


def test_ports_keep_clear_of_the_other_fluid(design: Design) -> None:
    domain, _, _, found = design
    for port in domain.ports:
        if not port.shared:
            other = found.cold if port.fluid == 1 else found.hot
            assert cKDTree(other).query(port.samples)[0].min() > 2 * SPACING


def test_json_names_sites_in_metres_and_labels(design: Design, tmp_path: Path) -> None:
    domain, graph, partition, _ = design
    write_json(tmp_path / "skeletons.json", domain, graph, partition)
    document = json.loads((tmp_path / "skeletons.json").read_text())
    np.testing.assert_allclose(document["sites"], graph.sites * 0.08, atol=1e-8)
    assert document["edges"] == graph.edges.tolist()
    assert document["labels"] == partition.labels.tolist()
    for name, side in (("hot", 1), ("cold", -1)):
        assert document["ports"][name]
        assert all(document["labels"][k] == side for k in document["ports"][name])
