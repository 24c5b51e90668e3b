"""Streamlines through a voxel flow, by the midpoint rule, all of them side by side."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from dualms.cfd.channels import STEPS
from dualms.cfd.mesh import ChannelMesh
from dualms.grid import Array

STEP = 0.5  # voxels


def streamlines(
    mesh: ChannelMesh, velocity_m_s: Array, shape: tuple[int, ...], count: int, seed: int = 0
) -> list[tuple[Array, Array]]:
    """Follow the flow from random inlet cells until it leaves the fluid.

    Parameters
    ----------
    mesh
        The fluid's cells.
    velocity_m_s
        (N, 3) of the cells.
    shape
        Of the voxel lattice.
    count
        So many lines, at most one a cell of the inlet.
    seed
        Of the choice of cells.

    Returns
    -------
    list of (points, speed)
        (K, 3) lattice coordinates and (K,) speed in m/s of each line with at least ten points.
    """
    field = np.zeros((3, *shape))
    field[:, *mesh.cells.T] = velocity_m_s.T
    fluid = np.zeros(shape, dtype=bool)
    fluid[tuple(mesh.cells.T)] = True
    inlet = np.unique(mesh.owner[mesh.patch("inlet")])
    chosen = np.random.default_rng(seed).permutation(inlet)[:count]
    points = mesh.cells[chosen].astype(float)
    alive = np.ones(len(points), dtype=bool)
    path, speeds = [], []
    for _ in range(int(12 * max(shape) / STEP)):
        first, speed = _direction(field, points)
        second, _ = _direction(field, points + 0.5 * STEP * first)
        path.append(np.where(alive[:, None], points, np.nan))
        speeds.append(speed)
        points = points + STEP * second
        at = np.clip(np.rint(points).astype(int), 0, np.array(shape) - 1)
        alive = alive & fluid[tuple(at.T)] & (speed > 0)
        if not alive.any():
            break
    lines, values = np.stack(path, axis=1), np.stack(speeds, axis=1)
    found = []
    for line, value in zip(lines, values, strict=True):
        inside: NDArray[np.bool_] = np.isfinite(line[:, 0])
        if inside.sum() >= 10:
            found.append((line[inside], value[inside]))
    return found


def _direction(field: Array, points: Array) -> tuple[Array, Array]:
    """Unit directions (P, 3) and speeds (P,) at lattice coordinates."""
    velocity = np.stack([ndimage.map_coordinates(part, points.T, order=1) for part in field], axis=1)
    speed = np.linalg.norm(velocity, axis=1)
    return velocity / np.maximum(speed, 1e-30)[:, None], speed


def tubes(lines: list[tuple[Array, Array]], radius: float, sides: int = 6) -> tuple[Array, NDArray[np.int64], Array]:
    """Triangles round polylines.

    Parameters
    ----------
    lines
        As :func:`streamlines` gives them.
    radius
        In the lines' units.
    sides
        Of the tube's section.

    Returns
    -------
    tuple
        Vertices (V, 3), faces (F, 3), and the value of each vertex (V,).
    """
    vertices, faces, values = [], [], []
    first = 0
    turn = 2 * np.pi * np.arange(sides) / sides
    for points, value in lines:
        tangent = np.gradient(points, axis=0)
        tangent /= np.maximum(np.linalg.norm(tangent, axis=1), 1e-12)[:, None]
        # A direction across that no tangent is parallel to, the same along the line where it can be.
        across = np.cross(tangent, STEPS[1 + 2 * int(np.abs(tangent).mean(axis=0).argmin())])
        across /= np.maximum(np.linalg.norm(across, axis=1), 1e-9)[:, None]
        other = np.cross(tangent, across)
        ring = np.cos(turn)[None, :, None] * across[:, None] + np.sin(turn)[None, :, None] * other[:, None]
        vertices.append((points[:, None] + radius * ring).reshape(-1, 3))
        values.append(np.repeat(value, sides))
        k, s = np.meshgrid(np.arange(len(points) - 1), np.arange(sides), indexing="ij")
        a, b = first + k * sides + s, first + k * sides + (s + 1) % sides
        faces.append(np.stack([a, b, a + sides, b, b + sides, a + sides], axis=-1).reshape(-1, 3))
        first += len(points) * sides
    return np.concatenate(vertices), np.concatenate(faces).astype(np.int64), np.concatenate(values)
