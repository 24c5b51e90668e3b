"""The cut: constraints on random graphs, optimum on small ones, Algorithm 1 never beaten by less."""

from __future__ import annotations

from dataclasses import replace

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dualms.cut.anneal import anneal
from dualms.cut.constraints import cut_weight, problem_of, violations
from dualms.cut.greedy import greedy
from dualms.cut.partition import max_cut
from dualms.cut.start import first_partition
from dualms.errors import InfeasiblePartition
from dualms.graph.graph import site_graph
from dualms.spec import GraphSpec, PartitionSpec
from tests.dualms.cut.graphs import bare_graph, delaunay_graph
from tests.dualms.shapes import box_mesh, domain_of, shared_ends

QUICK = PartitionSpec(seconds=0.03)
GREEDY = PartitionSpec(method="greedy")


@settings(max_examples=40, deadline=None)
@given(
    count=st.integers(40, 160),
    seed=st.integers(0, 10**6),
    transverse=st.sampled_from([1.0, 5.0, 20.0]),
    ports=st.sampled_from(["none", "dedicated", "shared"]),
    method=st.sampled_from(["greedy", "anneal"]),
)
def test_partition_keeps_every_constraint(count: int, seed: int, transverse: float, ports: str, method: str) -> None:
    graph = delaunay_graph(count, seed, transverse, ports)
    found = max_cut(graph, PartitionSpec(method=method, seconds=0.005), seed)
    check = nx.Graph(graph.edges.tolist())
    weight = 0.0
    for side in (1, -1):
        part = check.subgraph(np.flatnonzero(found.labels == side).tolist())
        assert nx.is_connected(part)
        assert min(degree for _, degree in part.degree) >= 2
    for (i, j), w in zip(graph.edges, graph.weights, strict=True):
        weight += w if found.labels[i] != found.labels[j] else 0.0
    assert weight == pytest.approx(found.cut_weight)
    assert found.cut_weight <= found.upper_bound <= found.total_weight
    assert (found.labels[graph.pins != 0] == graph.pins[graph.pins != 0]).all()
    for opening in graph.openings:
        assert set(found.labels[opening]) == {1, -1}
    assert not violations(graph, found.labels)
    assert (np.diff(found.history[:, 1]) >= 0).all()
    assert found.history[-1, 1] == pytest.approx(found.cut_weight)


def test_annealing_beats_algorithm_1_by_four_percent_at_300_sites() -> None:
    domain = domain_of(box_mesh(), shared_ends())
    gains = []
    for seed in range(3):
        graph = site_graph(domain, None, GraphSpec(sites=300), seed)
        problem = problem_of(graph)
        start = first_partition(graph, problem, seed)
        best, _ = anneal(problem, start, 300_000, seed)  # 0.03 s
        gains.append(cut_weight(graph, best) / cut_weight(graph, greedy(problem, start)[0]))
    assert np.mean(gains) > 1.04


@pytest.mark.parametrize("seconds", [1e-6, 1e-4, 0.01])
def test_annealing_is_never_below_algorithm_1(seconds: float) -> None:
    for seed in range(5):
        graph = delaunay_graph(60, seed, 5.0, "dedicated")
        found = max_cut(graph, PartitionSpec(seconds=seconds), seed)
        assert found.cut_weight >= max_cut(graph, GREEDY, seed).cut_weight


def test_partition_repeats_for_a_seed_and_differs_between_seeds() -> None:
    graph = delaunay_graph(120, 0)
    a, b, c = (max_cut(graph, QUICK, seed).labels for seed in (5, 5, 6))
    assert a.tobytes() == b.tobytes()
    assert a.tobytes() != c.tobytes()


def test_cut_weight_is_invariant_under_relabelling_of_sites() -> None:
    graph = delaunay_graph(90, 1)
    labels = max_cut(graph, QUICK, 0).labels
    order = np.random.default_rng(0).permutation(90)
    renamed = np.argsort(order)
    edges = np.sort(renamed[graph.edges], axis=1)
    place = np.lexsort((edges[:, 1], edges[:, 0]))
    other = bare_graph(graph.sites[order], edges[place], graph.weights[place], graph.pins[order])
    assert cut_weight(other, labels[order]) == cut_weight(graph, labels)
    assert cut_weight(graph, -labels) == cut_weight(graph, labels)
    assert max_cut(other, QUICK, 0).upper_bound == pytest.approx(max_cut(graph, QUICK, 0).upper_bound, rel=1e-6)


def test_greedy_stops_where_no_single_change_helps() -> None:
    graph = delaunay_graph(80, 2)
    found = max_cut(graph, GREEDY, 0)
    for v in range(80):
        changed = found.labels.copy()
        changed[v] = -changed[v]
        assert cut_weight(graph, changed) <= found.cut_weight + 1e-9 or violations(graph, changed)


def test_a_site_with_one_neighbour_is_refused_by_name() -> None:
    graph = delaunay_graph(30, 0)
    sites = np.concatenate([graph.sites, [[3.0, 0.5, 0.5]]])
    edges = np.concatenate([graph.edges, [[29, 30]]])
    bad = bare_graph(sites, edges, np.ones(len(edges)), np.zeros(31, dtype=np.int8))
    with pytest.raises(InfeasiblePartition, match=r"Site 30 .* has 1 neighbours") as caught:
        max_cut(bad, QUICK, 0)
    assert "more sites" in caught.value.advice


def test_ports_that_wall_each_other_off_are_refused() -> None:
    # A ladder: the cold pins across its middle cut the hot pins at its ends apart.
    rungs = 8
    sites = np.array([[x, y, 0.0] for x in range(rungs) for y in (0, 1)], dtype=float)
    pairs = [(2 * x, 2 * x + 1) for x in range(rungs)]
    pairs += [(2 * x + y, 2 * x + 2 + z) for x in range(rungs - 1) for y in (0, 1) for z in (0, 1)]
    edges = np.array(sorted(pairs))
    pins = np.zeros(2 * rungs, dtype=np.int8)
    pins[[0, 1, 14, 15]] = 1
    pins[[6, 7]] = -1
    graph = replace(
        bare_graph(sites, edges, np.ones(len(edges)), pins),
        ports=tuple(np.array(own) for own in ([0, 1], [14, 15], [6], [7])),
        port_fluids=np.array([1, 1, -1, -1], dtype=np.int8),
        port_inlets=np.array([True, False, True, False]),
    )
    with pytest.raises(InfeasiblePartition, match=r"site 0 .*hot-inlet-0.* site 14 .*hot-outlet-0") as caught:
        max_cut(graph, QUICK, 0)
    assert caught.value.advice
    assert caught.value.measured["site"] == 14


@pytest.mark.parametrize("ports", ["none", "dedicated", "shared"])
@pytest.mark.parametrize("share", [0.35, 0.6])
def test_the_hot_fluid_gets_its_share(ports: str, share: float) -> None:
    graph = delaunay_graph(150, 11, ports=ports)
    for method in ("greedy", "anneal"):
        found = max_cut(graph, PartitionSpec(method=method, seconds=0.02, hot_share=share), 0)
        assert abs((found.labels == 1).mean() - share) <= 0.02 + 1 / 150
        assert not violations(graph, found.labels)
