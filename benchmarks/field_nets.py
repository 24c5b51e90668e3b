"""The skeletons of the classical surfaces: pairs of nets in the unit cell, and samples of them."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from dualms.skeletons import SPACING

EXACT_AREA = {"P": 2.3451028840, "G": 3.0914437988, "D": 3.8377847135, "I-WP": 2 * math.sqrt(3)}
"""Of a cubic cell of edge 1. P 3K/K', D 3K'/K with K = K(1/2), K' = K(√3/2); G their mean; I-WP as ours tends to."""
PAPER_AREA = {"P": 3.79 / 3.79, "G": 4.72 / 4.99, "I-WP": 5.63 / 5.73}
"""The paper's area over that of its classical surface (Table 2)."""


def links(nodes: np.ndarray, length: float) -> np.ndarray:
    """(K, 2, 3) segments between nodes of one cell and their neighbours at a distance, cell side 1."""
    shifts = np.array([(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)])
    everywhere = (nodes[None] + shifts[:, None]).reshape(-1, 3)
    found = [(a, b) for a in nodes for b in everywhere[np.abs(np.linalg.norm(everywhere - a, axis=1) - length) < 1e-6]]
    return np.array(found)


def gyroid_nets() -> list[np.ndarray]:
    """Both srs nets: nodes where sin x cos y + sin y cos z + sin z cos x is ±3/2, three neighbours at √2/4."""
    nodes = np.array([(x, y, z) for x in range(8) for y in range(8) for z in range(8)]) / 8
    s, c = np.sin(2 * np.pi * nodes), np.cos(2 * np.pi * nodes)
    g = s[:, 0] * c[:, 1] + s[:, 1] * c[:, 2] + s[:, 2] * c[:, 0]
    return [links(nodes[np.abs(g - level) < 1e-9], math.sqrt(2) / 4) for level in (1.5, -1.5)]


def diamond_nets() -> list[np.ndarray]:
    """A diamond net and its copy shifted by half a cell along the diagonal."""
    centred = np.array([(0, 0, 0), (0, 0.5, 0.5), (0.5, 0, 0.5), (0.5, 0.5, 0)])
    nodes = np.concatenate([centred, centred + 0.25])
    return [links(nodes + shift, math.sqrt(3) / 4) for shift in (0.0, 0.5)]


def cubic_nets() -> list[np.ndarray]:
    """Two simple cubic nets."""
    return [links(np.full((1, 3), shift), 1.0) for shift in (0.0, 0.5)]


def package_nets() -> list[np.ndarray]:
    """The body-centred net and the net of its octahedral holes."""
    centred = np.array([(0, 0, 0), (0.5, 0.5, 0.5)])
    holes = np.array([(0.5, 0, 0), (0, 0.5, 0), (0, 0, 0.5), (0.5, 0.5, 0), (0.5, 0, 0.5), (0, 0.5, 0.5)])
    return [links(centred, math.sqrt(3) / 2), links(holes, 0.5)]


NETS: dict[str, Callable[[], list[np.ndarray]]] = {
    "P": cubic_nets,
    "G": gyroid_nets,
    "D": diamond_nets,
    "I-WP": package_nets,
}


def sampled(segments: np.ndarray, cell: float) -> np.ndarray:
    """Samples of a net repeated over the unit cube."""
    t = np.linspace(0, 1, math.ceil(cell / SPACING) + 1)[:, None]
    one = np.concatenate([a * (1 - t) + b * t for a, b in segments])
    count = round(1 / cell)
    shifts = np.array(
        [(x, y, z) for x in range(-1, count + 1) for y in range(-1, count + 1) for z in range(-1, count + 1)]
    )
    points = ((one[None] + shifts[:, None]) * cell).reshape(-1, 3)
    points = points[((points > -1e-9) & (points < 1 + 1e-9)).all(axis=1)]
    return np.unique(np.round(points, 9), axis=0)
