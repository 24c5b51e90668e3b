"""The first phase: a short Allen-Cahn flow from the equidistant surface.

The paper's problem, least area between two skeletons, has thin tubes as its literal optimum. So the flow stops early:
u_t = Δu - W'(u)/ε², W = (1 - u²)²/4, moves the interface by its mean curvature for a time that scales with the gap
between the skeletons. Skeleton tubes are kept pointwise, level sets meet the wall at 90°, and the topology of the start
is kept voxel by voxel.

References
----------
Merriman, Bence, Osher 1992, "Diffusion generated motion by mean curvature"; for kept tubes, arXiv 2512.16668.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from dualms.errors import FieldDiverged
from dualms.field import topology
from dualms.field.heat import WallHeat
from dualms.field.interface import profile
from dualms.field.lattice import Floats, Lattice, Mask, colour

WHOLE_TIME = 0.038
"""Time of the whole flow in squared gaps: rms H is least there (ours; 0.02 to 0.06 differ little)."""
INTERFACE_VOXELS = 1.5
INTERFACE_OVER_GAP = 0.1
_TUBE_OVER_GAP = 0.08
_PIN = np.float32(0.02)


def diffuse(
    lattice: Lattice,
    away: tuple[Floats, Floats],
    gap: float,
    share: float,
    each: Callable[[int, int, float, int], None],
    sealed: bool = False,
) -> tuple[Floats, Mask, float]:
    """Start at the equidistant surface and diffuse it.

    Parameters
    ----------
    lattice
        The problem.
    away
        Distances to the hot and to the cold skeleton.
    gap
        Typical distance between the skeletons, unit-cube units.
    share
        Of the whole time, 0 to 1.
    each
        Called with step, number of steps, area by the Allen-Cahn energy, and number of voxels that had to keep their
        colour.
    sealed
        Whether the start's topology is kept at the wall, too.

    Returns
    -------
    u
        (nx, ny, nz) profile.
    hot
        Its colouring, of the start's topology.
    eps
        ε of the profile.

    Raises
    ------
    EmptySurface
        If a skeleton owns no voxel.
    FieldDiverged
        If a value is not finite.
    """
    to_hot, to_cold = away
    spacing = lattice.grid.spacing
    eps = max(INTERFACE_VOXELS * spacing, INTERFACE_OVER_GAP * gap)
    u = profile((to_cold - to_hot) / 2, eps)
    hot = lattice.colouring(u)
    colour(u, hot)
    low, high = _bounds(to_hot, to_cold, _TUBE_OVER_GAP * gap, eps)
    total = WHOLE_TIME * share * gap**2
    steps = math.ceil(total / min(0.2 * eps**2, 0.5 * spacing**2))
    fraction = lattice.fraction
    each(0, steps, area(u, fraction, eps, spacing), 0)
    if steps == 0:
        return u, hot, eps
    heat = WallHeat(fraction, total / steps / spacing**2, lattice.periodic)
    decay = np.float32(math.exp(-2 * total / steps / eps**2))
    for step in range(1, steps + 1):
        u = heat(u)
        # The reaction's exact flow; the heat step before it is exact too (Strang splitting would change the ends only).
        u /= np.sqrt(u * u + (1 - u * u) * decay)
        np.clip(u, low, high, out=u)
        kept = topology.follow(hot, u, lattice.inside, lattice.periodic, sealed)
        at = tuple(kept.T)
        u[at] = np.where(hot[at], _PIN, -_PIN)
        figure = area(u, fraction, eps, spacing)
        if not math.isfinite(figure):
            raise FieldDiverged(f"The phase field is not finite after step {step} of {steps}.")
        each(step, steps, figure, len(kept))
    return u, hot, eps


def area(u: Floats, fraction: Floats, eps: float, spacing: float) -> float:
    """Allen-Cahn energy ∫ ε|∇u|²/2 + W(u)/ε over that of a resting interface of unit area, 2√2/3."""
    density = (1 - u * u) ** 2 / np.float32(4 * eps)
    for axis in range(3):
        step = np.diff(u, axis=axis, append=np.take(u, [-1], axis=axis))
        density += np.float32(eps / 2 / spacing**2) * step * step
    return float((density * fraction).sum(dtype=float)) * spacing**3 / (2 * math.sqrt(2) / 3)


def _bounds(to_hot: Floats, to_cold: Floats, radius: float, eps: float) -> tuple[Floats, Floats]:
    """Pointwise bounds on u that keep a tube round each skeleton; between clashing tubes both give way."""
    half_gap = np.abs(to_cold - to_hot) / 2
    low = profile(np.minimum(radius - to_hot, half_gap), eps)
    high = profile(np.maximum(to_cold - radius, -half_gap), eps)
    clash = low > high
    low[clash] = high[clash] = (low[clash] + high[clash]) / 2
    return low, high
