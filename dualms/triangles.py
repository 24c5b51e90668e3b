"""A triangle mesh as a value, and its few integrals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

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

    @property
    def crosses(self) -> Array:
        """(F, 3) edge cross products: twice the area along the normal."""
        a, b, c = (self.vertices[self.faces[:, k]] for k in range(3))
        return np.asarray(np.cross(b - a, c - a))

    @property
    def areas(self) -> Array:
        """(F,) triangle areas."""
        return np.asarray(np.linalg.norm(self.crosses, axis=1) / 2)

    @property
    def centroids(self) -> Array:
        """(F, 3) middles of the triangles."""
        return np.asarray(self.vertices[self.faces].mean(axis=1))

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

    def part(self, chosen: NDArray[np.bool_]) -> TriangleMesh:
        """The triangles where ``chosen`` (F,) holds, with their vertices only."""
        used, faces = np.unique(self.faces[chosen], return_inverse=True)
        return TriangleMesh(self.vertices[used], faces.reshape(-1, 3).astype(np.int64))

    def moved(self, scale: float, offset: Array) -> TriangleMesh:
        """The mesh with vertices ``offset + scale · v``."""
        return TriangleMesh(offset + scale * self.vertices, self.faces)
