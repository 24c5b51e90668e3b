"""A solid as files can hold it: vertices that single precision tells apart, and no triangle that crosses another.

STL and 3MF hold single precision, and readers of STL join vertices by position. Booleans leave vertices that only
double precision tells apart; rounding alone would pinch a closed mesh and fold its thin triangles over. So features are
separated before they are rounded (Milenkovic and Sacks 2019, "Geometric rounding and feature separation in meshes"):
vertices go to the lattice of single precision, edges shorter than a fine fraction of the size are collapsed, and the
result is tested exactly.
"""

from __future__ import annotations

from itertools import product

import manifold3d
import numpy as np
from numpy.typing import NDArray

from dualms.body.collapse import collapsed
from dualms.body.flip import flipped
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
    crossing = crossing_triangles(mesh, step)
    for wide, least in product((False, True), WHERE_CROSSING):
        if not crossing.any():
            break
        # Two triangles that did not cross and have not moved do not cross afterwards.
        mesh, origin, suspect = _mended(mesh, origin, crossing, wide, least * size)
        crossing = crossing_triangles(mesh, step, suspect)
    if not mesh.is_closed:
        raise InvalidBody(
            "The body does not stay closed once its coordinates are rounded to single precision.",
            advice="Change surface.resolution or the wall's thickness a little.",
        )
    return mesh, origin, int(crossing.sum())


def _mended(
    mesh: TriangleMesh, origin: Ints, crossing: NDArray[np.bool_], wide: bool, least: float
) -> tuple[TriangleMesh, Ints, NDArray[np.bool_]]:
    """A try at mending triangles that cross, and (F',) which triangles may cross now.

    Pairs back to back on the same corners are dropped, edges of flat triangles flipped, short edges collapsed; ``wide``
    takes the neighbours along.
    """
    back = _back_to_back(mesh, crossing)
    mesh, origin, crossing = mesh.part(~back), origin[~back], crossing[~back]
    mesh, origin, turned = flipped(mesh, origin, least, crossing)
    crossing = crossing | turned
    mesh, kept, moved = collapsed(mesh, least, _with_neighbours(mesh, crossing) if wide else crossing)
    return mesh, origin[kept], crossing[kept] | moved


def _back_to_back(mesh: TriangleMesh, chosen: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(F,) the chosen triangles that lie in pairs on the same corners: closed bodies without a volume."""
    index = np.flatnonzero(chosen)
    _, inverse, count = np.unique(np.sort(mesh.faces[index], axis=1), axis=0, return_inverse=True, return_counts=True)
    found = np.zeros(len(mesh.faces), dtype=bool)
    found[index[count[inverse.reshape(-1)] == 2]] = True
    return found


def _with_neighbours(mesh: TriangleMesh, chosen: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(F,) the chosen triangles and those that share a corner with them."""
    touched = np.zeros(len(mesh.vertices), dtype=bool)
    touched[mesh.faces[chosen]] = True
    return np.asarray(touched[mesh.faces].any(axis=1))


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
    simpler, kept, _ = collapsed(simpler, least)
    return simpler, origins[kept]
