"""Short edges of a closed mesh collapsed onto one of their ends, shortest first, where the mesh stays closed.

The ends must have exactly two neighbours in common (link condition, Dey, Edelsbrunner, Guha and Nekhayev 1999,
"Topology preserving edge contraction").
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from dualms.triangles import TriangleMesh

Ints = NDArray[np.int64]
Mask = NDArray[np.bool_]


def collapsed(mesh: TriangleMesh, least: float, chosen: Mask | None = None) -> tuple[TriangleMesh, Mask, Mask]:
    """The mesh without edges shorter than a length.

    Parameters
    ----------
    mesh
        Closed and consistently oriented.
    least
        The length, in the mesh's unit.
    chosen
        (F,) only edges of these faces are collapsed; default all.

    Returns
    -------
    mesh
        Closed; vertices that are left stay where they were, faces keep their order.
    kept
        (F,) which of the given faces are left.
    moved
        (F',) which of the faces that are left got another corner.
    """
    short = _short_edges(
        mesh.vertices, mesh.faces, np.ones(len(mesh.faces), dtype=np.bool_) if chosen is None else chosen, least
    )
    if len(short) == 0:
        return mesh, np.ones(len(mesh.faces), dtype=bool), np.zeros(len(mesh.faces), dtype=bool)
    short = np.unique(short, axis=0)
    length = np.linalg.norm(mesh.vertices[short[:, 0]] - mesh.vertices[short[:, 1]], axis=1)
    short = short[np.lexsort((short[:, 1], short[:, 0], length))]
    faces = mesh.faces.copy()
    touched = np.zeros(len(mesh.vertices), dtype=np.bool_)
    touched[short] = True
    start, fan = _fans(faces, touched)
    alive, moved = np.ones(len(faces), dtype=np.bool_), np.zeros(len(faces), dtype=np.bool_)
    _collapse(faces, short, start, fan, alive, moved)
    return TriangleMesh(mesh.vertices, faces).part(alive), alive, moved[alive]


@njit(cache=True)  # type: ignore[untyped-decorator]
def _short_edges(vertices: NDArray[np.float64], faces: Ints, chosen: Mask, least: float) -> Ints:
    """(E, 2) edges of chosen faces shorter than ``least``, lower index first; some twice."""
    found = []
    for f in range(len(faces)):
        if not chosen[f]:
            continue
        for k in range(3):
            a, b = faces[f, k], faces[f, (k + 1) % 3]
            x, y, z = (
                vertices[a, 0] - vertices[b, 0],
                vertices[a, 1] - vertices[b, 1],
                vertices[a, 2] - vertices[b, 2],
            )
            if x * x + y * y + z * z < least * least:
                found.append((min(a, b), max(a, b)))
    edges = np.empty((len(found), 2), dtype=np.int64)
    for n in range(len(found)):
        edges[n, 0], edges[n, 1] = found[n]
    return edges


@njit(cache=True)  # type: ignore[untyped-decorator]
def _fans(faces: Ints, touched: Mask) -> tuple[Ints, Ints]:
    """The faces round each vertex, as the two arrays of compressed sparse rows: of all faces that are touched."""
    count = len(touched)
    start = np.zeros(count + 1, dtype=np.int64)
    for f in range(len(faces)):
        if touched[faces[f, 0]] or touched[faces[f, 1]] or touched[faces[f, 2]]:
            for k in range(3):
                start[faces[f, k] + 1] += 1
    for v in range(count):
        start[v + 1] += start[v]
    fan = np.empty(start[count], dtype=np.int64)
    free = start[:-1].copy()
    for f in range(len(faces)):
        if touched[faces[f, 0]] or touched[faces[f, 1]] or touched[faces[f, 2]]:
            for k in range(3):
                fan[free[faces[f, k]]] = f
                free[faces[f, k]] += 1
    return start, fan


@njit(cache=True)  # type: ignore[untyped-decorator]
def _collapse(faces: Ints, edges: Ints, start: Ints, fan: Ints, alive: Mask, moved: Mask) -> None:
    """Collapse edges in their order, in place; vertices that became one hang together in a list."""
    count = len(start) - 1
    became = np.arange(count)
    following, last = np.full(count, -1), np.arange(count)
    beside, common = np.full(count, -1), np.full(count, -1)
    for e in range(len(edges)):
        kept, gone = edges[e]
        while became[kept] != kept:
            kept = became[kept]
        while became[gone] != gone:
            gone = became[gone]
        if kept == gone:
            continue
        v = kept
        while v >= 0:
            for n in range(start[v], start[v + 1]):
                if alive[fan[n]]:
                    for k in range(3):
                        beside[faces[fan[n], k]] = e
            v = following[v]
        faces_shared = shared = 0
        v = gone
        while v >= 0:
            for n in range(start[v], start[v + 1]):
                f = fan[n]
                if not alive[f]:
                    continue
                if faces[f, 0] == kept or faces[f, 1] == kept or faces[f, 2] == kept:
                    faces_shared += 1
                for k in range(3):
                    w = faces[f, k]
                    if w not in (kept, gone) and beside[w] == e and common[w] != e:
                        common[w] = e
                        shared += 1
            v = following[v]
        if faces_shared != 2 or shared != 2:
            continue
        v = gone
        while v >= 0:
            for n in range(start[v], start[v + 1]):
                f = fan[n]
                if not alive[f]:
                    continue
                if faces[f, 0] == kept or faces[f, 1] == kept or faces[f, 2] == kept:
                    alive[f] = False
                    continue
                for k in range(3):
                    if faces[f, k] == gone:
                        faces[f, k] = kept
                        moved[f] = True
            v = following[v]
        became[gone] = kept
        following[last[kept]] = gone
        last[kept] = last[gone]
