"""Exact distance to a mesh on the voxels near it: each triangle tells the voxels round it how far it is.

The nearest point of a triangle follows Ericson 2005, "Real-Time Collision Detection", section 5.1.5.
"""

from __future__ import annotations

import numpy as np
from numba import get_num_threads, njit, prange
from numpy.typing import NDArray

from dualms.grid import Grid
from dualms.triangles import TriangleMesh

Array = NDArray[np.float64]

THINNEST = 1e-12  # squared sine of a corner: thinner triangles are taken as their edges


def band_distance(mesh: TriangleMesh, grid: Grid, band: float) -> Array:
    """Distance of voxels from a mesh, clipped to ``band``.

    Parameters
    ----------
    mesh
        Any triangles; time grows with the voxels in their bounding boxes, so they should not be long.
    grid
        Where it is wanted.
    band
        Further than this nothing is computed.

    Returns
    -------
    (nx, ny, nz) float64
        In the mesh's and the grid's unit.
    """
    squared = np.full(grid.shape, (band / grid.spacing) ** 2)
    corners = ((mesh.vertices - grid.origin) / grid.spacing)[mesh.faces]
    # Each thread has a slab of the grid to itself, with as many triangles as the others.
    slabs = np.quantile(corners[:, 0, 0], np.linspace(0, 1, get_num_threads() + 1)).round().astype(np.int64)
    slabs = np.clip(slabs, 0, grid.shape[0])
    slabs[0], slabs[-1] = 0, grid.shape[0]
    _lower(corners, band / grid.spacing, slabs, squared)
    return np.asarray(grid.spacing * np.sqrt(squared))


@njit(cache=True, parallel=True)  # type: ignore[untyped-decorator]
def _lower(corners: Array, band: float, slabs: NDArray[np.int64], squared: Array) -> None:
    """Lower ``squared`` to the squared distance of each triangle's corners (F, 3, 3), all in voxels."""
    _, ny, nz = squared.shape
    for slab in prange(len(slabs) - 1):
        for f in range(len(corners)):
            a, b, c = corners[f]
            first = max(int(np.ceil(min(a[0], b[0], c[0]) - band)), slabs[slab])
            last = min(int(np.floor(max(a[0], b[0], c[0]) + band)), slabs[slab + 1] - 1)
            if first > last:
                continue
            j0 = max(int(np.ceil(min(a[1], b[1], c[1]) - band)), 0)
            j1 = min(int(np.floor(max(a[1], b[1], c[1]) + band)), ny - 1)
            k0 = max(int(np.ceil(min(a[2], b[2], c[2]) - band)), 0)
            k1 = min(int(np.floor(max(a[2], b[2], c[2]) + band)), nz - 1)
            u0, u1, u2 = b[0] - a[0], b[1] - a[1], b[2] - a[2]
            v0, v1, v2 = c[0] - a[0], c[1] - a[1], c[2] - a[2]
            n0, n1, n2 = u1 * v2 - u2 * v1, u2 * v0 - u0 * v2, u0 * v1 - u1 * v0
            nn = n0 * n0 + n1 * n1 + n2 * n2
            uu, uv, vv = u0 * u0 + u1 * u1 + u2 * u2, u0 * v0 + u1 * v1 + u2 * v2, v0 * v0 + v1 * v1 + v2 * v2
            flat = nn > THINNEST * uu * vv
            for i in range(first, last + 1):
                p0 = i - a[0]
                for j in range(j0, j1 + 1):
                    p1 = j - a[1]
                    for k in range(k0, k1 + 1):
                        p2 = k - a[2]
                        height = n0 * p0 + n1 * p1 + n2 * p2
                        found = squared[i, j, k]
                        if flat and height * height > found * nn:
                            continue  # its plane is further than what was found
                        up, vp = u0 * p0 + u1 * p1 + u2 * p2, v0 * p0 + v1 * p1 + v2 * p2
                        s, t = _nearest(uu, uv, vv, up, vp) if flat else _nearest_on_edges(uu, uv, vv, up, vp)
                        d0, d1, d2 = p0 - s * u0 - t * v0, p1 - s * u1 - t * v1, p2 - s * u2 - t * v2
                        distance = d0 * d0 + d1 * d1 + d2 * d2
                        if distance < found:
                            squared[i, j, k] = distance


@njit(cache=True, inline="always")  # type: ignore[untyped-decorator]
def _nearest(uu: float, uv: float, vv: float, up: float, vp: float) -> tuple[float, float]:
    """Coordinates s, t of the point a + s u + t v of a triangle that is nearest to a + p, from their products."""
    if up <= 0 and vp <= 0:
        return 0.0, 0.0
    b1, b2 = up - uu, vp - uv  # products with p - u
    if b1 >= 0 and b2 <= b1:
        return 1.0, 0.0
    vc = up * b2 - b1 * vp
    if vc <= 0 and up >= 0 and b1 <= 0:
        return up / (up - b1), 0.0
    c1, c2 = up - uv, vp - vv  # products with p - v
    if c2 >= 0 and c1 <= c2:
        return 0.0, 1.0
    vb = c1 * vp - up * c2
    if vb <= 0 and vp >= 0 and c2 <= 0:
        return 0.0, vp / (vp - c2)
    va = b1 * c2 - c1 * b2
    if va <= 0 and b2 - b1 >= 0 and c1 - c2 >= 0:
        w = (b2 - b1) / ((b2 - b1) + (c1 - c2))
        return 1 - w, w
    whole = va + vb + vc
    return vb / whole, vc / whole


@njit(cache=True, inline="always")  # type: ignore[untyped-decorator]
def _nearest_on_edges(uu: float, uv: float, vv: float, up: float, vp: float) -> tuple[float, float]:
    """As :func:`_nearest`, on the edges only."""
    s = min(max(up / uu, 0.0), 1.0) if uu > 0 else 0.0
    t = min(max(vp / vv, 0.0), 1.0) if vv > 0 else 0.0
    ww = uu - 2 * uv + vv
    w = min(max((vp - up - uv + uu) / ww, 0.0), 1.0) if ww > 0 else 0.0
    # Squared distances, but for that from the corner a.
    on_u, on_v = s * (s * uu - 2 * up), t * (t * vv - 2 * vp)
    x, y = 1 - w, w
    on_w = x * x * uu + 2 * x * y * uv + y * y * vv - 2 * (x * up + y * vp)
    if on_u <= on_v and on_u <= on_w:
        return s, 0.0
    return (0.0, t) if on_v <= on_w else (x, y)
