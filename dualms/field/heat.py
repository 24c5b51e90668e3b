"""Diffusion inside a freeform domain with natural contact at its wall.

One step is G∗(uχ) / G∗χ with the heat kernel G and the domain's volume fraction χ: no flux through the wall, so level
sets meet it at 90° (Xu, Wang, Wang 2016, arXiv 1602.04688).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.special import ive

Floats = NDArray[np.float32]


def heat_kernel(time: float, tolerance: float = 1e-5) -> NDArray[np.float64]:
    """Exact kernel of the semi-discrete heat equation on the integers.

    Parameters
    ----------
    time
        Diffusion time in squared spacings.
    tolerance
        Mass that may be cut off.

    Returns
    -------
    (2r + 1,) float64
        Symmetric weights of sum 1: e^-2t I_n(2t) for u_t = u_xx (Lindeberg 1990).
    """
    half = int(np.ceil(4 * np.sqrt(2 * time))) + 6
    weights = ive(np.arange(half + 1), 2 * time)
    tail = weights[0] + 2 * np.cumsum(np.append(0, weights[1:]))
    radius = int(np.searchsorted(tail, 1 - tolerance))
    kernel = np.concatenate([weights[radius:0:-1], weights[: radius + 1]])
    return np.asarray(kernel / kernel.sum())


class WallHeat:
    """Diffusion by one fixed time in one domain.

    Parameters
    ----------
    fraction
        (nx, ny, nz) float32 share of each voxel that lies in the domain.
    time
        Diffusion time in squared spacings.
    periodic
        Whether the box continues across its faces.
    """

    def __init__(self, fraction: Floats, time: float, periodic: bool = False) -> None:
        self._mode = "wrap" if periodic else "constant"
        self._kernel = heat_kernel(time)
        self._fraction = fraction
        mass = self._convolve(fraction)
        self._reached = mass > 1e-6
        self._inverse = np.where(self._reached, 1 / np.maximum(mass, 1e-6), 0).astype(np.float32)

    def __call__(self, u: Floats) -> Floats:
        """The field after one step; voxels that the domain does not reach keep their value."""
        mixed = self._convolve(u * self._fraction)
        mixed *= self._inverse
        return np.where(self._reached, mixed, u)

    def _convolve(self, u: Floats) -> Floats:
        for axis in range(3):
            u = ndimage.correlate1d(u, self._kernel, axis=axis, mode=self._mode)
        return u


def extend(values: Floats, known: NDArray[np.bool_], smoothing: int = 6) -> Floats:
    """Continue values smoothly from where they are known: nearest known value, then diffusion of the rest."""
    nearest = ndimage.distance_transform_edt(~known, return_distances=False, return_indices=True)
    extended = values[tuple(nearest)]
    del nearest
    kernel = heat_kernel(1.0)
    for _ in range(smoothing):
        mixed = extended
        for axis in range(3):
            mixed = ndimage.correlate1d(mixed, kernel, axis=axis, mode="nearest")
        extended = np.where(known, values, mixed)
    return np.asarray(extended, dtype=np.float32)
