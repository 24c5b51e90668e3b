"""A field given by samples on a grid, with cubic splines between them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline

from dualms.grid import Grid


@dataclass(frozen=True)
class GridSamples:
    """Samples on a grid.

    Parameters
    ----------
    grid
        At least four voxels along each axis.
    values
        (nx, ny, nz) float32, finite.
    """

    grid: Grid
    values: NDArray[np.float32]

    def __post_init__(self) -> None:
        if self.values.shape != self.grid.shape or min(self.grid.shape) < 4:
            raise ValueError(
                f"values {self.values.shape} must match the grid {self.grid.shape}, 4 voxels or more a side"
            )
        if self.values.dtype != np.float32 or not np.isfinite(self.values).all():
            raise ValueError("samples must be finite float32")

    def on(self, grid: Grid) -> NDArray[np.float32]:
        """Values at the voxel centres of another grid: a tensor-product cubic spline, constant beyond the samples.

        Notes
        -----
        One small dense matrix an axis, so the cost is three matrix products (0.3 s for 256³).
        """
        values = self.values
        for axis in range(3):
            matrix = spline_matrix(self.grid.axes()[axis], grid.axes()[axis])
            values = np.moveaxis(np.tensordot(matrix, values, axes=(1, axis)), 0, axis)
        return np.ascontiguousarray(values, dtype=np.float32)

    def tensors(self) -> dict[str, NDArray[np.generic]]:
        """The tensors of the file."""
        return {
            "values": np.ascontiguousarray(self.values),
            "origin": np.ascontiguousarray(self.grid.origin),
            "spacing": np.array([self.grid.spacing]),
        }

    @classmethod
    def from_tensors(cls, tensors: dict[str, NDArray[np.generic]]) -> GridSamples:
        """The inverse of :meth:`tensors`."""
        values = tensors["values"].astype(np.float32)
        nx, ny, nz = values.shape
        return cls(Grid(tensors["origin"].astype(float), float(tensors["spacing"].item()), (nx, ny, nz)), values)


def spline_matrix(knots: NDArray[np.float64], x: NDArray[np.float64]) -> NDArray[np.float32]:
    """(len(x), len(knots)) matrix that maps samples at ``knots`` to the cubic spline's values at ``x``, clamped."""
    spline = make_interp_spline(knots, np.eye(len(knots)), k=3)
    return np.asarray(spline(np.clip(x, knots[0], knots[-1])), dtype=np.float32)
