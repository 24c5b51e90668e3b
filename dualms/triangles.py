"""A triangle mesh as a value, and its few integrals."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

Array = NDArray[np.float64]


@dataclass(frozen=True)
class TriangleMesh:
    """Vertices (V, 3) float64 and faces (F, 3) int64; whether it is closed is not implied."""

    vertices: Array
    faces: NDArray[np.int64]

    def __post_init__(self) -> None:
        if self.vertices.ndim != 2 or self.vertices.shape[1] != 3 or not np.isfinite(self.vertices).all():
            raise ValueError("vertices must be finite (V, 3)")
        if self.faces.ndim != 2 or self.faces.shape[1] != 3:
            raise ValueError("faces must be (F, 3)")
        if len(self.faces) and not 0 <= self.faces.min() <= self.faces.max() < len(self.vertices):
            raise ValueError("faces must index the vertices")

    @cached_property
    def crosses(self) -> Array:
        """(F, 3) edge cross products: twice the area along the normal."""
        a, b, c = (self.vertices[self.faces[:, k]] for k in range(3))
        return np.asarray(np.cross(b - a, c - a))

    @cached_property
    def areas(self) -> Array:
        """(F,) triangle areas."""
        return np.asarray(np.linalg.norm(self.crosses, axis=1) / 2)

    @property
    def centroids(self) -> Array:
        """(F, 3) middles of the triangles."""
        a, b, c = (self.vertices[self.faces[:, k]] for k in range(3))
        return np.asarray((a + b + c) / 3)

    @property
    def area(self) -> float:
        """Sum of the triangle areas."""
        return float(self.areas.sum())

    @property
    def volume(self) -> float:
        """Enclosed volume, for a closed mesh."""
        if len(self.faces) == 0:
            return 0.0
        a, b, c = (self.vertices[self.faces[:, k]] - self.vertices[self.faces[0, 0]] for k in range(3))
        return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)

    @property
    def is_closed(self) -> bool:
        """Whether every directed edge has exactly one opposite: closed, 2-manifold at edges, consistently oriented."""
        n = np.int64(len(self.vertices))
        start, end = self.faces.ravel(), np.roll(self.faces, -1, axis=1).ravel()
        forward, backward = np.sort(start * n + end), np.sort(end * n + start)
        return len(forward) > 0 and bool((forward == backward).all() and (np.diff(forward) > 0).all())

    @property
    def border(self) -> NDArray[np.int64]:
        """(E, 2) edges that only one triangle has."""
        n = np.int64(len(self.vertices))
        ends = np.sort(self.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
        keys = np.sort(ends[:, 0] * n + ends[:, 1])
        new = np.concatenate([[True], keys[1:] != keys[:-1], [True]])
        alone = keys[new[:-1] & new[1:]]
        return np.stack([alone // n, alone % n], axis=1)

    def shell_volumes(self) -> Array:
        """(S,) enclosed volumes of the connected parts of a closed mesh; negative for those that bound a cavity."""
        ends = self.faces[:, [0, 1, 1, 2]].reshape(-1, 2)
        links = coo_array((np.ones(len(ends), dtype=np.int8), tuple(ends.T)), shape=(len(self.vertices),) * 2)
        _, label = connected_components(links, directed=False)
        a, b, c = (self.vertices[self.faces[:, k]] - self.vertices[0] for k in range(3))
        cones = np.einsum("ij,ij->i", a, np.cross(b, c)) / 6
        return np.asarray(np.bincount(label[self.faces[:, 0]], weights=cones), dtype=float)

    def part(self, chosen: NDArray[np.bool_]) -> TriangleMesh:
        """The triangles where ``chosen`` (F,) holds, with their vertices only."""
        return used_only(self.vertices, self.faces[chosen])

    def moved(self, scale: float, offset: Array) -> TriangleMesh:
        """The mesh with vertices ``offset + scale · v``."""
        return TriangleMesh(offset + scale * self.vertices, self.faces)


def used_only(vertices: Array, faces: NDArray[np.int64]) -> TriangleMesh:
    """A mesh of faces (F, 3) with those of the vertices (V, 3) that they use, in their order."""
    used = np.zeros(len(vertices), dtype=bool)
    used[faces.ravel()] = True
    renumbered = np.cumsum(used) - 1
    return TriangleMesh(vertices[used], renumbered[faces])
