"""The envelope as a value: triangles in metres that form one closed, outward oriented body, and its planar facets."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from dualms.spec import Unit
from dualms.triangles import TriangleMesh

Array = NDArray[np.float64]

PLANAR_RADIANS = 0.01  # neighbours of a facet differ by less; a curved part that slips in fails the plane fit
SHARP_RADIANS = 0.35  # 20°: more than between the strips of a cylinder of 18 sides
LARGE = 0.02  # of the whole area: a facet even where its border is rounded
MAX_FACETS = 64


@dataclass(frozen=True)
class Facet:
    """A planar part of the boundary: connected coplanar triangles."""

    triangles: NDArray[np.int64]
    center_m: Array
    normal: Array
    area_m2: float


@dataclass(frozen=True)
class DomainMesh:
    """A closed, outward oriented, single body.

    Parameters
    ----------
    vertices_m
        (V, 3) float64, metres.
    faces
        (F, 3) int64, counter-clockwise seen from outside.
    units
        Unit of the file, in which results are given back.
    """

    vertices_m: Array
    faces: NDArray[np.int64]
    units: Unit

    @cached_property
    def areas(self) -> Array:
        """(F,) triangle areas, m²."""
        return np.asarray(np.linalg.norm(self._crosses, axis=1) / 2)

    @cached_property
    def normals(self) -> Array:
        """(F, 3) outward unit normals."""
        return np.asarray(self._crosses / np.maximum(np.linalg.norm(self._crosses, axis=1), 1e-300)[:, None])

    @cached_property
    def volume_m3(self) -> float:
        """Enclosed volume."""
        return TriangleMesh(self.vertices_m, self.faces).volume

    @cached_property
    def facets(self) -> tuple[Facet, ...]:
        """Planar facets of more than 0.1 % of the area with sharp borders, or of more than 2 %, largest first (≤ 64).

        Strips of a tessellated cylinder are planar too; their smooth borders and small areas tell them apart.
        """
        pairs, edges = trimesh.graph.face_adjacency(self.faces, return_edges=True)
        cosine = np.einsum("ij,ij->i", self.normals[pairs[:, 0]], self.normals[pairs[:, 1]])
        flat = cosine > np.cos(PLANAR_RADIANS)
        links = coo_array((np.ones(flat.sum()), tuple(pairs[flat].T)), shape=(len(self.faces),) * 2)
        count, label = connected_components(links, directed=False)
        length = np.linalg.norm(np.diff(self.vertices_m[edges], axis=1)[:, 0], axis=1)
        border = label[pairs[:, 0]] != label[pairs[:, 1]]
        sharp = border & (cosine < np.cos(SHARP_RADIANS))
        round_, sharply = (
            sum(np.bincount(label[pairs[kind, k]], weights=length[kind], minlength=count) for k in (0, 1))
            for kind in (border, sharp)
        )
        area = np.bincount(label, weights=self.areas)
        total = self.areas.sum()
        candidates = np.flatnonzero((area > 1e-3 * total) & ((sharply > 0.5 * round_) | (area > LARGE * total)))
        facets = [f for k in candidates if (f := self._planar(np.flatnonzero(label == k)))]
        facets.sort(key=lambda f: (-round(f.area_m2 / self.areas.sum(), 5), *f.center_m.round(7).tolist()))
        return tuple(facets[:MAX_FACETS])

    @cached_property
    def _crosses(self) -> Array:
        a, b, c = (self.vertices_m[self.faces[:, k]] for k in range(3))
        return np.cross(b - a, c - a)

    def _planar(self, triangles: NDArray[np.int64]) -> Facet | None:
        weight = self.areas[triangles]
        normal = np.average(self.normals[triangles], axis=0, weights=weight)
        normal /= np.linalg.norm(normal)
        points = self.vertices_m[self.faces[triangles]]
        center = np.average(points.mean(axis=1), axis=0, weights=weight)
        if np.abs((points - center) @ normal).max() > 1e-3 * np.sqrt(weight.sum()):
            return None
        return Facet(triangles, center, normal, float(weight.sum()))
