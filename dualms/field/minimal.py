"""The second and third phase: from the diffused surface towards H = 0, with the topology kept.

First the diffuse Willmore energy is lowered on the voxels of the domain, with no flux through their outer faces; then
Newton's method (:mod:`dualms.field.newton`) takes the surface on with a free contact at the wall. The first keeps a
tube round each skeleton: necks thinner than the interface cost it nothing, and it would draw them shut.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from dualms.domain import Domain
from dualms.errors import FieldDiverged
from dualms.field import topology
from dualms.field.descent import descend
from dualms.field.interface import continued, distance_of, profile
from dualms.field.lattice import Floats, Lattice, colour
from dualms.field.newton import BEYOND_VOXELS, Slab, straighten
from dualms.field.samples import GridSamples
from dualms.field.torus import Torus
from dualms.field.willmore import Willmore
from dualms.grid import Grid

INTERFACE_VOXELS = 1.2
COARSEST_OVER_GAP = 0.115
"""Coarsest voxel over the gap: above, the interfaces of neighbouring channels feel each other."""
VOXELS_A_GAP = 24
"""Beyond, a finer grid gains nothing: splines refine the result as well."""
VERTICES = 40_000
"""Vertices of the surface's mesh up to which a finer grid is used; beyond, only where the gap asks for it."""
FINEST = 512
DESCENT_ITERATIONS = 200
NEWTON_STEPS = 12
_TUBE_OVER_GAP = 0.22
_TUBE_SHARE = 0.6
"""Of half the way to the other skeleton: tubes are not thicker than that."""
_SURE = np.float32(0.9)
"""Profile beyond which a tube asks for nothing."""
_TOLERANCE = 0.1
_PIN = np.float32(0.005)

Listener = Callable[[int, int, float, int], None]


def level(resolution: int, gap: float, volume: float) -> int:
    """The grid's resolution: what is asked for, as far as it resolves the gap and pays, and the mesh stays small."""
    affordable = math.sqrt(VERTICES * gap / (2 * volume))
    coarsest = 1 / (COARSEST_OVER_GAP * gap)
    return math.ceil(min(FINEST, max(coarsest, min(resolution, affordable, VOXELS_A_GAP / gap))))


def lower_energy(
    lattice: Lattice, samples: GridSamples, away: tuple[Floats, Floats], gap: float, steps: int, each: Listener
) -> GridSamples:
    """Lower the diffuse Willmore energy on one grid.

    Parameters
    ----------
    lattice
        The grid.
    samples
        A distance-like field to start from, on any grid.
    away
        Distances to the hot and to the cold skeleton, on the lattice's grid.
    gap
        Typical distance between the skeletons, unit-cube units.
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
    low, high = _tubes(away, gap, eps)
    kept = np.zeros((0, 3), dtype=np.int64)

    def project(values: Floats) -> NDArray[np.int64]:
        nonlocal kept
        short = np.flatnonzero(mask & ((values < low) | (values > high)))
        np.clip(values, low, high, out=values, where=mask)
        kept = topology.follow(hot, values, mask, sealed=True)
        at = tuple(kept.T)
        values[at] = np.where(hot[at], _PIN, -_PIN)
        return np.union1d(short, np.ravel_multi_index(at, grid.shape))

    def look(step: int, energy: float) -> None:
        if not math.isfinite(energy):
            raise FieldDiverged(f"The Willmore energy is not finite at iteration {step} of {steps}.")
        each(step, steps, energy, len(kept))

    u, _ = descend(Willmore(mask, eps, grid.spacing), u, steps, project, look)
    return continued(distance_of(u, eps), mask, grid)


def straightened(
    domain: Domain | Torus, lattice: Lattice, samples: GridSamples, gap: float, steps: int, each: Listener
) -> GridSamples:
    """Take a surface on to H = 0 by Newton's method.

    Parameters
    ----------
    domain, lattice
        The problem, and the grid to work on.
    samples
        A distance-like field to start from, on any grid.
    gap
        Typical distance between the skeletons, unit-cube units.
    steps
        At most so many.
    each
        Called with step, their number, ∫(2H)², and number of voxels that had to keep their colour.
    """
    spacing = lattice.grid.spacing
    if isinstance(domain, Torus):
        grid, inside = lattice.grid, lattice.inside
        depth = np.full(grid.shape, np.float32(2 * BEYOND_VOXELS))
    else:
        width = BEYOND_VOXELS + 1
        nx, ny, nz = lattice.grid.shape
        grid = Grid(lattice.grid.origin - width * spacing, spacing, (nx + 2 * width, ny + 2 * width, nz + 2 * width))
        inside = np.pad(lattice.inside, width)
        depth = domain.depth(grid, (BEYOND_VOXELS + 2) * spacing) / np.float32(spacing)
    slab = Slab(inside, depth, gap / spacing, lattice.periodic)
    start = samples.on(grid) / np.float32(spacing)
    values = straighten(start, slab, steps, _TOLERANCE, lambda step, energy, kept: each(step, steps, energy, kept))
    return continued(values * np.float32(spacing), depth > -BEYOND_VOXELS, grid, lattice.periodic)


def _tubes(away: tuple[Floats, Floats], gap: float, eps: float) -> tuple[Floats, Floats]:
    """Bounds (nx, ny, nz) on the profile that keep a tube round each skeleton."""
    to_hot, to_cold = away
    radius, share = _TUBE_OVER_GAP * gap, _TUBE_SHARE * np.abs(to_cold - to_hot) / 2
    low = np.minimum(profile(np.minimum(radius - to_hot, share), eps), _SURE)
    high = np.maximum(profile(np.maximum(to_cold - radius, -share), eps), -_SURE)
    low[(to_hot > radius) | (to_cold < to_hot)] = -np.inf
    high[(to_cold > radius) | (to_hot < to_cold)] = np.inf
    return low, high
