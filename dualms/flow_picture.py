"""A picture of the guidance: its lines, traced through the domain and seen along the three axes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dualms.domain import Domain
from dualms.flow import FlowField
from dualms.grid import Array

SEEDS = 100
STEPS = 400  # each way, of half a voxel
COLOURS = {1: "#cc3320", -1: "#1a52b8"}
PLANES = ((0, 1), (0, 2), (1, 2))


def trace(flow: FlowField, seeds: Array, steps: int = STEPS) -> tuple[Array, ...]:
    """Lines of the field through ``seeds`` (S, 3), each (K, 3), followed both ways until they leave the domain.

    The field has no sense: each step goes on in the sense of the last one.
    """
    step = 0.5 * flow.grid.spacing
    halves = []
    for sense in (1.0, -1.0):
        at, heading = seeds.copy(), sense * flow.lines(seeds)
        alive = np.ones(len(seeds), dtype=bool)
        path = np.full((steps + 1, len(seeds), 3), np.nan)
        path[0] = seeds
        for k in range(steps):
            middle = flow.lines(at + 0.5 * step * heading)
            middle *= np.where((middle * heading).sum(axis=1) < 0, -1.0, 1.0)[:, None]
            at, heading = at + step * middle, middle
            alive &= flow.inside[tuple(flow.grid.nearest(at).T)]
            if not alive.any():
                break
            path[k + 1, alive] = at[alive]
        halves.append(path)
    joined = np.concatenate([halves[1][:0:-1], halves[0]])
    return tuple(joined[np.isfinite(joined[:, s, 0]), s] for s in range(len(seeds)))


def flow_picture(domain: Domain, flow: FlowField, path: Path) -> None:
    """Write the three views as one PNG; axes in metres, ports in their fluid's colour (shared ones in both)."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.collections import LineCollection
    from matplotlib.figure import Figure

    lines = trace(flow, _seeds(flow))
    lines_m = [line * domain.scale_m + domain.offset_m for line in lines]
    axes_m = [a * domain.scale_m + o for a, o in zip(flow.grid.axes(), domain.offset_m, strict=True)]
    figure = Figure(figsize=(15, 5), layout="constrained")
    FigureCanvasAgg(figure)
    for k, (i, j) in enumerate(PLANES):
        axis = figure.add_subplot(1, 3, k + 1)
        away = ({0, 1, 2} - {i, j}).pop()
        shadow = flow.inside.any(axis=away).astype(float)
        axis.contourf(axes_m[i], axes_m[j], shadow.T, levels=[0.5, 1.5], colors=["#eeeeea"])
        depth = [float(line[:, away].mean()) for line in lines_m]
        drawn = LineCollection([line[:, [i, j]] for line in lines_m], linewidths=0.8, cmap="viridis")
        drawn.set_array(np.array(depth))
        axis.add_collection(drawn)
        for port in domain.ports:
            spots = port.samples[:: max(1, len(port.samples) // 200)] * domain.scale_m + domain.offset_m
            offset = 1 if port.fluid == 1 else 0  # of a shared port every other point
            shown = spots[offset::2] if port.shared else spots
            axis.scatter(shown[:, i], shown[:, j], s=2, color=COLOURS[port.fluid])
        axis.set(xlabel=f"{'xyz'[i]} (m)", ylabel=f"{'xyz'[j]} (m)", aspect="equal")
    figure.suptitle("Guidance: the lines along which both fluids are led (colour: depth of the line)")
    figure.savefig(path, dpi=110, format="png", metadata={"Software": None})


def _seeds(flow: FlowField) -> Array:
    """Points spread over the domain, the same every time."""
    points: NDArray[np.float64] = flow.grid.points(flow.inside)
    return points[np.random.default_rng(0).choice(len(points), min(SEEDS, len(points)), replace=False)]
