"""A first feasible partition: a plane split where that works, else two disjoint trees that join each fluid's ports.

Paper, Algorithm 1, lines 3-4 (which leaves open how); dead ends of the first split are then repaired by single changes.
"""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Iterator

import numba
import numpy as np
from numpy.typing import NDArray

from dualms.cut.constraints import (
    LEAST_DEGREE,
    Labels,
    Problem,
    flip,
    new_state,
    stays_connected,
    violations,
)
from dualms.errors import InfeasiblePartition
from dualms.graph.graph import Graph
from dualms.grid import Array

TRIES = 24
REPAIRS_PER_SITE = 400


def first_partition(graph: Graph, problem: Problem, seed: int) -> Labels:
    """A partition that keeps every constraint.

    Parameters
    ----------
    graph, problem
        The graph, and the same in compressed rows.
    seed
        Seed of the trees' random costs and of the repair.

    Raises
    ------
    InfeasiblePartition
        If a site has too few neighbours, a fluid's ports cannot be joined past the other's, or the repair fails.
    """
    degree = np.diff(problem.start)
    if (degree < LEAST_DEGREE).any():
        site = int(degree.argmin())
        raise InfeasiblePartition(
            f"Site {site} ({_place(graph, site)}) has {degree[site]} neighbours; each needs {LEAST_DEGREE} on its own "
            "side.",
            advice="Ask for more sites, or widen the domain there.",
            measured={"site": site, "degree": int(degree[site])},
        )
    reason, site = _separated(graph, problem)
    fewest = len(degree)
    for attempt, labels in enumerate(_candidates(graph, problem, seed)):
        state = new_state(problem, labels)
        left = _repair(problem, state, seed + attempt, REPAIRS_PER_SITE * len(labels))
        broken = violations(graph, state.labels)
        if left == 0 and not broken and (state.size >= problem.least_size).all() and _openings_hold(problem, state):
            return np.asarray(state.labels)
        if len(broken) < fewest:
            fewest, site = len(broken), int(np.argmin(state.same))
            what = "; ".join(broken[:3]) or "a fluid has too few sites"
            reason = f"The best first partition still breaks: {what}. Worst is site {site} ({_place(graph, site)})."
    raise InfeasiblePartition(
        f"{reason} ({len(graph.sites)} sites, {int((graph.pins != 0).sum())} of them pinned to ports.)",
        advice="Ask for more sites, or move ports of different fluids apart.",
        measured={"sites": len(graph.sites), "site": site},
    )


def _place(graph: Graph, site: int) -> str:
    """Where a site is, in words: its coordinates over the domain's longest side, and the port next to it."""
    where = f"at {np.round(graph.sites[site], 3).tolist()} of the longest side"
    if not graph.ports:
        return where
    gaps = [float(np.linalg.norm(graph.sites[own] - graph.sites[site], axis=1).min()) for own in graph.ports]
    return f"{where}, nearest port {_port_name(graph, int(np.argmin(gaps)))}"


def _port_name(graph: Graph, port: int) -> str:
    """Name of a port as everywhere: fluid, role, index among its like."""
    alike = (graph.port_fluids == graph.port_fluids[port]) & (graph.port_inlets == graph.port_inlets[port])
    fluid, role = (
        ("hot" if graph.port_fluids[port] == 1 else "cold"),
        ("inlet" if graph.port_inlets[port] else "outlet"),
    )
    return f"{fluid}-{role}-{int(alike[:port].sum())}"


def _separated(graph: Graph, problem: Problem) -> tuple[str, int]:
    """Why no two disjoint trees were found, and a site that a fluid cannot reach (or -1)."""
    for side, name in ((1, "hot"), (-1, "cold")):
        wanted = np.flatnonzero(graph.pins == side)
        for site in wanted[1:].tolist():
            if _path(problem, {int(wanted[0])}, {site}, np.ones(len(graph.sites)), graph.pins, side) is None:
                first = int(wanted[0])
                ends = f"site {first} ({_place(graph, first)}) to site {site} ({_place(graph, site)})"
                return f"The {name} fluid cannot get from {ends}: the other fluid's ports wall it off.", site
    return "The two fluids' ways between their ports block each other.", -1


