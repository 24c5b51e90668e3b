"""Descent on the diffuse Willmore energy by a preconditioned quasi-Newton method.

References
----------
Nocedal 1980, "Updating quasi-Newton matrices with limited storage".
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from dualms.field.willmore import Floats, Willmore

Indices = NDArray[np.int64]

MEMORY = 8
_ARMIJO = 1e-4
_SHORTEST = 1e-3
_FIRST_MOVE = 0.2
"""Largest change of u in the first step."""
_RESCALE_EVERY = 5
_RELEASE_EVERY = 25
"""Steps after which values that were held may move again."""


def descend(
    problem: Willmore,
    u: Floats,
    iterations: int,
    project: Callable[[Floats], Indices],
    each: Callable[[int, float], None],
) -> tuple[Floats, str]:
    """Lower the energy by limited-memory BFGS, preconditioned.

    Parameters
    ----------
    problem
        The energy.
    u
        (nx, ny, nz) start.
    iterations
        At most so many steps.
    project
        Brings a field back to what is allowed, in place, and gives the flat indices of what it changed; these values
        are held for a while.
    each
        Called after every step with its number and energy.

    Returns
    -------
    Floats
        The last field.
    str
        Why it ended: ``"iterations"``, or ``"no step"`` where no step lowers the energy.
    """
    precondition = problem.preconditioner()
    energy, g = problem.energy(u)
    steps: list[tuple[Floats, Floats, float]] = []
    scale, volume = 1.0, problem.spacing**3
    held = np.zeros(0, dtype=np.int64)
    for n in range(1, iterations + 1):
        if n % _RELEASE_EVERY == 0:
            held = held[:0]
        g.ravel()[held] = 0
        direction = _direction(g, steps, scale, precondition)
        direction.ravel()[held] = 0
        slope = _dot(g, direction)
        if slope >= 0:
            steps.clear()
            direction = -precondition(g)
            direction.ravel()[held] = 0
            slope = _dot(g, direction)
        length = 1.0 if steps else min(1.0, _FIRST_MOVE / max(float(np.abs(direction).max()), 1e-30))
        while True:
            trial = u + np.float32(length) * direction
            new_energy, new_g = problem.energy(trial)
            if new_energy <= energy + _ARMIJO * length * slope * volume:
                break
            length /= 2
            if length < _SHORTEST:
                return u, "no step"
        changed = project(trial)
        if len(changed):
            new_energy, new_g = problem.energy(trial)
            held = np.union1d(held, changed)
        new_g.ravel()[held] = 0
        s, y = trial - u, new_g - g
        product = _dot(s, y)
        if product > 0:
            steps.append((s, y, 1 / product))
            del steps[:-MEMORY]
            if n % _RESCALE_EVERY == 1:
                scale = product / max(_dot(y, precondition(y)), 1e-30)
        u, g, energy = trial, new_g, new_energy
        each(n, energy)
    return u, "iterations"


def _direction(
    g: Floats, steps: list[tuple[Floats, Floats, float]], scale: float, precondition: Callable[[Floats], Floats]
) -> Floats:
    """The two-loop recursion."""
    q = g.copy()
    alphas = []
    for s, y, rho in reversed(steps):
        alpha = rho * _dot(s, q)
        q -= np.float32(alpha) * y
        alphas.append(alpha)
    q = precondition(q)
    q *= np.float32(scale)
    for (s, y, rho), alpha in zip(steps, reversed(alphas), strict=True):
        q += np.float32(alpha - rho * _dot(y, q)) * s
    return -q


def _dot(a: Floats, b: Floats) -> float:
    return float(np.dot(a.ravel(), b.ravel()))
