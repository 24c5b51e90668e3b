"""The second phase: from the diffused surface towards H = 0, coarse to fine, with the topology kept.

On each grid the diffuse Willmore energy is lowered on the voxels of the domain, with no flux through their outer faces.
Measured (authors' U-shape, 300 sites, 108 voxels, 200 iterations): an energy taken one voxel beyond the wall, which
leaves the contact free, ends at a median |H| of 1.6 where this one ends at 1.26, and runs into the topology's guard.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from dualms.errors import FieldDiverged
from dualms.field import topology
from dualms.field.descent import descend
from dualms.field.interface import continued, distance_of, profile
from dualms.field.lattice import Floats, Lattice, colour
from dualms.field.samples import GridSamples
from dualms.field.willmore import Willmore

INTERFACE_VOXELS = 1.2
COARSEST_OVER_GAP = 0.135
"""Coarsest voxel over the gap: above, the interfaces of neighbouring channels feel each other."""
REFINEMENT = 4 / 3
LEAST_RESOLUTION = 32
FINEST = 512
COARSEST_ITERATIONS = 300
_PIN = np.float32(0.005)


def levels(resolution: int, gap: float) -> list[int]:
    """Resolutions, coarse to fine: from the coarsest that resolves the gap to ``resolution``, or to it alone."""
    coarsest = 1 / (COARSEST_OVER_GAP * gap)
    found = [max(resolution, min(math.ceil(coarsest), FINEST))]
    while found[0] / REFINEMENT >= max(LEAST_RESOLUTION, coarsest):
        found.insert(0, round(found[0] / REFINEMENT))
    return found


def iterations(count: int, share: float) -> list[int]:
    """Iterations on each of ``count`` levels: half as many on each finer one."""
    return [round(share * COARSEST_ITERATIONS / 2**k) for k in range(count)]


def minimise(
    lattice: Lattice, samples: GridSamples, steps: int, each: Callable[[int, int, float, int], None]
) -> GridSamples:
    """Lower the Willmore energy on one grid.

    Parameters
    ----------
    lattice
        The grid.
    samples
        A distance-like field to start from, on any grid.
    steps
        Iterations.
    each
        Called with iteration, their number, energy, and number of voxels that had to keep their colour.

    Returns
    -------
    GridSamples
        The new distance-like field.

    Raises
    ------
    FieldDiverged
        If the energy is not finite.
    """
    grid = lattice.grid
    eps = INTERFACE_VOXELS * grid.spacing
    u = profile(samples.on(grid), eps)
    hot = lattice.colouring(u)
    colour(u, hot)
    mask = lattice.inside
    kept = np.zeros((0, 3), dtype=np.int64)

    def project(values: Floats) -> NDArray[np.int64]:
        nonlocal kept
        kept = topology.follow(hot, values, lattice.inside)
        at = tuple(kept.T)
        values[at] = np.where(hot[at], _PIN, -_PIN)
        return np.ravel_multi_index(at, grid.shape)

    def look(step: int, energy: float) -> None:
        if not math.isfinite(energy):
            raise FieldDiverged(f"The Willmore energy is not finite at iteration {step} of {steps}.")
        each(step, steps, energy, len(kept))

    u, _ = descend(Willmore(mask, eps, grid.spacing), u, steps, project, look)
    return continued(distance_of(u, eps), mask, grid)