def _openings_hold(problem: Problem, state) -> bool:  # type: ignore[no-untyped-def]
    return bool((state.held >= problem.least[:, None]).all())


def _candidates(graph: Graph, problem: Problem, seed: int) -> Iterator[Labels]:
    """Connected splits that keep pins and openings, simplest first."""
    if not (graph.pins != 0).any():
        extents = np.ptp(graph.sites, axis=0)
        for axis in np.argsort(extents, kind="stable"):
            level = np.quantile(graph.sites[:, axis], _cold_share(problem))
            labels = np.where(graph.sites[:, axis] > level, 1, -1).astype(np.int8)
            if _connected(problem, labels):
                yield labels
    generator = np.random.default_rng(seed)
    for attempt in range(TRIES):
        order = (1, -1) if attempt % 2 == 0 else (-1, 1)
        cost = 1.0 + (0.0 if attempt < 2 else 1.0) * generator.random(len(graph.sites))
        terminals = _terminals(graph, problem, generator if attempt >= 2 else None)
        trees = _two_trees(graph, problem, terminals, order, cost)
        if trees is not None:
            yield _grown(problem, trees)


def _connected(problem: Problem, labels: Labels) -> bool:
    """Whether both sides are connected and not empty."""
    for side in (1, -1):
        members = np.flatnonzero(labels == side)
        if len(members) == 0:
            return False
        seen = {int(members[0])}
        stack = [int(members[0])]
        while stack:
            v = stack.pop()
            for u in problem.neighbour[problem.start[v] : problem.start[v + 1]].tolist():
                if labels[u] == side and u not in seen:
                    seen.add(u)
                    stack.append(u)
        if len(seen) != len(members):
            return False
    return True


def _terminals(graph: Graph, problem: Problem, generator: np.random.Generator | None) -> Labels:
    """(N,) sites that each fluid's tree must hold: the pins, and at each opening its least number on either side."""
    terminal = graph.pins.copy()
    for sites, least in zip(graph.openings, problem.least, strict=True):
        free = sites[terminal[sites] == 0]
        spots = graph.sites[free] - graph.sites[free].mean(axis=0)
        axis = np.linalg.svd(spots, full_matrices=False)[2][0] if len(free) > 1 else np.array([1.0, 0, 0])
        if generator is not None:
            axis = axis + generator.normal(size=3)
        along = free[np.argsort(spots @ axis, kind="stable")]
        for side, order in ((1, along), (-1, along[::-1])):
            need = int(least - (terminal[sites] == side).sum())
            if need > 0:
                terminal[order[:need]] = side
    far = np.argsort(graph.sites[:, int(np.ptp(graph.sites, axis=0).argmax())], kind="stable")
    for side, order in ((1, far[::-1]), (-1, far)):
        if not (terminal == side).any():
            terminal[int(next(v for v in order if terminal[v] == 0))] = side
    return terminal


