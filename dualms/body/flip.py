"""Flat triangles turned: where a corner lies on the opposite edge, that edge is flipped to start at the corner."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dualms.triangles import TriangleMesh

Ints = NDArray[np.int64]
Mask = NDArray[np.bool_]


def flipped(mesh: TriangleMesh, origin: Ints, least: float, chosen: Mask) -> tuple[TriangleMesh, Ints, Mask]:
    """A closed mesh whose chosen triangles are no lower than a length, where an edge can be flipped.

    Parameters
    ----------
    mesh
        Closed and consistently oriented.
    origin
        (F,) label of each triangle; what is left of a flat one is part of its neighbour.
    least
        Height over the longest edge, in the mesh's unit.
    chosen
        (F,) which triangles may be turned.

    Returns
    -------
    mesh, origin
        The same number of triangles, in the same order.
    turned
        (F,) which of them are new.
    """
    faces, origin, turned = mesh.faces.copy(), origin.copy(), np.zeros(len(mesh.faces), dtype=bool)
    around = np.zeros(len(mesh.vertices), dtype=bool)
    around[faces[chosen]] = True
    near = np.flatnonzero(around[faces].any(axis=1))
    side_of = {(int(faces[f, k]), int(faces[f, (k + 1) % 3])): int(f) for f in near for k in range(3)}
    for f in np.flatnonzero(chosen).tolist():
        corners = mesh.vertices[faces[f]]
        sides = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
        area = np.linalg.norm(np.cross(corners[1] - corners[0], corners[2] - corners[0]))
        if turned[f] or area >= least * sides.max():
            continue
        k = int(sides.argmax())
        a, b, c = (int(faces[f, (k + n) % 3]) for n in range(3))
        across = side_of.get((b, a))
        if across is None or turned[across]:
            continue
        d = int(faces[across].sum()) - a - b
        if d == c or (c, d) in side_of or (d, c) in side_of:
            continue
        faces[f], faces[across] = (c, a, d), (d, b, c)
        origin[f] = origin[across]
        turned[f] = turned[across] = True
        for lost in ((a, b), (b, a)):
            del side_of[lost]
        side_of |= {(c, a): f, (a, d): f, (d, c): f, (d, b): across, (b, c): across, (c, d): across}
    return TriangleMesh(mesh.vertices, faces), origin, turned
