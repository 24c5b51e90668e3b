"""Resistance of a partition's network of channels: closed forms, and the choice among equal cuts."""

from __future__ import annotations

import numpy as np
import pytest

from dualms.cut.constraints import violations
from dualms.cut.network import network_resistance
from dualms.cut.partition import max_cut
from dualms.graph.graph import Graph
from dualms.spec import PartitionSpec
from tests.dualms.cut.graphs import delaunay_graph


def _rail(area: float, length: float, rungs: int = 5) -> tuple[Graph, np.ndarray]:
    """Two parallel hot rails of ``rungs`` sites between one inlet and one outlet each, and one cold site."""
    sites = np.array([[k * length, y, 0.0] for y in (0.0, 1.0) for k in range(rungs)] + [[0.0, 5.0, 0.0]])
    edges = np.array([(y * rungs + k, y * rungs + k + 1) for y in (0, 1) for k in range(rungs - 1)])
    ports = (np.array([0, rungs]), np.array([rungs - 1, 2 * rungs - 1]))
    graph = Graph(
        sites,
        edges,
        np.ones(len(edges)),
        np.full(len(edges), area),
        sites[edges].mean(axis=1),
        np.zeros(len(sites), dtype=np.int8),
        (),
        ports,
        np.array([1, 1], dtype=np.int8),
        np.array([True, False]),
    )
    labels = np.ones(len(sites), dtype=np.int8)
    labels[-1] = -1
    return graph, labels


def test_parallel_rails_resist_half_as_much_as_one() -> None:
    graph, labels = _rail(area=0.3, length=0.2)
    exact = 4 * 0.2 / 0.3**2 / 2
    assert network_resistance(graph, labels, 1) == pytest.approx(exact, rel=2e-3)  # ports conduct 1,000 times better


def test_resistance_falls_with_the_square_of_the_area() -> None:
    (thin, labels), (wide, _) = _rail(0.1, 0.2), _rail(0.2, 0.2)
    ratio = network_resistance(thin, labels, 1) / network_resistance(wide, labels, 1)
    assert ratio == pytest.approx(4.0, rel=1e-9)


def test_a_port_without_a_site_of_its_fluid_is_infinite_and_no_port_is_nothing() -> None:
    graph, labels = _rail(0.1, 0.2)
    assert network_resistance(graph, -labels, 1) == float("inf")
    assert network_resistance(graph, labels, -1) == 0.0


def test_slack_buys_channels_of_less_resistance() -> None:
    graph = delaunay_graph(150, 3, ports="shared")
    heaviest = max_cut(graph, PartitionSpec(seconds=0.5, slack=0.0), 0)
    easiest = max_cut(graph, PartitionSpec(seconds=0.5, slack=0.02), 0)
    assert 0.98 * heaviest.cut_weight <= easiest.cut_weight <= heaviest.cut_weight
    assert easiest.resistance_hot + easiest.resistance_cold < heaviest.resistance_hot + heaviest.resistance_cold
    assert not violations(graph, easiest.labels)
