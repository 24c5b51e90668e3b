"""The two fluids' skeletons: what the field must separate (paper, sections 4.2 and 5.1).

The paper's skeletons are the edges within either side. Ours also reach the ports: a dedicated port holds a plug of its
fluid, and at a shared opening each cell that touches it is joined to its part of the opening.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from dualms.cut.partition import Partition
from dualms.domain import Domain
from dualms.graph.graph import Graph
from dualms.grid import Array, thinned
from dualms.ports import Port

SPACING = 1 / 256  # paper, section 6.1
PLUG_DEPTH = 0.5  # of the port's radius
LEAST_PLUG = 2 / 256
PLUG_SPACING = 2 / 256  # a solid plug needs no denser samples than a voxel of the field's grid
CLEARANCE = 3 * SPACING  # between a plug or stub and the other fluid's skeleton


@dataclass(frozen=True)
class Skeletons:
    """Samples of both skeletons, unit-cube frame.

    Parameters
    ----------
    hot, cold
        (P, 3) and (Q, 3) float64 samples at a spacing of 1/256.
    hot_edges, cold_edges
        (K, 2) int64, the graph's edges within each side.
    """

    hot: Array
    cold: Array
    hot_edges: NDArray[np.int64]
    cold_edges: NDArray[np.int64]

    def __post_init__(self) -> None:
        for points in (self.hot, self.cold):
            if points.ndim != 2 or points.shape[1] != 3 or len(points) == 0 or not np.isfinite(points).all():
                raise ValueError("each skeleton must be finite points (P, 3), at least one")


def skeletons(domain: Domain, graph: Graph, partition: Partition) -> Skeletons:
    """Sample the edges within each side, and join each fluid to its ports.

    Parameters
    ----------
    domain
        Domain with its ports.
    graph, partition
        Sites, edges, and the side of each site.
    """
    labels = partition.labels
    ends = labels[graph.edges]
    edges = {side: graph.edges[(ends == side).all(axis=1)] for side in (1, -1)}
    bones = {side: _bones(graph, (ends == side).all(axis=1)) for side in (1, -1)}
    trees = {side: cKDTree(points) for side, points in bones.items()}
    joined: dict[int, list[Array]] = {1: [bones[1]], -1: [bones[-1]]}
    nearest = cKDTree(graph.sites)
    for port in domain.ports:
        other = trees[-port.fluid]
        if port.shared:
            stubs = _opening_stubs(port, graph, labels, nearest)
        else:
            stubs = _port_stubs(port, graph, labels, nearest)
            plug = _plug(port)
            plug = plug[domain.signed_distance(plug) > -0.5 * SPACING]
            joined[port.fluid].append(plug[other.query(plug)[0] > CLEARANCE])
        joined[port.fluid] += [_clear_part(sample_segments(*stub), other) for stub in stubs]
    hot, cold = (thinned(np.concatenate(joined[side]), 0.5 * SPACING) for side in (1, -1))
    return Skeletons(hot, cold, edges[1], edges[-1])


def sample_segments(starts: Array, ends: Array, spacing: float = SPACING) -> Array:
    """(P, 3) points along segments, both ends included, at most ``spacing`` apart."""
    if len(starts) == 0:
        return np.zeros((0, 3))
    pieces = np.maximum(np.ceil(np.linalg.norm(ends - starts, axis=1) / spacing).astype(int), 1)
    owner = np.repeat(np.arange(len(starts)), pieces + 1)
    within = np.arange(len(owner)) - np.repeat(np.cumsum(pieces + 1) - (pieces + 1), pieces + 1)
    share = (within / pieces[owner])[:, None]
    return np.asarray(starts[owner] * (1 - share) + ends[owner] * share)


def write_json(path: Path, domain: Domain, graph: Graph, partition: Partition) -> None:
    """Write the graph and its partition for clients; lengths in metres."""
    ports: dict[str, list[int]] = {}
    for side, name in ((1, "hot"), (-1, "cold")):
        own = [
            sites[partition.labels[sites] == side]
            for port, sites in zip(domain.ports, graph.ports, strict=True)
            if port.fluid == side
        ]
        ports[name] = np.unique(np.concatenate(own)).tolist() if own else []
    document = {
        "units": "m",
        "sites": np.round(graph.sites * domain.scale_m + domain.offset_m, 9).tolist(),
        "edges": graph.edges.tolist(),
        "weights": graph.weights.tolist(),
        "labels": partition.labels.tolist(),
        "ports": ports,
    }
    partial = path.with_name(path.name + ".partial")
    partial.write_text(json.dumps(document, separators=(",", ":")))
    partial.replace(path)


def _bones(graph: Graph, chosen: NDArray[np.bool_]) -> Array:
    """Samples of edges, each led through the face that its cells share.

    The paper's edges are straight. A straight edge may cross other cells, and so the other fluid's skeleton; led
    through the shared face it stays in the two cells, whatever their stretch.
    """
    a, b = graph.edges[chosen].T
    passages = graph.passages[chosen]
    return np.concatenate([sample_segments(graph.sites[a], passages), sample_segments(passages, graph.sites[b])])


def _clear_part(samples: Array, other: cKDTree) -> Array:
    """A stub up to where it comes too close to the other fluid's skeleton."""
    close = other.query(samples)[0] <= CLEARANCE
    return samples[: int(close.argmax())] if close.any() else samples


def _opening_stubs(port: Port, graph: Graph, labels: NDArray[np.int8], nearest: cKDTree) -> list[tuple[Array, Array]]:
    """Straight stubs from the fluid's sites at a shared opening to the part of it in their own cells."""
    samples = thinned(port.samples, SPACING)
    sites = nearest.query(samples)[1]
    stubs = []
    for site in np.unique(sites):
        if labels[site] != port.fluid:
            continue
        own = samples[sites == site]
        # The middle of the cell's part of the opening; a segment from a site to its own cell stays in the cell.
        middle = own[((own - own.mean(axis=0)) ** 2).sum(axis=1).argmin()]
        stubs.append((graph.sites[site : site + 1], middle[None]))
    return stubs


def _port_stubs(port: Port, graph: Graph, labels: NDArray[np.int8], nearest: cKDTree) -> list[tuple[Array, Array]]:
    """Straight stubs from a dedicated port to the sites of its fluid that it lies next to."""
    own = np.unique(nearest.query(thinned(port.samples, SPACING))[1])
    own = own[labels[own] == port.fluid]
    if len(own) == 0:
        same = np.flatnonzero(labels == port.fluid)
        own = same[[((graph.sites[same] - port.center) ** 2).sum(axis=1).argmin()]]
    near = cKDTree(port.samples).query(graph.sites[own])[1]
    return [(graph.sites[v : v + 1], port.samples[k : k + 1]) for v, k in zip(own, near, strict=True)]


def _plug(port: Port) -> Array:
    """Points over the port's area, pushed inward layer by layer."""
    depth = max(LEAST_PLUG, PLUG_DEPTH * port.radius)
    face = thinned(port.samples, PLUG_SPACING)
    layers = np.linspace(0.0, depth, int(np.ceil(depth / PLUG_SPACING)) + 1)
    return np.concatenate([face - layer * port.normal for layer in layers])
