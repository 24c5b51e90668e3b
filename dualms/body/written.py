"""A solid as files can hold it: vertices that single precision tells apart, and no triangle that crosses another.

STL and 3MF hold single precision, and readers of STL join vertices by position. Booleans leave vertices that only
double precision tells apart; rounding alone would pinch a closed mesh and fold its thin triangles over. So features are
separated before they are rounded (Milenkovic and Sacks 2019, "Geometric rounding and feature separation in meshes"):
vertices go to the lattice of single precision, edges shorter than a fine fraction of the size are collapsed, and the
result is tested exactly.
"""

from __future__ import annotations

from collections import defaultdict

import manifold3d
import numpy as np
from numpy.typing import NDArray

from dualms.booleans import Solid
from dualms.errors import InvalidBody
from dualms.intersections import crossing_triangles
from dualms.triangles import TriangleMesh

Ints = NDArray[np.int64]

SEPARATION = 1e-6  # of the body's size: 0.1 µm on 140 mm
WHERE_CROSSING = (3e-6, 1e-5, 3e-5, 1e-4, 3e-4, 1e-3, 3e-3)  # the same, of the few triangles that still cross others


def lattice_step(vertices: NDArray[np.float64]) -> float:
    """The spacing of single precision at the farthest coordinate: all multiples up to there are exact."""
    return float(np.spacing(np.float32(np.abs(vertices).max(initial=1e-30))))


def as_written(solid: Solid, scale: float, offset: NDArray[np.float64]) -> tuple[TriangleMesh, Ints, int]:
    """The boundary as files will hold it.

    Parameters
    ----------
    solid
        Any closed body.
    scale, offset
        Its vertices in the files' unit are ``offset + scale · v``.

    Returns
    -------
    mesh
        Closed, in the files' unit; every coordinate is exact in single precision, and no two vertices coincide unless
        triangles cross there.
    origin
        (F,) the body that each triangle was cut from.
    crossing
        Triangles that still meet others beyond the edges and corners that they share: 0 unless the solid itself touches
        itself over an area.

    Raises
    ------
    InvalidBody
        If the mesh does not stay closed.
    """
    made, origin = solid.faces_by_origin()
    vertices = offset + scale * made.vertices
    step = lattice_step(vertices)
    vertices = np.rint(vertices / step) * step
    size = float(np.ptp(vertices, axis=0).max())
    mesh, origin = _separated(TriangleMesh(vertices, made.faces), origin, SEPARATION * size)
    for least in (*WHERE_CROSSING, 0.0):
        crossing = crossing_triangles(mesh, step)
        if not crossing.any():
            break
        mesh, origin = _collapsed(mesh, origin, least * size, crossing)
    if not mesh.is_closed:
        raise InvalidBody(
            "The body does not stay closed once its coordinates are rounded to single precision.",
            advice="Change surface.resolution or the wall's thickness a little.",
        )
    return mesh, origin, int(crossing.sum())


def _separated(mesh: TriangleMesh, origin: Ints, least: float) -> tuple[TriangleMesh, Ints]:
    """The mesh without edges shorter than ``least``, and without vertices that leave it by less when removed."""
    order = np.argsort(origin, kind="stable")
    bodies, first = np.unique(origin[order], return_index=True)
    # In single precision on purpose: manifold3d then takes its precision to be that of the format.
    manifold = manifold3d.Manifold(
        manifold3d.Mesh(
            vert_properties=mesh.vertices.astype(np.float32),
            tri_verts=mesh.faces[order].astype(np.uint32),
            run_index=3 * np.append(first, len(order)).astype(np.uint32),
            run_original_id=bodies.astype(np.uint32),
        )
    )
    simpler, origins = Solid(manifold.simplify(least), -1).faces_by_origin()
    return _collapsed(simpler, origins, least, np.ones(len(origins), dtype=bool))


def _collapsed(mesh: TriangleMesh, origin: Ints, least: float, chosen: NDArray[np.bool_]) -> tuple[TriangleMesh, Ints]:
    """Edges of ``chosen`` (F,) faces shorter than ``least`` collapsed onto one of their ends, shortest first.

    Where the mesh stays closed: the ends have exactly two neighbours in common (link condition, Dey et al. 1999).
    """
    faces = mesh.faces.copy()
    ends = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1)[chosen]
    ends = np.unique(np.sort(ends.reshape(-1, 2), axis=1), axis=0)
    length = np.linalg.norm(mesh.vertices[ends[:, 0]] - mesh.vertices[ends[:, 1]], axis=1)
    short, length = ends[length < least], length[length < least]
    touched = np.zeros(len(mesh.vertices), dtype=bool)
    touched[short] = True
    fan: dict[int, set[int]] = defaultdict(set)
    for face in np.flatnonzero(touched[faces].any(axis=1)).tolist():
        for vertex in faces[face].tolist():
            fan[vertex].add(face)
    alive = np.ones(len(faces), dtype=bool)
    became = np.arange(len(mesh.vertices))
    for a, b in short[np.lexsort((short[:, 1], short[:, 0], length))].tolist():
        kept, gone = (int(_last(became, v)) for v in (a, b))
        common = fan[kept] & fan[gone]
        around = (set(faces[list(fan[v])].ravel().tolist()) for v in (kept, gone))
        if kept == gone or len(common) != 2 or len(set.intersection(*around) - {kept, gone}) != 2:
            continue
        for face in common:
            alive[face] = False
            for vertex in faces[face].tolist():
                fan[vertex].discard(face)
        for face in fan[gone]:
            faces[face] = np.where(faces[face] == gone, kept, faces[face])
        fan[kept] |= fan.pop(gone)
        became[gone] = kept
    left = TriangleMesh(mesh.vertices, faces)
    return left.part(alive), origin[alive]


def _last(became: Ints, vertex: int) -> int:
    while became[vertex] != vertex:
        vertex = int(became[vertex])
    return vertex
