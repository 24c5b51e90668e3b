"""What a partition must keep, and the state that answers "may this site change sides?" in a few steps (paper, Eq. 2).

Both sides connected, at least two neighbours on its own side for every site, pinned sites on their side, and at each
shared opening a least number of sites of either side.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from dualms.graph.graph import Graph

LEAST_DEGREE = 2  # paper: every vertex keeps a degree greater than 1 in its own subgraph, so no channel ends dead
OPENING_SHARE = 0.25  # of an opening's sites either fluid keeps; ours: one cell of an end face would choke a fluid

Labels = NDArray[np.int8]


class Problem(NamedTuple):
    """A graph in compressed rows, with its constraints.

    Parameters
    ----------
    start, neighbour, weight
        Row pointers (N + 1,), neighbours (2E,) and weights (2E,).
    pinned
        (N,) bool, sites that must not change sides.
    member_start, member
        For each site the openings that it belongs to, in compressed rows.
    least
        (O,) sites of either side that an opening must keep.
    least_size
        (2,) sites that the cold and the hot side must keep.
    """

    start: NDArray[np.int64]
    neighbour: NDArray[np.int32]
    weight: NDArray[np.float64]
    pinned: NDArray[np.bool_]
    member_start: NDArray[np.int64]
    member: NDArray[np.int32]
    least: NDArray[np.int64]
    least_size: NDArray[np.int64]


class State(NamedTuple):
    """A partition with what is kept up to date at every change of side.

    Parameters
    ----------
    labels
        (N,) int8, 1 or -1.
    same
        (N,) neighbours on the own side.
    gain
        (N,) change of the cut weight if the site changes sides.
    held
        (O, 2) sites of the cold and hot side at each opening.
    size
        (2,) sites of the cold and hot side.
    mark, owner, queue, stamp
        Scratch of the connectivity test.
    """

    labels: Labels
    same: NDArray[np.int32]
    gain: NDArray[np.float64]
    held: NDArray[np.int64]
    size: NDArray[np.int64]
    mark: NDArray[np.int64]
    owner: NDArray[np.int32]
    queue: NDArray[np.int32]
    stamp: NDArray[np.int64]


def problem_of(graph: Graph, least_size: tuple[int, int] = (3, 3)) -> Problem:
    """The graph in compressed rows, with its constraints; ``least_size`` counts sites (cold, hot)."""
    count = len(graph.sites)
    ends = np.concatenate([graph.edges[:, 0], graph.edges[:, 1]])
    others = np.concatenate([graph.edges[:, 1], graph.edges[:, 0]])
    order = np.lexsort((others, ends))
    start = np.concatenate([[0], np.cumsum(np.bincount(ends, minlength=count))]).astype(np.int64)
    sites = np.concatenate([np.zeros(0, dtype=np.int64), *graph.openings])
    opening = np.repeat(np.arange(len(graph.openings)), [len(o) for o in graph.openings])
    by_site = np.argsort(sites, kind="stable")
    member_start = np.concatenate([[0], np.cumsum(np.bincount(sites, minlength=count))]).astype(np.int64)
    least = [
        max(1, int(OPENING_SHARE * len(o)) if not graph.pins[o].any() else 1) for o in graph.openings
    ]  # next to a pinned port an opening may have little choice
    return Problem(
        start,
        others[order].astype(np.int32),
        np.concatenate([graph.weights, graph.weights])[order],
        graph.pins != 0,
        member_start,
        opening[by_site].astype(np.int32),
        np.array(least, dtype=np.int64),
        np.array(least_size, dtype=np.int64),
    )


def cut_weight(graph: Graph, labels: Labels) -> float:
    """Sum of the weights of the edges between the two sides (paper, Eq. 3)."""
    return float(graph.weights[labels[graph.edges[:, 0]] != labels[graph.edges[:, 1]]].sum())


def violations(graph: Graph, labels: Labels) -> tuple[str, ...]:
    """What a partition breaks, in words; empty if it keeps every constraint. Independent of the search's own state."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    count = len(graph.sites)
    found = []
    same = graph.edges[labels[graph.edges[:, 0]] == labels[graph.edges[:, 1]]]
    _, part = connected_components(
        coo_array((np.ones(len(same)), (same[:, 0], same[:, 1])), shape=(count, count)), directed=False
    )
    for side, name in ((1, "hot"), (-1, "cold")):
        parts = len(np.unique(part[labels == side]))
        if parts != 1:
            found.append(f"the {name} side has {parts} connected parts")
    degree = np.bincount(same.ravel(), minlength=count)
    found += [f"site {v} has {degree[v]} neighbours on its side" for v in np.flatnonzero(degree < LEAST_DEGREE)]
    found += [f"site {v} is pinned" for v in np.flatnonzero((graph.pins != 0) & (labels != graph.pins))]
    for k, sites in enumerate(graph.openings):
        found += [f"opening {k} has no site of side {side}" for side in (1, -1) if not (labels[sites] == side).any()]
    return tuple(found)


