"""The nearest points of a triangle mesh, by a bounding-volume tree that is built once (libigl)."""

from __future__ import annotations

from functools import cached_property

import igl
import numpy as np
from numpy.typing import NDArray

from dualms.triangles import TriangleMesh

Array = NDArray[np.float64]


class Nearest:
    """Nearest points of a mesh; the tree is built at the first question.

    Parameters
    ----------
    mesh
        Open or closed.
    """

    def __init__(self, mesh: TriangleMesh) -> None:
        self.mesh = TriangleMesh(np.ascontiguousarray(mesh.vertices), np.ascontiguousarray(mesh.faces))

    def __getstate__(self) -> dict[str, object]:
        return {"mesh": self.mesh}

    @cached_property
    def _tree(self) -> igl.AABB:
        tree = igl.AABB()
        tree.init(self.mesh.vertices, self.mesh.faces)
        return tree

    def foot(self, points: Array) -> tuple[Array, Array]:
        """(P,) distance of points (P, 3) from the mesh, and (P, 3) the nearest points on it."""
        if len(points) == 0:
            return np.zeros(0), np.zeros((0, 3))
        vertices, faces = self.mesh.vertices, self.mesh.faces
        squared, _, foot = self._tree.squared_distance(vertices, faces, np.ascontiguousarray(points))
        return np.sqrt(squared), np.asarray(foot)

    def distance(self, points: Array) -> Array:
        """(P,) distance of points (P, 3) from the mesh."""
        return self.foot(points)[0]
