"""The Pareto front: the points that no other point beats in one figure without losing in the other."""

from __future__ import annotations

from collections.abc import Sequence


def pareto_front(points: Sequence[tuple[float, float]]) -> tuple[bool, ...]:
    """Which points are on the front.

    Parameters
    ----------
    points
        For each point what should be small and what should be large, both finite.

    Returns
    -------
    tuple of bool
        False where another point is at least as good in both and better in one. Equal points share their fate.

    Notes
    -----
    By a sweep from small to large, in O(n log n).
    """
    best = float("-inf")
    found: dict[tuple[float, float], bool] = {}
    for small, large in sorted(set(points), key=lambda p: (p[0], -p[1])):
        found[small, large] = large > best
        best = max(best, large)
    return tuple(found[small, large] for small, large in points)
