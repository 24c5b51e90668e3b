"""The zero set of a sampled field as a triangle mesh, with curvature from the samples and finite elements on it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, sparse
from skimage.measure import marching_cubes

Array = NDArray[np.float64]
Floats = NDArray[np.float32]
Mask = NDArray[np.bool_]

_LEAST_SLOPE = 0.3
_SNAP = np.float32(0.2)
"""Values below this part of a voxel are moved away from zero, so that no triangle is a sliver."""


@dataclass(frozen=True)
class Jet:
    """First and second derivatives of samples, as the geometry of their level sets; lengths in voxels.

    Parameters
    ----------
    normal
        Three arrays (nx, ny, nz): the unit gradient.
    slope
        (nx, ny, nz) its length, at least 0.3.
    bend
        (nx, ny, nz) divergence of the normal: twice the mean curvature.
    square
        (nx, ny, nz) sum of the squared principal curvatures.
    """

    normal: tuple[Floats, Floats, Floats]
    slope: Floats
    bend: Floats
    square: Floats

    @classmethod
    def of(cls, values: Floats) -> Jet:
        """Central differences, second order; the grid's outermost voxels look across to the opposite side."""
        ahead = [np.roll(values, -1, axis) for axis in range(3)]
        behind = [np.roll(values, 1, axis) for axis in range(3)]
        first = [(a - b) / np.float32(2) for a, b in zip(ahead, behind, strict=True)]
        second: dict[tuple[int, int], Any] = {}
        for i in range(3):
            second[i, i] = ahead[i] + behind[i] - 2 * values
            for j in range(i):
                mixed = (np.roll(first[i], -1, j) - np.roll(first[i], 1, j)) / np.float32(2)
                second[i, j] = second[j, i] = mixed
        slope = np.maximum(np.sqrt(sum(d * d for d in first)), np.float32(_LEAST_SLOPE))
        x, y, z = (np.asarray(d / slope, dtype=np.float32) for d in first)
        normal = (x, y, z)
        along = [sum((second[i, j] * normal[j] for j in range(3)), np.float32(0)) for i in range(3)]
        twice = sum((normal[i] * along[i] for i in range(3)), np.float32(0))
        bend = (second[0, 0] + second[1, 1] + second[2, 2] - twice) / slope
        whole = sum((d * d for d in second.values()), np.float32(0))
        square = np.maximum(whole - 2 * sum(d * d for d in along) + twice * twice, 0) / slope**2
        return cls(normal, slope, np.asarray(bend), np.asarray(square))


@dataclass(frozen=True)
class Sheet:
    """A mesh of the zero set; lengths in voxels, positions as indices into the grid.

    Parameters
    ----------
    points
        (V, 3) vertices.
    stiffness
        (V, V) sparse, the cotangent form of the negative Laplace-Beltrami operator.
    mass
        (V,) area of each vertex.
    bend
        (V,) twice the mean curvature, from the samples.
    square
        (V,) sum of the squared principal curvatures.
    """

    points: Array
    stiffness: Any
    mass: Array
    bend: Array
    square: Array

    @classmethod
    def of(cls, values: Floats, jet: Jet, where: Mask, periodic: bool) -> Sheet:
        """Mesh the zero set in the cells whose corner lies in ``where``; across the box's faces if it is periodic."""
        clear = np.where(np.abs(values) < _SNAP, np.where(values >= 0, _SNAP, -_SNAP), values)
        if periodic:
            clear, where = (np.pad(a, (0, 1), mode="wrap") for a in (clear, where))
        points, faces, _, _ = marching_cubes(clear, 0.0, mask=where)
        points, faces = points.astype(float), faces.astype(np.int64)
        for _ in range(2):
            normal = np.stack([sample(c, points, periodic) for c in jet.normal], axis=1)
            off = sample(values, points, periodic) / sample(jet.slope, points, periodic)
            points -= np.clip(off, -1, 1)[:, None] * normal
        corners = points[faces]
        if periodic:
            points, faces = _closed(points, faces, values.shape)
        stiffness, mass = _elements(corners, faces, len(points))
        bend, square = (sample(a, points, periodic) for a in (jet.bend, jet.square))
        return cls(points, stiffness, mass, bend, square)


def sample(values: NDArray[np.floating], points: Array, periodic: bool) -> Array:
    """Trilinear samples (P,) at index positions (P, 3)."""
    mode = "grid-wrap" if periodic else "nearest"
    return np.asarray(ndimage.map_coordinates(values, points.T, order=1, mode=mode, output=np.float64))


def _closed(points: Array, faces: NDArray[np.int64], shape: tuple[int, ...]) -> tuple[Array, NDArray[np.int64]]:
    """Points that the period maps onto each other made one."""
    keys = np.round(np.mod(points, shape) * 1000).astype(np.int64) % (1000 * np.array(shape))
    _, first, one = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    return points[first], one.reshape(-1)[faces]


def _elements(corners: Array, faces: NDArray[np.int64], count: int) -> tuple[Any, Array]:
    """Stiffness matrix and lumped mass of linear elements, from the corners (F, 3, 3) of the triangles."""
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    area = np.maximum(area, 1e-6)
    rows, columns, entries = [], [], []
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        dot = np.einsum("fd,fd->f", corners[:, i] - corners[:, k], corners[:, j] - corners[:, k])
        half = dot / (4 * area)
        rows += [faces[:, i], faces[:, j], faces[:, i], faces[:, j]]
        columns += [faces[:, j], faces[:, i], faces[:, i], faces[:, j]]
        entries += [-half, -half, half, half]
    triplets = (np.concatenate(entries), (np.concatenate(rows), np.concatenate(columns)))
    mass = np.bincount(faces.ravel(), np.repeat(area / 3, 3), count)
    return sparse.coo_array(triplets, shape=(count, count)).tocsr(), np.maximum(mass, 0.05 * mass.mean())
