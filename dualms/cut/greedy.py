"""The paper's Algorithm 1: the best single change of side, again and again, until the cut weight converges."""

from __future__ import annotations

import numba
import numpy as np

from dualms.cut.constraints import Labels, Problem, flip, may_leave, new_state, stays_connected
from dualms.grid import Array


def greedy(problem: Problem, labels: Labels) -> tuple[Labels, Array]:
    """Algorithm 1 from a feasible partition.

    Every iteration looks at all sites, checks connectivity and degrees after the change, and moves the one that raises
    the cut weight most (the first of equals). It ends when no allowed change raises it, so the last state is the best.

    Parameters
    ----------
    problem
        Graph and constraints.
    labels
        (N,) a partition that keeps the constraints.

    Returns
    -------
    labels
        (N,) int8.
    gains
        (K,) float64, what each iteration added.
    """
    state = new_state(problem, labels)
    gains = _climb(problem, state, 100 * len(labels))
    return np.asarray(state.labels), np.asarray(gains)


@numba.njit(cache=True)
def _climb(problem, state, limit):  # type: ignore[no-untyped-def]
    gains = np.empty(limit)
    for iteration in range(limit):
        best, chosen = 1e-9, -1
        for v in range(state.labels.size):
            # The gain is known without a simulated move; constraints matter only where it would be the best.
            if state.gain[v] > best and may_leave(problem, state, v):
                connected, _seen = stays_connected(problem, state, v)
                if connected:
                    best, chosen = state.gain[v], v
        if chosen < 0:
            return gains[:iteration]
        gains[iteration] = best
        flip(problem, state, chosen)
    return gains
