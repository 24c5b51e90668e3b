"""The diffuse interface: from distances to profiles and back."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from dualms.field.heat import extend
from dualms.field.samples import GridSamples
from dualms.grid import Grid

Floats = NDArray[np.float32]

MARGIN = 0.07
"""How far beyond the domain a field is defined, unit-cube units."""
_SATURATION = np.float32(0.999)


def profile(distance: NDArray[np.floating], eps: float) -> Floats:
    """The resting profile tanh(d / √2ε) of the Allen-Cahn energy."""
    return np.asarray(np.tanh(distance / (math.sqrt(2) * eps)), dtype=np.float32)


def distance_of(u: Floats, eps: float) -> Floats:
    """The inverse of :func:`profile`, bounded at 5.4 ε."""
    return np.asarray(np.arctanh(np.clip(u, -_SATURATION, _SATURATION)) * np.float32(math.sqrt(2) * eps))


def continued(distance: Floats, known: NDArray[np.bool_], grid: Grid, periodic: bool = False) -> GridSamples:
    """Samples of a field on a wider grid, continued smoothly from the voxels where it is known, or periodically."""
    width = math.ceil(MARGIN / grid.spacing)
    if periodic:
        values = np.pad(distance, width, mode="wrap")
    else:
        values = extend(np.pad(distance, width, mode="edge"), np.pad(known, width))
    nx, ny, nz = values.shape
    return GridSamples(Grid(grid.origin - width * grid.spacing, grid.spacing, (nx, ny, nz)), values)
