"""Surfaces at a given distance from the separating surface, true between their vertices too.

Marching cubes takes the distance as linear between voxels. Where a wall is thinner than a voxel, the sag of its edges
then is a tenth of its thickness. So vertices are moved to the true distance, and edges that sag are split until they
follow. Where a move would fold the mesh it is taken back: a level set does not cross itself, but for a few triangles at
creases that merging may leave, outside the envelope as a rule; what is left of them is found when the body is written.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from dualms.intersections import crossing_triangles
from dualms.nearest import Nearest
from dualms.surface import Sheet
from dualms.triangles import TriangleMesh

Array = NDArray[np.float64]
Faces = NDArray[np.int64]

ROUNDS = 3  # each halves an edge, so its sag falls to a quarter
FEW = 0.005  # of the edges: fewer that sag do not show in the 1st and 99th percentile of a wall's thickness
FARTHEST_MOVE_VOXELS = 0.5  # the caps at the grid's end lie further away and stay
SMOOTH_COSINE = 0.9  # between the normals of an edge's ends: below, its sag is measured, not estimated
UNFOLDINGS = 12
_STEP = 2.0**-27  # lattice on which folds are looked for, unit-cube units


@dataclass(frozen=True)
class _Moved:
    """A mesh whose vertices were moved.

    Parameters
    ----------
    vertices, base
        (V, 3) after and before the move.
    normals
        (V, 3) unit vectors away from the surface; zero where nothing was moved.
    faces
        (F, 3).
    """

    vertices: Array
    base: Array
    normals: Array
    faces: Faces


def at_distance(
    level: TriangleMesh,
    nearest: Nearest,
    distance: Callable[[Array], Array],
    spacing: float,
) -> TriangleMesh:
    """A level set's mesh with its vertices moved to lie at exactly a distance from a surface.

    Parameters
    ----------
    level
        Mesh near the wanted distance, from marching cubes.
    nearest
        Of the surface that distances are from.
    distance
        Wanted distance (P,) at points (P, 3).
    spacing
        Edge of a voxel.
    """
    return _unfolded(_moved(level.vertices, level.faces, nearest, distance, spacing))


def offset_surface(
    level: TriangleMesh,
    sheet: Sheet,
    distance: Callable[[Array], Array],
    sag: float,
    deepest: float,
) -> TriangleMesh:
    """A level set's mesh moved to a distance from the separating surface, its edges split where they sag.

    Parameters
    ----------
    level
        Mesh near the wanted distance, from marching cubes.
    sheet
        The separating surface.
    distance
        Wanted distance (P,) at points (P, 3).
    sag
        How far an edge's middle may lie off the wanted distance, as a share of it.
    deepest
        Edges further outside the envelope than this are cut off later and stay as they are.

    Notes
    -----
    The sag of an edge from a to b, with unit normals m and n at its ends, is (b - a)·(n - m)/8 to second order.
    """
    spacing = sheet.grid.spacing
    moved = _moved(level.vertices, level.faces, sheet.nearest, distance, spacing)
    for _ in range(ROUNDS):
        edges, of_face = _edges(moved.faces, len(moved.vertices))
        middle, off, bent = _sags(moved.vertices, moved.normals, edges)
        wanted = distance(middle)
        found = sheet.nearest.distance(middle[bent]) - wanted[bent]
        off[bent] = np.where(np.abs(found) < spacing, found, 0.0)
        split = np.abs(off) > sag * wanted
        split[split] = sheet.grid.sample(sheet.depth, middle[split]) > -deepest
        if split.mean() < FEW:
            break
        moved = _split(moved, edges, of_face, split, sheet, distance)
    return _unfolded(moved)


def _moved(
    base: Array,
    faces: Faces,
    nearest: Nearest,
    distance: Callable[[Array], Array],
    spacing: float,
    facing: Array | None = None,
) -> _Moved:
    """Points moved to the distance; ``facing`` (V, 3) says on which side, where they may have got across the surface.

    The middle of an edge does where a thin wall bends by more than its thickness between two vertices.
    """
    (found, foot), wanted = nearest.foot(base), distance(base)
    away = found > 0.1 * wanted
    normals = (base - foot) / np.where(away, found, 1.0)[:, None]
    if facing is not None:
        across = away & (np.einsum("ij,ij->i", normals, facing) < 0)
        normals[across] *= -1
        length = np.linalg.norm(facing, axis=1)
        normals[~away] = (facing / np.where(length > 0, length, 1.0)[:, None])[~away]
        found = np.where(across, -found, found)
        away |= length > 0
    near = (np.abs(found - wanted) < FARTHEST_MOVE_VOXELS * spacing) & away
    normals = np.where(near[:, None], normals, 0.0)
    return _Moved(np.where(near[:, None], foot + wanted[:, None] * normals, base), base, normals, faces)


@njit(cache=True)  # type: ignore[untyped-decorator]
def _edges(faces: Faces, count: int) -> tuple[Faces, Faces]:
    """(E, 2) edges, and (F, 3) the edges of each face: from its first corner to its second, and so on.

    ``count`` is that of the vertices; the edges of a vertex to those of higher index hang in a list.
    """
    first = np.full(count, -1)
    following = np.empty(3 * len(faces), dtype=np.int64)
    edges = np.empty((3 * len(faces), 2), dtype=np.int64)
    of_face = np.empty((len(faces), 3), dtype=np.int64)
    made = 0
    for f in range(len(faces)):
        for k in range(3):
            a, b = faces[f, k], faces[f, (k + 1) % 3]
            low, high = min(a, b), max(a, b)
            e = first[low]
            while e >= 0 and edges[e, 1] != high:
                e = following[e]
            if e < 0:
                e = made
                edges[e, 0], edges[e, 1] = low, high
                following[e], first[low] = first[low], e
                made += 1
            of_face[f, k] = e
    return edges[:made].copy(), of_face


@njit(cache=True)  # type: ignore[untyped-decorator]
def _sags(vertices: Array, normals: Array, edges: Faces) -> tuple[Array, Array, NDArray[np.bool_]]:
    """(E, 3) middles of edges, (E,) estimates of how far they lie off the wanted distance, (E,) which to measure.

    An edge whose ends were both not moved lies right.
    """
    count = len(edges)
    middle, off, bent = np.empty((count, 3)), np.zeros(count), np.zeros(count, dtype=np.bool_)
    for e in range(count):
        a, b = edges[e]
        cosine = 0.0
        moved = False
        for k in range(3):
            m, n = normals[a, k], normals[b, k]
            middle[e, k] = 0.5 * (vertices[a, k] + vertices[b, k])
            off[e] += (vertices[b, k] - vertices[a, k]) * (n - m) / 8
            cosine += m * n
            moved = moved or m != 0 or n != 0
        bent[e] = moved and cosine < SMOOTH_COSINE
    return middle, off, bent


def _split(
    moved: _Moved,
    edges: Faces,
    of_face: Faces,
    split: NDArray[np.bool_],
    sheet: Sheet,
    distance: Callable[[Array], Array],
) -> _Moved:
    """New vertices in the middles of edges, and each triangle cut into two, three or four accordingly."""
    middles = np.full(len(edges), -1)
    middles[split] = len(moved.base) + np.arange(int(split.sum()))
    a, b = edges[split].T
    base, start = (0.5 * (points[a] + points[b]) for points in (moved.base, moved.vertices))
    facing = moved.normals[a] + moved.normals[b]
    new = _moved(start, moved.faces, sheet.nearest, distance, sheet.grid.spacing, facing)
    vertices = np.concatenate([moved.vertices, new.vertices])
    faces = _subdivided(moved.faces, middles[of_face], vertices)
    return _Moved(vertices, np.concatenate([moved.base, base]), np.concatenate([moved.normals, new.normals]), faces)


def _subdivided(faces: Faces, middle: Faces, vertices: Array) -> Faces:
    """Triangles cut at the middles (F, 3) of their edges; -1 where an edge is whole."""
    count = (middle >= 0).sum(axis=1)
    made = [faces[count == 0]]
    (a, b, c), (p, q, r) = faces[count == 3].T, middle[count == 3].T
    made += [np.stack(t, axis=1) for t in ((a, p, r), (p, b, q), (r, q, c), (p, q, r))]
    # One: turned so that a-b is the split edge.
    turned, cut = _turned(faces[count == 1], middle[count == 1], (middle[count == 1] >= 0).argmax(axis=1))
    (a, b, c), p = turned.T, cut[:, 0]
    made += [np.stack((a, p, c), axis=1), np.stack((p, b, c), axis=1)]
    # Two: turned so that a-b is whole; the quadrangle a-b-p-q is cut along its shorter diagonal.
    turned, cut = _turned(faces[count == 2], middle[count == 2], (middle[count == 2] < 0).argmax(axis=1))
    (a, b, c), p, q = turned.T, cut[:, 1], cut[:, 2]
    made.append(np.stack((q, p, c), axis=1))
    first = ((vertices[a] - vertices[p]) ** 2).sum(axis=1) < ((vertices[b] - vertices[q]) ** 2).sum(axis=1)
    made.append(np.where(first[:, None], np.stack((a, b, p), axis=1), np.stack((a, b, q), axis=1)))
    made.append(np.where(first[:, None], np.stack((a, p, q), axis=1), np.stack((b, p, q), axis=1)))
    return np.concatenate(made)


def _turned(faces: Faces, middle: Faces, by: Faces) -> tuple[Faces, Faces]:
    """Corners and edge middles of faces, turned cyclically by an index each."""
    index = (by[:, None] + np.arange(3)) % 3
    return np.take_along_axis(faces, index, axis=1), np.take_along_axis(middle, index, axis=1)


def _unfolded(moved: _Moved) -> TriangleMesh:
    """The mesh, with moves taken back where triangles cross."""
    vertices = moved.vertices.copy()
    changed: NDArray[np.bool_] | None = None
    for _ in range(UNFOLDINGS):
        # What crosses elsewhere has been taken back already.
        crossing = crossing_triangles(TriangleMesh(vertices, moved.faces), _STEP, changed)
        back = np.unique(moved.faces[crossing])
        back = back[(vertices[back] != moved.base[back]).any(axis=1)]
        if len(back) == 0:
            break
        vertices[back] = moved.base[back]
        touched = np.zeros(len(vertices), dtype=bool)
        touched[back] = True
        changed = np.asarray(touched[moved.faces].any(axis=1))
    return TriangleMesh(vertices, moved.faces)