@numba.njit(cache=True)
def new_state(problem, labels):  # type: ignore[no-untyped-def]
    """State of a partition, computed from scratch."""
    count = labels.size
    same = np.zeros(count, np.int32)
    gain = np.zeros(count)
    held = np.zeros((problem.least.size, 2), np.int64)
    size = np.zeros(2, np.int64)
    for v in range(count):
        side = (labels[v] + 1) // 2
        size[side] += 1
        for k in range(problem.start[v], problem.start[v + 1]):
            if labels[problem.neighbour[k]] == labels[v]:
                same[v] += 1
                gain[v] += problem.weight[k]
            else:
                gain[v] -= problem.weight[k]
        for k in range(problem.member_start[v], problem.member_start[v + 1]):
            held[problem.member[k], side] += 1
    return State(
        labels.copy(),
        same,
        gain,
        held,
        size,
        np.zeros(count, np.int64),
        np.zeros(count, np.int32),
        np.zeros(count, np.int32),
        np.zeros(1, np.int64),
    )


@numba.njit(cache=True)
def flip(problem, state, v):  # type: ignore[no-untyped-def]
    """Move site ``v`` to the other side."""
    labels = state.labels
    old = labels[v]
    labels[v] = -old
    state.gain[v] = -state.gain[v]
    state.same[v] = problem.start[v + 1] - problem.start[v] - state.same[v]
    for k in range(problem.start[v], problem.start[v + 1]):
        u = problem.neighbour[k]
        if labels[u] == old:
            state.same[u] -= 1
            state.gain[u] -= 2.0 * problem.weight[k]
        else:
            state.same[u] += 1
            state.gain[u] += 2.0 * problem.weight[k]
    side = (old + 1) // 2
    state.size[side] -= 1
    state.size[1 - side] += 1
    for k in range(problem.member_start[v], problem.member_start[v + 1]):
        state.held[problem.member[k], side] -= 1
        state.held[problem.member[k], 1 - side] += 1


@numba.njit(cache=True)
def may_leave(problem, state, v):  # type: ignore[no-untyped-def]
    """Whether pins, sizes, openings and the neighbours' degrees let ``v`` change sides (not: connectivity)."""
    if problem.pinned[v]:
        return False
    if problem.start[v + 1] - problem.start[v] - state.same[v] < LEAST_DEGREE:
        return False
    label = state.labels[v]
    side = (label + 1) // 2
    if state.size[side] <= problem.least_size[side]:
        return False
    for k in range(problem.member_start[v], problem.member_start[v + 1]):
        if state.held[problem.member[k], side] <= problem.least[problem.member[k]]:
            return False
    for k in range(problem.start[v], problem.start[v + 1]):
        u = problem.neighbour[k]
        if state.labels[u] == label and state.same[u] <= LEAST_DEGREE:
            return False
    return True


@numba.njit(cache=True)
def stays_connected(problem, state, v):  # type: ignore[no-untyped-def]
    """Whether the side of ``v`` stays connected without it, and the sites looked at.

    One search from each neighbour at once; it ends when all searches have met, or when one has nowhere to go.
    """
    labels, mark, owner, queue = state.labels, state.mark, state.owner, state.queue
    label = labels[v]
    state.stamp[0] += 1
    stamp = state.stamp[0]
    mark[v] = stamp
    owner[v] = -1
    classes = 0
    parent = np.empty(64, np.int32)
    open_sites = np.empty(64, np.int32)
    tail = 0
    for k in range(problem.start[v], problem.start[v + 1]):
        u = problem.neighbour[k]
        if labels[u] == label and classes < 64:
            mark[u] = stamp
            owner[u] = classes
            parent[classes] = classes
            open_sites[classes] = 1
            queue[tail] = u
            tail += 1
            classes += 1
    if classes <= 1:
        return True, classes
    left = classes
    head = 0
    while head < tail:
        u = queue[head]
        head += 1
        own = owner[u]
        while parent[own] != own:
            own = parent[own]
        for k in range(problem.start[u], problem.start[u + 1]):
            w = problem.neighbour[k]
            if labels[w] != label:
                continue
            if mark[w] != stamp:
                mark[w] = stamp
                owner[w] = own
                queue[tail] = w
                tail += 1
                open_sites[own] += 1
            elif w != v:
                other = owner[w]
                while parent[other] != other:
                    other = parent[other]
                if other != own:
                    parent[other] = own
                    open_sites[own] += open_sites[other]
                    left -= 1
                    if left == 1:
                        return True, tail
        open_sites[own] -= 1
        if open_sites[own] == 0:
            return False, tail
    return False, tail
