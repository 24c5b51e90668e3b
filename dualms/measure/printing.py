"""What a printer cares about: the wall's true thickness and the surfaces that face down."""

from __future__ import annotations

import igl
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from dualms.body.body import Body
from dualms.body.patches import INTERFACE
from dualms.triangles import TriangleMesh

OVERHANG_DEGREES = 45.0  # the usual limit of laser powder-bed fusion without supports
SAMPLES = 20_000
DIRECTIONS = 400

Array = NDArray[np.float64]


def wall_thicknesses(body: Body, seed: int) -> Array:
    """(S,) thickness of the separating wall, metres, at random points of the hot interface."""
    return wall_samples(body, seed)[1]


def wall_samples(body: Body, seed: int) -> tuple[Array, Array]:
    """(S, 3) random points of the hot interface, and (S,) the thickness of the separating wall there, metres.

    The distance from the hot side's interface to the cold side's. Points within two wall thicknesses of the other
    patches are left out: there the wall meets the shell and has no thickness of its own.
    """
    hot, cold = (f.mesh.part(f.patch == INTERFACE) for f in (body.hot, body.cold))
    points = hot.centroids
    if len(points) > SAMPLES:
        share = hot.areas / hot.area
        points = points[np.random.default_rng(seed).choice(len(points), SAMPLES, replace=False, p=share)]
    keep = np.ones(len(points), dtype=bool)
    for fluid in (body.hot, body.cold):
        rim = fluid.mesh.part(fluid.patch != INTERFACE)
        if len(rim.faces):
            keep &= _distance(points, rim) > 2 * body.wall_m
    points = points[keep] if keep.any() else points
    return points, _distance(points, cold)


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
    n = len(solid.vertices)
    edges = np.concatenate([solid.faces[:, [0, 1]], solid.faces[:, [1, 2]]])
    links = coo_array((np.ones(len(edges)), tuple(edges.T)), shape=(n, n))
    _, label = connected_components(links, directed=False)
    shells = label[solid.faces[:, 0]]
    volumes = [solid.part(shells == k).volume for k in np.unique(shells)]
    return float(-sum(v for v in volumes if v < 0))


def best_build_direction(mesh: TriangleMesh) -> tuple[Array, float]:
    """The direction of least overhang among the axes and 400 directions spread evenly, and its overhang share."""
    index = np.arange(DIRECTIONS) + 0.5
    height, angle = 1 - 2 * index / DIRECTIONS, np.pi * (1 + np.sqrt(5)) * index  # Fibonacci lattice on the sphere
    across = np.sqrt(1 - height**2)
    spread = np.stack([across * np.cos(angle), across * np.sin(angle), height], axis=1)
    directions = np.concatenate([np.eye(3), -np.eye(3), spread])
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
    for k, up in enumerate(directions):
        down = normals @ up < limit
        height = mesh.vertices @ up
        plate = height.min() + 1e-6 * np.ptp(height)
        down[down] = (height[mesh.faces[down]] > plate).any(axis=1)
        shares[k] = lengths[down].sum() / lengths.sum()
    return shares


def _distance(points: Array, mesh: TriangleMesh) -> Array:
    squared, _, _ = igl.point_mesh_squared_distance(np.ascontiguousarray(points), mesh.vertices, mesh.faces)
    return np.asarray(np.sqrt(squared))
