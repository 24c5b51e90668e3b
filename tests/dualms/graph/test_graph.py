"""The graph of a domain: pins, openings, weights by Eq. 1."""

from __future__ import annotations

import numpy as np
import pytest

from dualms.errors import InfeasiblePartition
from dualms.flow import flow_field
from dualms.graph.graph import site_graph
from dualms.spec import GraphSpec, PotentialFlow
from tests.dualms.cut.graphs import bare_graph
from tests.dualms.shapes import box_mesh, domain_of, end_ports, shared_ends


def test_dedicated_ports_pin_sites_of_their_fluid() -> None:
    domain = domain_of(box_mesh(), end_ports())
    graph = site_graph(domain, None, GraphSpec(sites=80), 0)
    assert not graph.openings
    for port, sites in zip(domain.ports, graph.ports, strict=True):
        nearest = ((graph.sites - port.center) ** 2).sum(axis=1).argmin()
        assert graph.pins[nearest] == port.fluid
        assert nearest in sites


def test_shared_openings_list_the_sites_at_both_ends_and_pin_nothing() -> None:
    graph = site_graph(domain_of(box_mesh(), shared_ends()), None, GraphSpec(sites=80), 0)
    assert len(graph.openings) == 2
    assert not graph.pins.any()
    assert graph.sites[graph.openings[0], 0].max() < 0.25
    assert graph.sites[graph.openings[1], 0].min() > 0.75


def test_weights_follow_the_angle_to_the_flow() -> None:
    domain = domain_of(box_mesh(), shared_ends())
    flow = flow_field(domain, PotentialFlow(), 1e-3)
    graph = site_graph(domain, flow, GraphSpec(preset="paper", sites=100, transverse_weight=7.0), 0)
    direction = graph.sites[graph.edges[:, 1]] - graph.sites[graph.edges[:, 0]]
    cosine = np.abs(direction[:, 0]) / np.linalg.norm(direction, axis=1)
    clear = np.abs(cosine - np.sqrt(0.5)) > 1e-3
    np.testing.assert_array_equal(graph.weights[clear], np.where(cosine < np.sqrt(0.5), 7.0, 1.0)[clear])


def test_without_guidance_all_weights_are_one() -> None:
    graph = site_graph(domain_of(box_mesh(), end_ports()), None, GraphSpec(sites=60), 0)
    assert (graph.weights == 1).all()


def test_sites_lie_in_the_domain_and_edges_stay_in_it() -> None:
    domain = domain_of(box_mesh(), end_ports())
    graph = site_graph(domain, None, GraphSpec(sites=120), 4)
    assert (domain.signed_distance(graph.sites) > 0).all()


def test_ports_of_different_fluids_in_one_cell_are_refused_by_name() -> None:
    document = end_ports(radius=2.0).model_dump()
    document["cold"]["outlets"] = [{"center": (0.0, 15.0, 24.2), "radius": 2.0}]
    domain = domain_of(box_mesh(), type(end_ports()).model_validate(document))
    refused = []
    for seed in range(4):  # with 8 sites both ports share a cell for most seeds
        try:
            graph = site_graph(domain, None, GraphSpec(sites=8), seed)
        except InfeasiblePartition as error:
            refused.append(error)
        else:
            assert {1, -1} <= set(graph.pins.tolist())
    assert refused
    for error in refused:
        assert "hot-inlet-0" in error.message
        assert "cold-outlet-0" in error.message
        assert "more sites" in error.advice


def test_graph_refuses_edges_named_twice() -> None:
    edges = np.array([[0, 1], [0, 1]])
    with pytest.raises(ValueError, match="named once"):
        bare_graph(np.zeros((2, 3)), edges, np.ones(2), np.zeros(2, dtype=np.int8))


def test_port_density_draws_sites_to_the_ports() -> None:
    domain = domain_of(box_mesh(), shared_ends())
    even, dense = (
        site_graph(domain, None, GraphSpec(sites=120, port_density=factor), 0).sites[:, 0] for factor in (1.0, 4.0)
    )
    near_even, near_dense = (((x < 0.2) | (x > 0.8)).mean() for x in (even, dense))
    assert near_dense > 1.3 * near_even
