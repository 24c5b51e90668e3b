"""Mean curvature of triangle meshes: quadric fitting, and the curvature measure as a cross-check.

H is half the divergence of the unit normal: positive on a sphere whose triangles face outward, in 1 / unit of length.

References
----------
Cazals and Pouget 2005, "Estimating differential quantities using polynomial fitting of osculating jets";
Cohen-Steiner and Morvan 2003, "Restricted Delaunay triangulations and normal cycle".
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import get_num_threads, njit, prange
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.spatial import cKDTree

from dualms.triangles import TriangleMesh

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

REACH = 5.0
"""Radius of a fit in mean edge lengths: about 3.5 voxels on a mesh of marching cubes, whose vertices are noisy."""


def mean_curvature(vertices: Array, faces: Indices, reach: float = REACH) -> Array:
    """Mean curvature at the vertices, by a quadric fitted to the surface round each.

    Parameters
    ----------
    vertices
        (V, 3), any unit.
    faces
        (F, 3), consistently oriented.
    reach
        Radius of the fit, in mean edge lengths.

    Returns
    -------
    (V,) float64
        In 1 / unit; NaN where a vertex has too few neighbours for a fit. Near the mesh's boundary fits are one-sided:
        leave them out with :func:`away_from_boundary`.

    Notes
    -----
    The error falls with the mesh's edge, in second order on spheres and cylinders and at least in first order
    elsewhere. About 14 µs a vertex on one core.
    """
    normals = vertex_normals(vertices, faces)
    edges = _edges(faces)
    start, neighbours = _adjacency(edges, len(vertices))
    length = float(np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1).mean())
    return np.asarray(
        _fit_all(np.ascontiguousarray(vertices), normals, start, neighbours, reach * length, get_num_threads())
    )


def curvature_measure(vertices: Array, faces: Indices, radius: float, at: Indices) -> Array:
    """Mean curvature as Cohen-Steiner and Morvan's measure of a ball, divided by the ball's flat area πr².

    Parameters
    ----------
    vertices, faces
        The mesh, consistently oriented.
    radius
        Of the balls; several edges long, and small against the curvature's radius.
    at
        (K,) vertices that the balls are centred at.

    Returns
    -------
    (K,) float64
        In 1 / unit. Without the division it has no unit, as in the paper's Table 1.
    """
    halves = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    owner = np.tile(np.arange(len(faces)), 3)
    order = np.lexsort((halves[:, 0] > halves[:, 1], halves.max(axis=1), halves.min(axis=1)))
    halves, owner = halves[order], owner[order]
    same = np.flatnonzero((halves[:-1] == halves[1:, ::-1]).all(axis=1))
    a, b = vertices[halves[same, 0]], vertices[halves[same, 1]]
    normal = _unit(
        np.cross(vertices[faces[:, 1]] - vertices[faces[:, 0]], vertices[faces[:, 2]] - vertices[faces[:, 0]])
    )
    one, two = normal[owner[same]], normal[owner[same + 1]]
    along = _unit(b - a)
    angle = np.arctan2(np.einsum("ij,ij->i", np.cross(one, two), along), np.einsum("ij,ij->i", one, two))
    longest = float(np.linalg.norm(b - a, axis=1).max())
    near = cKDTree((a + b) / 2).query_ball_point(vertices[at], radius + longest / 2)
    measure = np.empty(len(at))
    for n, edges in enumerate(near):
        inside = _length_in_ball(a[edges] - vertices[at[n]], b[edges] - vertices[at[n]], radius)
        measure[n] = (angle[edges] * inside).sum() / 2
    return measure / (math.pi * radius**2)


def away_from_boundary(vertices: Array, faces: Indices, distance: float) -> NDArray[np.bool_]:
    """(V,) which vertices lie farther than ``distance`` from the mesh's open boundary; all of a closed mesh."""
    rim = np.unique(TriangleMesh(vertices, faces).border)
    if len(rim) == 0:
        return np.ones(len(vertices), dtype=bool)
    away, _ = cKDTree(vertices[rim]).query(vertices, distance_upper_bound=distance)
    return np.asarray(np.isinf(away))


def vertex_normals(vertices: Array, faces: Indices) -> Array:
    """(V, 3) unit normals at the vertices, weighted by the triangles' areas."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    weighted = np.cross(b - a, c - a)
    normals = np.stack(
        [np.bincount(faces.ravel(), np.repeat(weighted[:, d], 3), len(vertices)) for d in range(3)], axis=1
    )
    return _unit(normals)


def vertex_areas(vertices: Array, faces: Indices) -> Array:
    """(V,) a third of the area of the triangles round each vertex."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    return np.asarray(np.bincount(faces.ravel(), np.repeat(area, 3), len(vertices)) / 3)


def _unit(vectors: NDArray[Any]) -> Array:
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.asarray(vectors / np.where(length > 0, length, 1))


