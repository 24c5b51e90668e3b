"""The weighted graph of the domain, with what its ports demand of the sites (paper, section 4.1, Eq. 1)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from dualms.domain import Domain, Mask
from dualms.errors import DisconnectedDomain, InfeasiblePartition
from dualms.flow import FlowField
from dualms.graph.edges import Cells, Edges, cell_adjacency, connected_cells, inside_segments, sites_in_cells
from dualms.graph.sites import lloyd, stretched_metric
from dualms.grid import Array, Grid, thinned
from dualms.progress import Progress, Silent
from dualms.spec import GraphSpec

VOXELS_PER_SITE = 400  # about 7 voxels across a cell: faces that matter to the cut are several voxels wide
RESOLUTIONS = (40, 220)
STAIRS = 2 / 3  # area of a plane over that of its voxel faces, the mean over all directions
PORT_SHARE = 0.2  # a site is pinned to a dedicated port where its cell covers this share of the port

Indices = NDArray[np.int64]


@dataclass(frozen=True)
class Graph:
    """Sites, edges, and the ports' demands.

    Parameters
    ----------
    sites
        (N, 3) float64, unit-cube frame.
    edges
        (E, 2) int64, each once, i < j, sorted.
    weights
        (E,) float64, at least 0 (Eq. 1: ``transverse_weight`` across the flow, else 1).
    areas
        (E,) float64, area of the face that the two cells share.
    passages
        (E, 3) float64, a point in the middle of that face: the way from site to site through it stays in both cells.
    pins
        (N,) int8: 1 the site must be hot, -1 cold, 0 free.
    openings
        For each shared opening the sites whose cells touch it: both fluids must have some of them.
    ports
        For each port of the domain, in its order, the sites whose cells touch it.
    port_fluids, port_inlets
        For each port its fluid (1 hot, -1 cold), and whether it is an inlet.
    """

    sites: Array
    edges: Edges
    weights: Array
    areas: Array
    passages: Array
    pins: NDArray[np.int8]
    openings: tuple[Indices, ...]
    ports: tuple[Indices, ...]
    port_fluids: NDArray[np.int8]
    port_inlets: Mask

    def __post_init__(self) -> None:
        count = len(self.sites)
        if self.sites.shape != (count, 3) or not np.isfinite(self.sites).all():
            raise ValueError("sites must be finite points (N, 3)")
        if self.edges.shape != (len(self.weights), 2) or (self.edges[:, 0] >= self.edges[:, 1]).any():
            raise ValueError("edges must be pairs i < j, with a weight each")
        if len(self.edges) and (self.edges.min() < 0 or self.edges.max() >= count):
            raise ValueError("an edge names a site that does not exist")
        keys = self.edges[:, 0] * count + self.edges[:, 1]
        if (np.diff(keys) <= 0).any():
            raise ValueError("edges must be sorted and each named once")
        if not (np.isfinite(self.weights).all() and (self.weights >= 0).all()):
            raise ValueError("weights must be finite and not negative")
        if self.areas.shape != self.weights.shape or not (self.areas > 0).all():
            raise ValueError("each edge needs a positive area")
        if self.passages.shape != (len(self.edges), 3) or not np.isfinite(self.passages).all():
            raise ValueError("each edge needs a passage")
        if not len(self.ports) == len(self.port_fluids) == len(self.port_inlets):
            raise ValueError("each port needs its sites, its fluid and whether it is an inlet")
        if self.pins.shape != (count,) or not np.isin(self.pins, (-1, 0, 1)).all():
            raise ValueError("pins must be -1, 0 or 1 for each site")


def site_graph(
    domain: Domain, flow: FlowField | None, spec: GraphSpec, seed: int, *, progress: Progress | None = None
) -> Graph:
    """Sites, restricted Delaunay edges and weights of a domain.

    Parameters
    ----------
    domain
        Domain with its ports.
    flow
        Guidance; without it all weights are 1 and cells are round.
    spec
        Number of sites, weight across the flow, stretch along it.
    seed
        Seed of the first sites.
    progress
        Where to report to.

    Raises
    ------
    DisconnectedDomain
        If the sites are too few to connect the domain.
    InfeasiblePartition
        If a port's sites all belong to a port of the other fluid.
    """
    progress = progress or Silent()
    resolution = int(np.clip((VOXELS_PER_SITE * spec.sites / domain.volume) ** (1 / 3), *RESOLUTIONS))
    grid = domain.grid(resolution)
    inside = domain.inside(grid)
    points = grid.points(inside)
    if len(points) < 8 * spec.sites:
        raise DisconnectedDomain(
            f"{spec.sites} sites are too many for a domain of {len(points)} voxels.",
            advice="Ask for fewer sites.",
            measured={"sites": spec.sites, "voxels": len(points)},
        )
    metric, spread = None, 1.0
    if flow is not None and spec.stretch > 1:
        metric, spread = stretched_metric(flow.lines(points), flow.strength(points), spec.stretch)
    progress.report("graph", 0.1, f"{len(points)} voxels")
    density = None if spec.port_density == 1 else _density(domain, points, spec)
    tessellation = lloyd(points, spec.sites, seed, metric=metric, spread=spread, density=density, progress=progress)
    cells = connected_cells(inside, tessellation.cells, spec.sites)
    sites = sites_in_cells(grid, cells, tessellation.sites)
    edges, faces, middles = cell_adjacency(cells)
    passages = grid.origin + grid.spacing * middles
    kept = inside_segments(domain, grid, inside, sites[edges[:, 0]], passages)
    kept &= inside_segments(domain, grid, inside, passages, sites[edges[:, 1]])
    passages = passages[kept]
    edges, areas = edges[kept], np.asarray(STAIRS * grid.spacing**2 * faces[kept], dtype=float)
    _refuse_parts(edges, spec.sites)
    progress.report("graph", 0.9, f"{len(edges)} edges")
    weights = edge_weights(sites, edges, flow, spec)
    pins, openings, ports = _port_sites(domain, grid, inside, cells, spec.sites)
    fluids = np.array([port.fluid for port in domain.ports], dtype=np.int8)
    inlets = np.array([port.inlet for port in domain.ports], dtype=bool)
    return Graph(sites, edges, weights, areas, passages, pins, openings, ports, fluids, inlets)


def edge_weights(sites: Array, edges: Edges, flow: FlowField | None, spec: GraphSpec) -> Array:
    """(E,) weights: by Eq. 1 the transverse weight a where an edge is over 45° off the mean line, else 1.

    The smooth form (ours) is 1 + (a - 1) sin²θ: a field of 45° edges is not torn apart by which side of 45° they fall.
    """
    if flow is None:
        return np.ones(len(edges))
    cosine2 = alignment(sites, edges, flow)
    if spec.weighting == "smooth":
        return 1.0 + (spec.transverse_weight - 1.0) * (1.0 - np.minimum(cosine2, 1.0))
    return np.where(cosine2 < 0.5, spec.transverse_weight, 1.0)


def alignment(sites: Array, edges: Edges, flow: FlowField) -> Array:
    """(E,) squared cosine of the angle between each edge and the flow's mean line along it."""
    a, b = sites[edges[:, 0]], sites[edges[:, 1]]
    # The mean of tensors, not of vectors: lines have no sign. Three points (Simpson's weights) see a turn.
    mean = (flow.tensors(a) + 4 * flow.tensors((a + b) / 2) + flow.tensors(b)) / 6
    lines = np.linalg.eigh(mean)[1][:, :, 2]
    direction = (b - a) / np.linalg.norm(b - a, axis=1)[:, None]
    return np.asarray(np.einsum("ek,ek->e", lines, direction) ** 2)


