"""Random geometric graphs with ports, for the tests of the cut."""

from __future__ import annotations

import numpy as np
from scipy.spatial import Delaunay

from dualms.graph.graph import Graph


def delaunay_graph(count: int, seed: int, transverse: float = 5.0, ports: str = "none") -> Graph:
    """Delaunay graph of jittered points in a box of 2 × 1 × 1; the flow runs along x."""
    generator = np.random.default_rng(seed)
    sites = generator.random((count, 3)) * [2.0, 1.0, 1.0]
    pairs = Delaunay(sites).simplices[:, [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]]].reshape(-1, 2)
    edges = np.unique(np.sort(pairs, axis=1), axis=0).astype(np.int64)
    lengths = np.linalg.norm(sites[edges[:, 0]] - sites[edges[:, 1]], axis=1)
    edges = edges[lengths < 2.2 * np.median(lengths)] if count > 30 else edges
    direction = sites[edges[:, 1]] - sites[edges[:, 0]]
    cosine = np.abs(direction[:, 0]) / np.linalg.norm(direction, axis=1)
    weights = np.where(cosine < np.sqrt(0.5), transverse, 1.0)
    pins = np.zeros(count, dtype=np.int8)
    openings: tuple[np.ndarray, ...] = ()
    touching: tuple[np.ndarray, ...] = ()
    if ports == "dedicated":
        spots = np.array([[0, 0.2, 0.2], [2, 0.2, 0.2], [0, 0.8, 0.8], [2, 0.8, 0.8]])
        nearest = [int(((sites - s) ** 2).sum(axis=1).argmin()) for s in spots]
        pins[nearest] = [1, 1, -1, -1]
        touching = tuple(np.array([v]) for v in nearest)
    elif ports == "shared":
        share = max(4, count // 12)
        order = np.argsort(sites[:, 0])
        openings = (np.sort(order[:share]), np.sort(order[-share:]))
        touching = (openings[0], openings[1], openings[1], openings[0])
    fluids = np.array({"none": (), "dedicated": (1, 1, -1, -1), "shared": (1, 1, -1, -1)}[ports], dtype=np.int8)
    inlets = np.array([True, False] * (len(fluids) // 2), dtype=bool)
    middles = sites[edges].mean(axis=1)
    return Graph(sites, edges, weights, np.ones(len(edges)), middles, pins, openings, touching, fluids, inlets)


def bare_graph(sites: np.ndarray, edges: np.ndarray, weights: np.ndarray, pins: np.ndarray) -> Graph:
    """A graph without openings and ports."""
    nothing = np.zeros(0, dtype=np.int8)
    middles = sites[edges].mean(axis=1)
    return Graph(sites, edges, weights, np.ones(len(edges)), middles, pins, (), (), nothing, nothing.astype(bool))