def _edges(faces: Indices) -> Indices:
    """(E, 2) each edge once."""
    pairs = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    count = int(faces.max(initial=0)) + 1
    keys = np.sort(pairs[:, 0] * count + pairs[:, 1])
    keys = keys[np.append(True, keys[1:] != keys[:-1])]
    return np.stack([keys // count, keys % count], axis=1)


def _adjacency(edges: Indices, count: int) -> tuple[Indices, Indices]:
    """Neighbours of each vertex, as the two index arrays of a compressed sparse row matrix."""
    ends = np.concatenate([edges, edges[:, ::-1]])
    matrix = coo_array((np.ones(len(ends), dtype=np.int8), (ends[:, 0], ends[:, 1])), shape=(count, count)).tocsr()
    return matrix.indptr.astype(np.int64), matrix.indices.astype(np.int64)


def _length_in_ball(a: Array, b: Array, radius: float) -> Array:
    """(K,) length of the parts of segments (K, 3) to (K, 3) inside the ball round the origin."""
    d = b - a
    length2 = np.maximum(np.einsum("ij,ij->i", d, d), 1e-300)
    middle = -np.einsum("ij,ij->i", a, d) / length2
    under = middle**2 - (np.einsum("ij,ij->i", a, a) - radius**2) / length2
    half = np.sqrt(np.maximum(under, 0))
    share = np.clip(middle + half, 0, 1) - np.clip(middle - half, 0, 1)
    return np.asarray(share * np.sqrt(length2))


@njit(cache=True, parallel=True)  # type: ignore[untyped-decorator]
def _fit_all(vertices: Array, normals: Array, start: Indices, neighbours: Indices, radius: float, parts: int) -> Array:
    count = len(vertices)
    curvature = np.full(count, np.nan)
    for part in prange(parts):
        _fit(
            vertices, normals, start, neighbours, radius, part * count // parts, (part + 1) * count // parts, curvature
        )
    return curvature


@njit(cache=True)  # type: ignore[untyped-decorator]
def _fit(
    vertices: Array,
    normals: Array,
    start: Indices,
    neighbours: Indices,
    radius: float,
    first: int,
    last: int,
    curvature: Array,
) -> None:
    """Fit at the vertices from ``first`` to before ``last``, into ``curvature``."""
    stamp = np.full(len(vertices), -1)
    queue = np.empty(len(vertices), dtype=np.int64)
    basis = np.empty(6)
    for v in range(first, last):
        n = normals[v]
        # A tangent frame, from the axis that is farthest from the normal.
        axis = np.argmin(np.abs(n))
        t = -n[axis] * n
        t[axis] += 1.0
        t /= np.sqrt((t * t).sum())
        s = np.cross(n, t)
        matrix = np.zeros((6, 6))
        right = np.zeros(6)
        queue[0] = v
        stamp[v] = v
        head, tail = 0, 1
        while head < tail:
            w = queue[head]
            head += 1
            dx, dy, dz = (
                vertices[w, 0] - vertices[v, 0],
                vertices[w, 1] - vertices[v, 1],
                vertices[w, 2] - vertices[v, 2],
            )
            x = (dx * t[0] + dy * t[1] + dz * t[2]) / radius
            y = (dx * s[0] + dy * s[1] + dz * s[2]) / radius
            z = (dx * n[0] + dy * n[1] + dz * n[2]) / radius
            weight = 1.0 - (x * x + y * y + z * z)
            basis[0], basis[1], basis[2] = 1.0, x, y
            basis[3], basis[4], basis[5] = 0.5 * x * x, x * y, 0.5 * y * y
            for i in range(6):
                right[i] += weight * basis[i] * z
                for j in range(i + 1):
                    matrix[i, j] += weight * basis[i] * basis[j]
            for k in range(start[w], start[w + 1]):
                u = neighbours[k]
                if stamp[u] == v:
                    continue
                stamp[u] = v
                ux, uy, uz = (
                    vertices[u, 0] - vertices[v, 0],
                    vertices[u, 1] - vertices[v, 1],
                    vertices[u, 2] - vertices[v, 2],
                )
                if ux * ux + uy * uy + uz * uz < radius * radius:
                    queue[tail] = u
                    tail += 1
        if tail >= 8 and _solve(matrix, right):
            p, q = right[1], right[2]
            slope = 1.0 + p * p + q * q
            top = (1.0 + q * q) * right[3] - 2.0 * p * q * right[4] + (1.0 + p * p) * right[5]
            curvature[v] = -top / (2.0 * slope * np.sqrt(slope)) / radius


@njit(cache=True)  # type: ignore[untyped-decorator]
def _solve(matrix: Array, right: Array) -> bool:
    """Solve the symmetric system of a lower triangle in place by Cholesky; False if it is singular."""
    for i in range(6):
        for j in range(i + 1):
            total = matrix[i, j]
            for k in range(j):
                total -= matrix[i, k] * matrix[j, k]
            if i == j:
                if total <= 1e-9 * matrix[0, 0]:
                    return False
                matrix[i, i] = np.sqrt(total)
            else:
                matrix[i, j] = total / matrix[j, j]
    for i in range(6):
        for k in range(i):
            right[i] -= matrix[i, k] * right[k]
        right[i] /= matrix[i, i]
    for i in range(5, -1, -1):
        for k in range(i + 1, 6):
            right[i] -= matrix[k, i] * right[k]
        right[i] /= matrix[i, i]
    return True
