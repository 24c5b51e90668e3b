"""Simulated annealing over single changes of side under the paper's constraints (ours; Kirkpatrick et al. 1983).

Every state on the way keeps all constraints, so the best one seen is a result at any time.
"""

from __future__ import annotations

import numba
import numpy as np

from dualms.cut.constraints import Labels, Problem, flip, may_leave, new_state, stays_connected
from dualms.grid import Array

# First and last temperature over the mean edge weight: the best of a scan of 9 pairs on U-bend graphs of 300 and 800
# sites, a = 1 and 5, budgets of 0.02 to 2 s.
HOT = 0.6
COLD = 0.15


def anneal(problem: Problem, labels: Labels, proposals: int, seed: int, stretch: int = 400) -> tuple[Labels, Array]:
    """Search for a heavier cut.

    Parameters
    ----------
    problem
        Graph and constraints.
    labels
        (N,) a partition that keeps the constraints.
    proposals
        Number of proposed changes; the work, not the clock, is what ends the search.
    seed
        Seed of the proposals.
    stretch
        Points of the returned history.

    Returns
    -------
    labels
        (N,) int8, the best partition seen.
    history
        (K, 2) float64, proposals done and best gain over the start.
    """
    state = new_state(problem, labels)
    mean = float(problem.weight.mean())
    every = max(1, proposals // stretch)
    best, history = _anneal(problem, state, proposals, HOT * mean, COLD * mean, np.uint64(2 * seed + 1), every)
    return np.asarray(best), np.asarray(history)


@numba.njit(cache=True, nogil=True)
def _anneal(problem, state, proposals, hot, cold, seed, every):  # type: ignore[no-untyped-def]
    count = state.labels.size
    best = state.labels.copy()
    current, record = 0.0, 0.0
    since = np.empty(4 * count, np.int32)  # changes since the best state, so that keeping it costs nothing
    changes = 0
    lost = False
    history = np.empty((proposals // every + 2, 2))
    rows = 0
    random = seed * np.uint64(0x9E3779B97F4A7C15)
    cooling = (cold / hot) ** (1.0 / max(1, proposals // 1024))
    temperature = hot
    for step in range(proposals):
        if step % 1024 == 0:
            temperature = hot * cooling ** (step // 1024)
        if step % every == 0:
            history[rows, 0], history[rows, 1] = step, record
            rows += 1
        random ^= random << np.uint64(13)
        random ^= random >> np.uint64(7)
        random ^= random << np.uint64(17)
        v = np.int64(((random >> np.uint64(32)) * np.uint64(count)) >> np.uint64(32))
        gain = state.gain[v]
        if gain < 0.0:
            chance = np.float64(random & np.uint64(0xFFFFFF)) / 16777216.0
            if chance >= np.exp(gain / temperature):
                continue
        if not may_leave(problem, state, v):
            continue
        connected, _seen = stays_connected(problem, state, v)
        if not connected:
            continue
        flip(problem, state, v)
        current += gain
        if current > record + 1e-9:
            record = current
            if lost:
                best[:] = state.labels
            else:
                for k in range(changes):
                    best[since[k]] = -best[since[k]]
                best[v] = -best[v]
            changes = 0
            lost = False
        elif changes < since.size:
            since[changes] = v
            changes += 1
        else:
            lost = True
    history[rows, 0], history[rows, 1] = proposals, record
    return best, history[: rows + 1]
