"""What a printer cares about: the wall's true thickness and the surfaces that face down."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from dualms.body.body import Body
from dualms.body.patches import INTERFACE
from dualms.nearest import Nearest
from dualms.triangles import TriangleMesh

OVERHANG_DEGREES = 45.0  # the usual limit of laser powder-bed fusion without supports
SAMPLES = 20_000
DIRECTIONS = 400
SHORTLISTED_BY = 50_000  # triangles, evenly drawn, by which the directions are chosen that all are asked for
SHORTLIST = 16
BORDER_STEP = 0.5  # of the wall's thickness, between samples of where it ends
DIRECTIONS_AT_A_TIME = 16  # bounds the memory

Array = NDArray[np.float64]


def wall_thicknesses(body: Body, seed: int) -> Array:
    """(S,) thickness of the separating wall, metres, at random points of the hot interface."""
    return wall_samples(body, seed)[1]


def wall_samples(body: Body, seed: int) -> tuple[Array, Array]:
    """(S, 3) random points of the hot interface, and (S,) the thickness of the separating wall there, metres.

    Points where the wall has none of its own are left out, unless it has none anywhere.
    """
    hot = body.hot.mesh.part(body.hot.patch == INTERFACE)
    points = hot.centroids
    if len(points) > SAMPLES:
        share = hot.areas / hot.area
        points = points[np.random.default_rng(seed).choice(len(points), SAMPLES, replace=False, p=share)]
    away = ~beside_the_shell(points, body)
    points = points[away] if away.any() else points
    return points, to_cold(points, body)


def to_cold(points: Array, body: Body) -> Array:
    """(P,) distance of points (P, 3) from the cold side of the wall, metres: on the hot side, its thickness."""
    return Nearest(body.cold.mesh.part(body.cold.patch == INTERFACE)).distance(points)


def beside_the_shell(points: Array, body: Body) -> NDArray[np.bool_]:
    """(P,) whether points (P, 3) lie within two wall thicknesses of where one of the wall's sides ends.

    There it meets the shell, and has no thickness of its own.
    """
    beside = np.zeros(len(points), dtype=bool)
    for fluid in (body.hot, body.cold):
        side = fluid.mesh.part(fluid.patch == INTERFACE)
        a, b = side.vertices[side.border].swapaxes(0, 1)
        pieces = np.ceil(np.linalg.norm(b - a, axis=1) / (BORDER_STEP * body.wall_m)).astype(np.int64) + 1
        edge = np.repeat(np.arange(len(a)), pieces)
        along = (np.arange(len(edge)) - np.repeat(np.cumsum(pieces) - pieces, pieces)) / np.repeat(pieces - 1, pieces)
        if len(edge):
            border = cKDTree(a[edge] + along[:, None] * (b - a)[edge])
            beside |= np.isfinite(border.query(points, distance_upper_bound=2 * body.wall_m)[0])
    return beside


def overhang_fraction(mesh: TriangleMesh, up: Array) -> float:
    """Share of a solid's surface that faces down more steeply than 45° to the build direction."""
    return float(_overhangs(mesh, up[None] / np.linalg.norm(up))[0])


def wall_overhang(body: Body, up: Array) -> tuple[float, float]:
    """Area (m²) of the separating wall's undersides flatter than 45°, and its share of the wall's two sides."""
    unit = up / np.linalg.norm(up)
    under = total = 0.0
    for fluid in (body.hot, body.cold):
        interface = fluid.mesh.part(fluid.patch == INTERFACE)
        crosses, areas = interface.crosses, interface.areas
        # A fluid's outward normal points into the wall: the wall faces down where that points up.
        under += float(areas[crosses @ unit > 2 * areas * np.sin(np.radians(OVERHANG_DEGREES))].sum())
        total += float(areas.sum())
    return under, under / total if total else 0.0


def trapped_volume(solid: TriangleMesh) -> float:
    """Volume of the cavities inside a solid that no opening reaches: its inner shells."""
    volumes = solid.shell_volumes()
    return float(-volumes[volumes < 0].sum())


def best_build_direction(mesh: TriangleMesh) -> tuple[Array, float]:
    """The direction of least overhang among the axes and 400 directions spread evenly, and its overhang share."""
    index = np.arange(DIRECTIONS) + 0.5
    height, angle = 1 - 2 * index / DIRECTIONS, np.pi * (1 + np.sqrt(5)) * index  # Fibonacci lattice on the sphere
    across = np.sqrt(1 - height**2)
    spread = np.stack([across * np.cos(angle), across * np.sin(angle), height], axis=1)
    directions = np.concatenate([np.eye(3), -np.eye(3), spread])
    if len(mesh.faces) > SHORTLISTED_BY:
        few = TriangleMesh(mesh.vertices, mesh.faces[:: -(-len(mesh.faces) // SHORTLISTED_BY)])
        directions = directions[np.argsort(_overhangs(few, directions), kind="stable")[:SHORTLIST]]
    found = _overhangs(mesh, directions)
    best = int(found.argmin())
    return directions[best], float(found[best])


def _overhangs(mesh: TriangleMesh, directions: Array) -> Array:
    """(D,) overhang share for each unit direction (D, 3); what lies on the building plate is no overhang."""
    crosses = mesh.crosses
    lengths = np.linalg.norm(crosses, axis=1)
    normals = crosses / np.maximum(lengths, 1e-300)[:, None]
    limit = -np.sin(np.radians(OVERHANG_DEGREES)) - 1e-9
    shares = np.empty(len(directions))
    for start in range(0, len(directions), DIRECTIONS_AT_A_TIME):
        some = directions[start : start + DIRECTIONS_AT_A_TIME]
        down = (some @ normals.T < limit) @ lengths
        heights = some @ mesh.vertices.T
        lowest = heights.min(axis=1, keepdims=True)
        low = heights <= lowest + 1e-6 * (heights.max(axis=1, keepdims=True) - lowest)
        for k in np.flatnonzero(low.sum(axis=1) > 2):  # else no triangle lies there
            plate = low[k][mesh.faces].all(axis=1)
            down[k] = lengths[(normals @ some[k] < limit) & ~plate].sum()
        shares[start : start + len(some)] = down / lengths.sum()
    return shares
