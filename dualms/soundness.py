"""Whether triangles bound one closed, oriented body: each check says what is wrong and where."""

from __future__ import annotations

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from dualms.errors import InvalidMesh
from dualms.triangles import TriangleMesh

Array = NDArray[np.float64]


def cleaned(soup: trimesh.Trimesh, problems: list[str]) -> tuple[Array, NDArray[np.int64]]:
    """Vertices merged where they coincide exactly (to 1e-9 of the size), degenerate and repeated triangles dropped."""
    if not np.isfinite(soup.vertices).all():
        bad = int((~np.isfinite(soup.vertices).all(axis=1)).sum())
        raise InvalidMesh(
            f"{bad} vertices have coordinates that are not finite numbers.",
            advice="Export the domain again.",
            measured={"vertices": bad},
        )
    vertices = np.asarray(soup.vertices, dtype=np.float64)
    size = float(np.ptp(vertices, axis=0).max())
    if not 0 < size < 1e9:
        raise InvalidMesh("All vertices coincide, or lie beyond 1e9 units.", advice="Check the export's scale.")
    _, first, inverse = np.unique(np.rint(vertices / (1e-8 * size)), axis=0, return_index=True, return_inverse=True)
    faces = inverse.reshape(-1)[np.asarray(soup.faces)]
    degenerate = (faces == np.roll(faces, 1, axis=1)).any(axis=1)
    if degenerate.any():
        problems.append(f"{int(degenerate.sum())} degenerate triangles were dropped.")
    faces = faces[~degenerate]
    if len(faces) == 0:
        raise InvalidMesh("Every triangle is degenerate.", advice="Check the export's scale and precision.")
    used, faces = np.unique(faces, return_inverse=True)
    return vertices[first][used], faces.reshape(-1, 3).astype(np.int64)


def refuse_unsound(vertices: Array, faces: NDArray[np.int64]) -> None:
    directed = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    _, inverse, counts = np.unique(np.sort(directed, axis=1), axis=0, return_inverse=True, return_counts=True)
    inverse = inverse.reshape(-1)
    for bad, what, advice in (
        (counts == 1, "open: {n} edges belong to one triangle only", "Close the holes in CAD and export a solid."),
        (counts > 2, "not manifold: {n} edges belong to more than two triangles", "Unite touching bodies in CAD."),
    ):
        if bad.any():
            raise InvalidMesh(
                f"The mesh is {what.format(n=int(bad.sum()))}, first near {_where(vertices, directed, bad[inverse])}.",
                advice=advice,
                measured={"edges": int(bad.sum())},
            )
    _, repeated = np.unique(directed, axis=0, return_counts=True)
    forward = directed[:, 0] < directed[:, 1]
    balance = np.bincount(inverse, weights=np.where(forward, 1, -1))
    if (repeated > 1).any():
        raise InvalidMesh(
            f"Neighbouring triangles are oriented against each other along {int((balance != 0).sum())} edges, "
            f"first near {_where(vertices, directed, (balance != 0)[inverse])}.",
            advice="Recompute the normals to point outward and export again.",
            measured={"edges": int((balance != 0).sum())},
        )
    n = len(faces)
    order = np.argsort(inverse, kind="stable").reshape(-1, 2) % n
    links = coo_array((np.ones(len(order)), (order[:, 0], order[:, 1])), shape=(n, n))
    bodies, _ = connected_components(links, directed=False)
    if bodies > 1:
        raise InvalidMesh(
            f"The file holds {bodies} separate closed surfaces.",
            advice="Send one body without inner voids; unite or split the bodies in CAD.",
            measured={"bodies": int(bodies)},
        )
    volume, size = TriangleMesh(vertices, faces).volume, np.ptp(vertices, axis=0)
    if abs(volume) < 1e-6 * size.max() ** 3:
        raise InvalidMesh(
            f"The body encloses next to no volume: {volume:.3g} units³ in a box of {np.round(size, 6).tolist()} units.",
            advice="Send a solid body, not a sheet.",
            measured={"volume": volume},
        )
    if volume < 0:
        raise InvalidMesh(
            f"The faces point inward: the enclosed volume is {volume:.4g} units³.",
            advice="Flip the normals and export again.",
            measured={"volume": volume},
        )


def _where(vertices: Array, edges: NDArray[np.int64], bad: NDArray[np.bool_]) -> list[float]:
    """Middle of the first bad edge, rounded for people."""
    return [float(x) for x in vertices[edges[int(bad.argmax())]].mean(axis=0).round(4)]
