"""How much a partition's channels resist the flow: each side's edges as a network of pipes (ours).

An edge within a side is a channel through the face that its two cells share; laminar flow through it meets a resistance
of length over area squared. The network ranks partitions of one graph: on the U-shape its order is that of the solved
pressure drops, at a thousandth of the cost.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csc_array, diags_array
from scipy.sparse.linalg import spsolve

from dualms.cut.constraints import Labels
from dualms.graph.graph import Graph

OPEN = 1e3  # conductance between a port and a site at it, over the largest of all edges


def network_resistance(graph: Graph, labels: Labels, fluid: int) -> float:
    """Resistance of a fluid's network between its inlets and its outlets, in unit-cube units (length / area²).

    Infinite where a port has no site of the fluid; 0 for a graph without ports.
    """
    ends = {}
    for inlet in (True, False):
        of_role = [
            sites
            for sites, owner, role in zip(graph.ports, graph.port_fluids, graph.port_inlets, strict=True)
            if owner == fluid and role == inlet
        ]
        if not of_role:
            return 0.0
        sites = np.unique(np.concatenate(of_role))
        ends[inlet] = sites[labels[sites] == fluid]
        if len(ends[inlet]) == 0:
            return float("inf")
    own = (labels[graph.edges] == fluid).all(axis=1)
    edges = graph.edges[own]
    lengths = np.linalg.norm(graph.sites[edges[:, 0]] - graph.sites[edges[:, 1]], axis=1)
    conductance = graph.areas[own] ** 2 / lengths
    return _two_ended(len(labels), edges, conductance, ends[True], ends[False])


def _two_ended(
    count: int,
    edges: NDArray[np.int64],
    conductance: NDArray[np.float64],
    inlets: NDArray[np.int64],
    outlets: NDArray[np.int64],
) -> float:
    rows, columns = np.concatenate([edges[:, 0], edges[:, 1]]), np.concatenate([edges[:, 1], edges[:, 0]])
    values = np.concatenate([conductance, conductance])
    largest = float(conductance.max())
    diagonal = np.bincount(rows, values, count)
    diagonal[diagonal == 0] = largest  # the other fluid's sites
    right = np.zeros(count)
    np.add.at(diagonal, inlets, OPEN * largest)
    np.add.at(diagonal, outlets, OPEN * largest)
    np.add.at(right, inlets, OPEN * largest)
    matrix = csc_array(coo_array((-values, (rows, columns)), shape=(count, count)) + diags_array(diagonal))
    pressure = spsolve(matrix, right)
    flow = OPEN * largest * float((1.0 - pressure[inlets]).sum())
    return 1.0 / flow
