"""The bound: never below the optimum, which a mixed-integer program proves on small graphs."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from scipy.optimize import Bounds, LinearConstraint, milp

from dualms.cut import bound
from dualms.cut.bound import rows, triangles, upper_bound
from dualms.cut.constraints import cut_weight, violations
from dualms.cut.partition import max_cut
from dualms.cut.wheels import RINGS, wheels
from dualms.graph.graph import Graph
from dualms.spec import PartitionSpec
from tests.dualms.cut.graphs import bare_graph, delaunay_graph


def _optimum_without_connectivity(graph: Graph) -> float:
    """Largest cut with the degree and pin constraints only, proven by HiGHS; no connected one can be larger."""
    count, edges = len(graph.sites), graph.edges
    variables = len(edges) + count  # cut edges, then sides
    lines, right = [], []
    for k, (i, j) in enumerate(edges):
        for sign in ((1, 1, 2.0), (-1, -1, 0.0)):  # cut ≤ 2 - x_i - x_j, cut ≤ x_i + x_j
            line = np.zeros(variables)
            line[k], line[len(edges) + i], line[len(edges) + j] = 1, sign[0], sign[1]
            lines.append(line)
            right.append(sign[2])
    degree = np.bincount(edges.ravel(), minlength=count)
    for v in range(count):
        line = np.zeros(variables)
        line[: len(edges)] = (edges == v).any(axis=1)
        lines.append(line)
        right.append(degree[v] - 2.0)
    matrix, limit = rows(graph, np.arange(len(edges)))
    tight = np.hstack([matrix.toarray(), np.zeros((matrix.shape[0], count))])
    highest = np.ones(variables)
    if not graph.pins.any():
        highest[len(edges) + int(degree.argmax())] = 0  # the fluids may change places: one site's is given
    result = milp(
        np.concatenate([-graph.weights, np.zeros(count)]),
        constraints=LinearConstraint(np.vstack([*lines, tight]), ub=np.concatenate([right, limit])),
        integrality=np.ones(variables),
        bounds=Bounds(0, highest),
    )
    assert result.status == 0
    return float(-result.fun)


@pytest.mark.parametrize(
    ("count", "transverse"),
    [(16, 1.0), (24, 1.0), (36, 5.0), *(pytest.param(60, a, marks=pytest.mark.slow) for a in (1.0, 5.0))],
)
def test_annealing_is_optimal_on_small_graphs(count: int, transverse: float) -> None:
    graph = delaunay_graph(count, 7, transverse)
    found = max_cut(graph, PartitionSpec(seconds=0.1), 0)
    optimum = _optimum_without_connectivity(graph)
    assert found.cut_weight <= optimum + 1e-6 <= found.upper_bound + 1e-5
    assert found.cut_weight == pytest.approx(optimum)


def test_bound_holds_for_every_partition_of_a_small_graph() -> None:
    graph = delaunay_graph(12, 3)
    best = max(
        (
            cut_weight(graph, labels)
            for labels in (np.array((1, *rest), dtype=np.int8) for rest in product((-1, 1), repeat=11))
            if not violations(graph, labels)
        ),
        default=0.0,
    )
    assert 0 < best <= upper_bound(graph) + 1e-9


def test_bound_of_blocks_is_a_bound_too(monkeypatch: pytest.MonkeyPatch) -> None:
    graph = delaunay_graph(150, 1)
    whole = upper_bound(graph)
    monkeypatch.setattr(bound, "LARGEST_LP", 300)
    assert whole <= upper_bound(graph) <= graph.weights.sum()


@pytest.mark.parametrize("ring", RINGS)
def test_no_partition_cuts_more_of_a_wheel_than_its_row_allows(ring: int) -> None:
    around = [tuple(sorted((2 + k, 2 + (k + 1) % ring))) for k in range(ring)]
    edges = np.array(sorted([(0, 1), *product((0, 1), range(2, 2 + ring)), *around]))
    wheel = wheels(edges, ring + 2, ring)[0]
    assert set(wheel) == set(range(len(edges)))
    partitions = (np.array(sides) for sides in product((0, 1), repeat=ring + 2))
    assert max(int((sides[edges[wheel, 0]] != sides[edges[wheel, 1]]).sum()) for sides in partitions) == 2 * ring


def test_wheels_of_the_complete_graph() -> None:
    edges = np.array([(i, j) for i in range(6) for j in range(i + 1, 6)])
    # K6 holds 6 K5s, each with 10 edges as hubs of the triangle of the others.
    assert len(wheels(edges, 6, 3)) == 60
    assert len(wheels(edges, 6, 5)) == 0


def test_triangles_of_the_complete_graph() -> None:
    edges = np.array([(i, j) for i in range(6) for j in range(i + 1, 6)])
    found = triangles(edges, 6)
    assert len(found) == 20
    assert len(np.unique(np.sort(found, axis=1), axis=0)) == 20


def test_pinned_ends_count_in_the_bound() -> None:
    graph = delaunay_graph(60, 4, ports="dedicated")
    free = bare_graph(graph.sites, graph.edges, graph.weights, np.zeros(60, dtype=np.int8))
    assert upper_bound(graph) <= upper_bound(free) + 1e-6