def _density(domain: Domain, points: Array, spec: GraphSpec) -> Array:
    """(P,) mass of each voxel that makes sites ``port_density`` times as dense at the ports, fading over two cells."""
    samples = np.concatenate([thinned(port.samples, 0.01) for port in domain.ports])
    distance = cKDTree(samples).query(points)[0]
    reach = 2 * (domain.volume / spec.sites) ** (1 / 3)
    wanted = 1 + (spec.port_density - 1) * np.exp(-((distance / reach) ** 2))
    return np.asarray(wanted ** (5 / 3))  # the density of a tessellation's sites tends to mass^(3/5)


def _refuse_parts(edges: Edges, count: int) -> None:
    matrix = coo_array((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(count, count))
    parts = connected_components(matrix, directed=False)[0]
    if parts > 1:
        raise DisconnectedDomain(
            f"With {count} sites the graph of the domain falls into {parts} parts.",
            advice="Ask for more sites, or widen the domain's necks.",
            measured={"sites": count, "parts": int(parts)},
        )


def _port_sites(
    domain: Domain, grid: Grid, inside: Mask, cells: Cells, count: int
) -> tuple[NDArray[np.int8], tuple[Indices, ...], tuple[Indices, ...]]:
    """Pinned sites, the sites of each shared opening, and the sites of each port."""
    shares = np.array(
        [
            np.bincount(cells[tuple(voxels.T)], minlength=count) / len(voxels)
            for voxels in domain.port_voxels(grid, inside)
        ]
    ).reshape(len(domain.ports), count)
    touching = tuple(np.flatnonzero(row > 0) for row in shares)
    openings = tuple(
        sites for port, sites in zip(domain.ports, touching, strict=True) if port.shared and port.fluid == 1
    )
    pins = np.zeros(count, dtype=np.int8)
    dedicated = [k for k, port in enumerate(domain.ports) if not port.shared]
    if not dedicated:
        return pins, openings, touching
    claims = shares[dedicated]
    owner = claims.argmax(axis=0)
    for row, k in enumerate(dedicated):
        wanted = (claims[row] >= min(PORT_SHARE, claims[row].max())) & (owner == row)
        if not wanted.any():
            rival = domain.ports[dedicated[int(owner[claims[row].argmax()])]]
            if rival.fluid == domain.ports[k].fluid:
                continue
            raise InfeasiblePartition(
                f"Port {domain.ports[k].name} has no site of its own: site {int(claims[row].argmax())}, the only one "
                f"near it, serves port {rival.name} of the other fluid.",
                advice="Ask for more sites, or move the two ports apart.",
                measured={"port": domain.ports[k].name, "rival": rival.name, "sites": count},
            )
        pins[wanted] = domain.ports[k].fluid
    return pins, openings, touching
