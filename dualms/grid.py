"""A regular grid of cubic voxels in the unit-cube frame, and sampling on it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Grid:
    """Cubic voxels; ``origin`` is the centre of the first.

    Parameters
    ----------
    origin
        (3,) float64, centre of voxel (0, 0, 0), unit-cube frame.
    spacing
        Edge of a voxel, unit-cube frame.
    shape
        Voxels along x, y, z.
    """

    origin: Array
    spacing: float
    shape: tuple[int, int, int]

    def __post_init__(self) -> None:
        object.__setattr__(self, "shape", tuple(int(n) for n in self.shape))
        if self.origin.shape != (3,) or not np.isfinite(self.origin).all():
            raise ValueError("a grid's origin must be three finite numbers")
        if self.spacing <= 0 or len(self.shape) != 3 or min(self.shape) < 1:
            raise ValueError("a grid needs a positive spacing and three positive counts")

    @classmethod
    def around(cls, low: Array, high: Array, resolution: int, padding: int = 3) -> Grid:
        """Grid of spacing 1/resolution whose voxels cover a box, symmetric about its middle.

        Parameters
        ----------
        low, high
            (3,) corners of the box, unit-cube frame.
        resolution
            Voxels along one unit.
        padding
            Voxels added on each side.
        """
        spacing = 1.0 / resolution
        count = np.maximum(np.ceil((high - low) * resolution - 1e-9).astype(int), 1) + 2 * padding
        origin = (low + high) / 2 - (count - 1) / 2 * spacing
        return cls(np.asarray(origin, dtype=float), spacing, (int(count[0]), int(count[1]), int(count[2])))

    @property
    def size(self) -> int:
        """Number of voxels."""
        return int(np.prod(self.shape))

    def padded(self, count: int) -> Grid:
        """The grid with so many voxels more on every side."""
        nx, ny, nz = self.shape
        more = 2 * count
        return Grid(self.origin - count * self.spacing, self.spacing, (nx + more, ny + more, nz + more))

    def axes(self) -> tuple[Array, Array, Array]:
        """Coordinates of the voxel centres along x, y and z."""
        x, y, z = (self.origin[k] + self.spacing * np.arange(self.shape[k]) for k in range(3))
        return x, y, z

    def points(self, mask: NDArray[np.bool_] | None = None) -> Array:
        """(P, 3) voxel centres, all of them in C order or those where ``mask`` (of the grid's shape) holds."""
        if mask is None:
            return np.stack(np.meshgrid(*self.axes(), indexing="ij"), axis=-1).reshape(-1, 3)
        return np.asarray(self.origin + self.spacing * np.argwhere(mask), dtype=float)

    def nearest(self, points: Array) -> NDArray[np.int64]:
        """(P, 3) indices of the voxels that hold ``points`` (P, 3), clipped to the grid."""
        index = np.rint((points - self.origin) / self.spacing).astype(np.int64)
        return np.clip(index, 0, np.array(self.shape) - 1)

    def sample(self, values: NDArray[np.floating], points: Array, order: int = 1) -> Array:
        """Values at ``points`` (P, 3) by interpolation of ``values`` (of the grid's shape); constant beyond it."""
        coordinates = ((points - self.origin) / self.spacing).T
        return np.asarray(ndimage.map_coordinates(values, coordinates, order=order, mode="nearest"), dtype=float)


def thinned(points: Array, size: float) -> Array:
    """The first of ``points`` (P, 3) in each cube of edge ``size``, in their order."""
    cells = np.floor(points / size).astype(np.int64)
    cells -= cells.min(axis=0, initial=0)
    keys = np.ravel_multi_index(tuple(cells.T), tuple(cells.max(axis=0, initial=0) + 1))
    return np.asarray(points[np.sort(np.unique(keys, return_index=True)[1])])
