import itertools
from types import SimpleNamespace

import numpy as np
import pytest

from dualms.domain import Domain

BOX_FACES = np.array(
    [
        [0, 2, 1],
        [0, 3, 2],
        [4, 5, 6],
        [4, 6, 7],
        [0, 1, 5],
        [0, 5, 4],
        [1, 2, 6],
        [1, 6, 5],
        [2, 3, 7],
        [2, 7, 6],
        [3, 0, 4],
        [3, 4, 7],
    ]
)


def box(x: float = 1.0, y: float = 1.0, z: float = 1.0) -> Domain:
    corners = [[0, 0, 0], [x, 0, 0], [x, y, 0], [0, y, 0], [0, 0, z], [x, 0, z], [x, y, z], [0, y, z]]
    return Domain(np.array(corners, dtype=float), BOX_FACES, 1.0, np.zeros(3), ())


def polyline(*points: tuple[float, float, float]) -> np.ndarray:
    """Samples at 1/256 along a polyline."""
    parts = []
    for a, b in itertools.pairwise(points):
        count = int(np.ceil(np.linalg.norm(np.subtract(b, a)) * 256)) + 1
        parts.append(np.linspace(a, b, count))
    return np.concatenate(parts)


@pytest.fixture(scope="session")
def unit_box() -> Domain:
    return box()


@pytest.fixture(scope="session")
def parallel_lines() -> SimpleNamespace:
    """Two lines whose equidistant surface is the plane x = 0.5."""
    return SimpleNamespace(hot=polyline((0.25, 0.5, 0), (0.25, 0.5, 1)), cold=polyline((0.75, 0.5, 0), (0.75, 0.5, 1)))


@pytest.fixture(scope="session")
def schwarz_p() -> SimpleNamespace:
    """The two cubic lattices of lines whose minimal surface is Schwarz P, in one cell."""
    c = 0.5
    hot = np.concatenate(
        [polyline((0, c, c), (1, c, c)), polyline((c, 0, c), (c, 1, c)), polyline((c, c, 0), (c, c, 1))]
    )
    edges = []
    for axis in range(3):
        for p in (0.0, 1.0):
            for q in (0.0, 1.0):
                ends = np.insert([p, q], axis, 0.0), np.insert([p, q], axis, 1.0)
                edges.append(polyline(tuple(ends[0]), tuple(ends[1])))
    return SimpleNamespace(hot=hot, cold=np.concatenate(edges))
