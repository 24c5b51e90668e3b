"""The partition of the sites between the two fluids: a constrained connected maximum cut (paper, section 4.2)."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dualms.cut.anneal import anneal
from dualms.cut.bound import upper_bound
from dualms.cut.constraints import Labels, cut_weight, problem_of, violations
from dualms.cut.greedy import greedy
from dualms.cut.network import network_resistance
from dualms.cut.start import first_partition
from dualms.graph.graph import Graph
from dualms.grid import Array
from dualms.progress import Progress, Silent
from dualms.spec import PartitionSpec

PROPOSALS_PER_SECOND = 20_000_000  # about one core of a laptop; a fixed figure, so that a seed means the same anywhere
PROPOSALS_PER_SITE = 4000  # of one run: more gains under 0.5 % of the cut at 300 and 800 sites
MOST_RUNS = 16
SHARE_TOLERANCE = 0.02


@dataclass(frozen=True)
class Partition:
    """Which fluid each site belongs to.

    Parameters
    ----------
    labels
        (N,) int8: 1 hot, -1 cold.
    cut_weight, total_weight, upper_bound
        Weight of the edges between the fluids, of all edges, and a proven bound that no partition exceeds.
    iterations
        Changes of side (``greedy``) or proposed changes of one run (``anneal``).
    history
        (K, 2) float64, iteration and best cut weight so far.
    method
        ``greedy`` or ``anneal``.
    resistance_hot, resistance_cold
        Of each fluid's network of channels, in unit-cube units (see ``dualms.cut.network``).
    """

    labels: NDArray[np.int8]
    cut_weight: float
    total_weight: float
    upper_bound: float
    iterations: int
    history: Array
    method: str
    resistance_hot: float
    resistance_cold: float

    def __post_init__(self) -> None:
        if self.labels.ndim != 1 or not np.isin(self.labels, (-1, 1)).all():
            raise ValueError("labels must be 1 or -1")
        if not 0 <= self.cut_weight <= self.upper_bound * (1 + 1e-9) + 1e-9:
            raise ValueError("a cut's weight must lie between 0 and its bound")
        if self.history.ndim != 2 or self.history.shape[1] != 2:
            raise ValueError("a history is (K, 2)")


def max_cut(graph: Graph, spec: PartitionSpec, seed: int, *, progress: Progress | None = None) -> Partition:
    """Divide the sites between the fluids so that as much edge weight as possible lies between them.

    Parameters
    ----------
    graph
        Sites, edges, weights, and the ports' demands.
    spec
        Method and search budget.
    seed
        Seed of the search.
    progress
        Where to report to.

    Raises
    ------
    InfeasiblePartition
        If no partition was found that keeps the constraints.
    """
    with ThreadPoolExecutor(1) as beside:
        bound = beside.submit(upper_bound, graph)
        return _search(graph, spec, seed, bound, progress or Silent())


def _search(graph: Graph, spec: PartitionSpec, seed: int, bound: Future[float], progress: Progress) -> Partition:
    """Search while the bound is on its way."""
    problem = problem_of(graph, _least_sizes(len(graph.sites), spec.hot_share))
    labels = first_partition(graph, problem, seed)
    before = cut_weight(graph, labels)
    climbed, gains = greedy(problem, labels)
    history = np.column_stack([np.arange(len(gains) + 1), before + np.concatenate([[0.0], np.cumsum(gains)])])
    iterations = len(gains)
    progress.report("partition", 0.1, f"Algorithm 1: cut {cut_weight(graph, climbed):.6g}")
    if spec.method == "anneal":
        budget = max(1, int(spec.seconds * PROPOSALS_PER_SECOND))
        runs = int(np.clip(budget // (PROPOSALS_PER_SITE * len(labels)), 1, MOST_RUNS))
        found = [(climbed, np.array([[0.0, cut_weight(graph, climbed) - before]]))]
        for run in range(runs):
            found.append(anneal(problem, labels, budget // runs, seed * MOST_RUNS + run))
            weight = cut_weight(graph, found[-1][0])
            progress.report("partition", 0.1 + 0.4 * (run + 1) / runs, f"run {run + 1} of {runs}: cut {weight:.6g}")
        climbed, steps = _easiest(graph, found, spec.slack)
        iterations = budget // runs
        history = np.column_stack([steps[:, 0], before + steps[:, 1]])
    broken = violations(graph, climbed)
    if broken:
        raise AssertionError(f"the search broke a constraint: {broken[0]}")
    weight, total = cut_weight(graph, climbed), float(graph.weights.sum())
    progress.report("partition", 1.0, f"cut {weight:.6g}, at most {bound.result():.6g}")
    hot, cold = (network_resistance(graph, climbed, fluid) for fluid in (1, -1))
    return Partition(climbed, weight, total, bound.result(), iterations, history, spec.method, hot, cold)


def _least_sizes(count: int, hot_share: float | None) -> tuple[int, int]:
    """Sites that the cold and the hot side must keep."""
    if hot_share is None:
        return 3, 3
    cold, hot = (max(3, int(np.ceil((share - SHARE_TOLERANCE) * count))) for share in (1 - hot_share, hot_share))
    return cold, hot


def _easiest(graph: Graph, found: list[tuple[Labels, Array]], slack: float) -> tuple[Labels, Array]:
    """Of all cuts within ``slack`` of the heaviest, the one whose channels resist the flow least.

    Runs end in cuts of nearly the same weight whose channels differ by a third in resistance: it is worth choosing.
    """
    weights = [cut_weight(graph, labels) for labels, _ in found]
    least = max((1 - slack) * max(weights), weights[0])  # never below Algorithm 1, which comes first
    near = [k for k, weight in enumerate(weights) if weight >= least]
    resistances = [sum(network_resistance(graph, found[k][0], fluid) for fluid in (1, -1)) for k in near]
    best = min(range(len(near)), key=lambda i: (resistances[i], -weights[near[i]]))
    return found[near[best]]