def _two_trees(
    graph: Graph, problem: Problem, terminal: Labels, order: tuple[int, int], cost: Array
) -> NDArray[np.int8] | None:
    """(N,) 1 and -1 on two disjoint trees through the terminals of each fluid, 0 elsewhere; None if none was found."""
    taken = terminal.copy()
    near_other = np.zeros((len(taken), 2))
    for i, j in graph.edges:
        for a, b in ((i, j), (j, i)):
            if terminal[a] != 0:
                near_other[b, int(terminal[a] + 1) // 2] = 4.0
    for side in order:
        wanted = np.flatnonzero(terminal == side)
        tree = {int(wanted[0])}
        price = cost + near_other[:, (1 - side) // 2]
        while missing := [v for v in wanted.tolist() if v not in tree]:
            path = _path(problem, tree, set(missing), price, taken, side)
            if path is None:
                return None
            tree.update(path)
        taken[list(tree)] = side
    return taken


def _path(
    problem: Problem, sources: set[int], targets: set[int], price: Array, taken: Labels, side: int
) -> list[int] | None:
    """Cheapest path from a tree to any target through sites that the other fluid has not taken (Dijkstra)."""
    best = dict.fromkeys(sources, 0.0)
    came: dict[int, int] = {}
    heap = [(0.0, v) for v in sorted(sources)]
    heapq.heapify(heap)
    while heap:
        value, v = heapq.heappop(heap)
        if value > best[v]:
            continue
        if v in targets:
            path = [v]
            while path[-1] in came:
                path.append(came[path[-1]])
            return path
        for u in problem.neighbour[problem.start[v] : problem.start[v + 1]].tolist():
            reached = value + float(price[u])
            if taken[u] != -side and reached < best.get(u, np.inf):
                best[u] = reached
                came[u] = v
                heapq.heappush(heap, (reached, u))
    return None


def _cold_share(problem: Problem) -> float:
    """Middle of the shares of the sites that the cold side may have."""
    cold, hot = problem.least_size / len(problem.pinned)
    return float((cold + 1 - hot) / 2)


def _grown(problem: Problem, trees: NDArray[np.int8]) -> Labels:
    """Let both trees take neighbours in turn, the one that is farther from its share first, until no site is left."""
    labels = trees.copy()
    share = {-1: _cold_share(problem), 1: 1 - _cold_share(problem)}
    fronts = {side: deque(np.flatnonzero(labels == side).tolist()) for side in (-1, 1)}
    size = {side: len(front) for side, front in fronts.items()}
    while fronts[-1] or fronts[1]:
        open_sides = [side for side in (-1, 1) if fronts[side]]
        side = min(open_sides, key=lambda s: size[s] / share[s])
        v = fronts[side].popleft()
        for u in problem.neighbour[problem.start[v] : problem.start[v + 1]].tolist():
            if labels[u] == 0:
                labels[u] = side
                size[side] += 1
                fronts[side].append(u)
    return labels


@numba.njit(cache=True)
def _deficit_after(problem, state, v):  # type: ignore[no-untyped-def]
    """Change of the number of missing neighbours if ``v`` changes sides."""
    change = max(0, LEAST_DEGREE - (problem.start[v + 1] - problem.start[v] - state.same[v]))
    change -= max(0, LEAST_DEGREE - state.same[v])
    for k in range(problem.start[v], problem.start[v + 1]):
        u = problem.neighbour[k]
        if state.labels[u] == state.labels[v]:
            change += 1 if state.same[u] <= LEAST_DEGREE else 0
        else:
            change -= 1 if state.same[u] < LEAST_DEGREE else 0
    return change


@numba.njit(cache=True)
def _repair(problem, state, seed, tries):  # type: ignore[no-untyped-def]
    """Random walk that gives every site its neighbours and every opening its sites; returns what is still missing."""
    count = state.labels.size
    random = np.uint64(seed * 2 + 1) * np.uint64(0x9E3779B97F4A7C15)
    missing = np.maximum(0, LEAST_DEGREE - state.same).sum()
    for _ in range(tries):
        lacking = np.int64(-1)
        for o in range(problem.least.size):
            for side in range(2):
                if state.held[o, side] < problem.least[o]:
                    lacking = np.int64(o)
        if missing == 0 and lacking < 0:
            return 0
        random ^= random << np.uint64(13)
        random ^= random >> np.uint64(7)
        random ^= random << np.uint64(17)
        v = np.int64((random >> np.uint64(16)) % np.uint64(count))
        if lacking < 0 and state.same[v] >= LEAST_DEGREE and (random & np.uint64(7)) != 0:
            near = False
            for k in range(problem.start[v], problem.start[v + 1]):
                if state.same[problem.neighbour[k]] < LEAST_DEGREE:
                    near = True
            if not near:
                continue
        side = (state.labels[v] + 1) // 2
        if problem.pinned[v] or state.size[side] <= problem.least_size[side]:
            continue
        if problem.start[v + 1] - problem.start[v] - state.same[v] < 1:
            continue
        change = _deficit_after(problem, state, v)
        for k in range(problem.member_start[v], problem.member_start[v + 1]):
            o = problem.member[k]
            if state.held[o, side] <= problem.least[o]:
                change += 3
            if state.held[o, 1 - side] < problem.least[o]:
                change -= 3
        if change > 0 and (random >> np.uint64(40)) % np.uint64(100) >= np.uint64(3):
            continue
        connected, _seen = stays_connected(problem, state, v)
        if not connected:
            continue
        missing += _deficit_after(problem, state, v)
        flip(problem, state, v)
    return missing if missing > 0 else 1
