"""What a printer cares about: the wall's true thickness and the surfaces that face down."""

from __future__ import annotations

import igl
import numpy as np
from numpy.typing import NDArray

from dualms.body.body import Body
from dualms.body.patches import INTERFACE
from dualms.triangles import TriangleMesh

OVERHANG_DEGREES = 45.0  # the usual limit of laser powder-bed fusion without supports
SAMPLES = 20_000


def wall_thicknesses(body: Body, seed: int) -> NDArray[np.float64]:
    """(S,) thickness of the separating wall, metres, at random points of the hot interface.

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
    return _distance(points[keep] if keep.any() else points, cold)


def overhang_fraction(mesh: TriangleMesh, up: NDArray[np.float64]) -> float:
    """Share of a solid's surface that faces down more steeply than 45° to the build direction."""
    up = up / np.linalg.norm(up)
    cosines = mesh.crosses @ up / np.maximum(np.linalg.norm(mesh.crosses, axis=1), 1e-300)
    base = mesh.vertices @ up
    on_plate = (base[mesh.faces] < base.min() + 1e-6 * np.ptp(base)).all(axis=1)
    down = (cosines < -np.sin(np.radians(OVERHANG_DEGREES)) - 1e-9) & ~on_plate
    return float(mesh.areas[down].sum() / mesh.area)


def _distance(points: NDArray[np.float64], mesh: TriangleMesh) -> NDArray[np.float64]:
    squared, _, _ = igl.point_mesh_squared_distance(np.ascontiguousarray(points), mesh.vertices, mesh.faces)
    return np.asarray(np.sqrt(squared))
