"""Leaks and ways found by walking: from voxel to voxel, never through a triangle of the solid or of a port.

A check of its own kind beside the booleans: it reads nothing but the finished meshes. The surface's crossings with the
lines of the grid are exact, so a wall thinner than a voxel still stops the walk.
"""

from __future__ import annotations

import igl
import numpy as np
from numba import njit
from numpy.typing import NDArray

from dualms.body.body import Body, Fluid
from dualms.grid import Grid
from dualms.measure.figures import SeparationFigures

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

ASIDE = np.array([0.137, 0.271, 0.359])  # of a voxel: planes of the body should miss the lines of the grid
SEEDS = 200  # tried at each port
DEEP = 0.75  # voxels that a walk starts below a port


def separation(body: Body, spacing: float) -> SeparationFigures:
    """Walk from every port.

    Parameters
    ----------
    body
        In metres.
    spacing
        Edge of a voxel, metres.
    """
    low, high = body.solid.vertices.min(axis=0), body.solid.vertices.max(axis=0)
    plain = _around(low, high, spacing)
    fences = [body.solid, *(f.mesh.part(f.patch >= 2) for f in (body.hot, body.cold))]
    blocked = np.zeros(plain.shape, dtype=np.uint8)
    for mesh in fences:
        _block((mesh.vertices - plain.origin) / spacing, mesh.faces, blocked)
    doors = {sign: _doors(fluid, plain) for sign, fluid in ((1, body.hot), (-1, body.cold))}
    reached = {sign: _flood(blocked, found[0][:1]) if len(found[0]) else None for sign, found in doors.items()}
    apart = to_outside = 0
    for sign, found in doors.items():
        walked = reached[sign]
        if walked is None:
            apart += len(found)
            continue
        apart += sum(not walked[tuple(door.T)].any() for door in found)
        to_outside += int(walked[0, 0, 0])
    hot = reached[1]
    crossed = 0 if hot is None else sum(bool(hot[tuple(door.T)].any()) for door in doors[-1])
    return SeparationFigures(voxel_m=spacing, hot_to_cold=crossed, to_outside=to_outside, ports_apart=apart)


def _around(low: Array, high: Array, spacing: float) -> Grid:
    """A grid that leaves two voxels on each side, its lines a little aside of round coordinates."""
    nx, ny, nz = (int(n) for n in np.ceil((high - low) / spacing) + 4)
    return Grid(low - (2 - ASIDE) * spacing, spacing, (nx, ny, nz))


def _doors(fluid: Fluid, grid: Grid) -> list[Indices]:
    """For each port (K, 3) voxels just below it that lie in the fluid."""
    below = []
    for k in range(2, len(fluid.patches)):
        port = fluid.mesh.part(fluid.patch == k)
        chosen = np.argsort(-port.areas, kind="stable")[:SEEDS]
        normals = port.crosses[chosen] / np.maximum(2 * port.areas[chosen], 1e-300)[:, None]
        below.append(grid.nearest(port.centroids[chosen] - DEEP * grid.spacing * normals))
    centres = np.ascontiguousarray(grid.origin + grid.spacing * np.concatenate(below))
    inside = igl.fast_winding_number(fluid.mesh.vertices, fluid.mesh.faces, centres) > 0.5
    ends = np.cumsum([len(voxels) for voxels in below])[:-1]
    return [voxels[kept] for voxels, kept in zip(below, np.split(inside, ends), strict=True)]


@njit(cache=True)  # type: ignore[untyped-decorator]
def _side(p: Array, q: Array, b: int, c: int, j: float, k: float) -> float:
    """Twice the signed area of (p, q, point) in the plane of b and c."""
    return float((q[b] - p[b]) * (k - p[c]) - (q[c] - p[c]) * (j - p[b]))


@njit(cache=True)  # type: ignore[untyped-decorator]
def _block(vertices: Array, faces: Indices, blocked: NDArray[np.uint8]) -> None:
    """Mark the steps between voxels that a mesh (in voxels) crosses: bit a of a voxel, the step to its next along a.

    An edge's side is computed from its lower to its higher vertex, so both of its triangles see the same number and no
    line slips between them.
    """
    for f in range(len(faces)):
        for a in range(3):
            b, c = (a + 1) % 3, (a + 2) % 3
            x, y, z = faces[f, 0], faces[f, 1], faces[f, 2]
            lows = np.empty(2)
            highs = np.empty(2)
            for n, axis in enumerate((b, c)):
                lows[n] = min(vertices[x, axis], vertices[y, axis], vertices[z, axis])
                highs[n] = max(vertices[x, axis], vertices[y, axis], vertices[z, axis])
            for j in range(int(np.ceil(lows[0])), int(np.floor(highs[0])) + 1):
                for k in range(int(np.ceil(lows[1])), int(np.floor(highs[1])) + 1):
                    weight = np.empty(3)
                    for e in range(3):
                        # The side opposite to corner e.
                        p, q = faces[f, (e + 1) % 3], faces[f, (e + 2) % 3]
                        if p < q:
                            weight[e] = _side(vertices[p], vertices[q], b, c, j, k)
                        else:
                            weight[e] = -_side(vertices[q], vertices[p], b, c, j, k)
                    if not ((weight >= 0).all() or (weight <= 0).all()):
                        continue
                    total = weight.sum()
                    if total == 0:
                        continue
                    height = (
                        weight[0] * vertices[x, a] + weight[1] * vertices[y, a] + weight[2] * vertices[z, a]
                    ) / total
                    for step in (int(np.floor(height - 1e-9)), int(np.floor(height + 1e-9))):
                        if 0 <= step < blocked.shape[a] - 1:
                            if a == 0:
                                blocked[step, j, k] |= 1
                            elif a == 1:
                                blocked[k, step, j] |= 2
                            else:
                                blocked[j, k, step] |= 4


@njit(cache=True)  # type: ignore[untyped-decorator]
def _flood(blocked: NDArray[np.uint8], start: Indices) -> NDArray[np.bool_]:
    """(nx, ny, nz) voxels that a walk from ``start`` (K, 3) reaches."""
    shape = blocked.shape
    reached = np.zeros(shape, dtype=np.bool_)
    stack = np.empty((blocked.size, 3), dtype=np.int16)
    top = 0
    for s in range(len(start)):
        reached[start[s, 0], start[s, 1], start[s, 2]] = True
        stack[top] = start[s]
        top += 1
    while top > 0:
        top -= 1
        x, y, z = stack[top, 0], stack[top, 1], stack[top, 2]
        for a in range(3):
            for forward in (0, 1):
                u, v, w = x, y, z
                if a == 0:
                    u += 2 * forward - 1
                elif a == 1:
                    v += 2 * forward - 1
                else:
                    w += 2 * forward - 1
                if u < 0 or v < 0 or w < 0 or u >= shape[0] or v >= shape[1] or w >= shape[2]:
                    continue
                gate = blocked[x, y, z] if forward else blocked[u, v, w]
                if (gate >> a) & 1 or reached[u, v, w]:
                    continue
                reached[u, v, w] = True
                stack[top, 0], stack[top, 1], stack[top, 2] = u, v, w
                top += 1
    return reached
