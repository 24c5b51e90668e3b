"""The classical surfaces from their skeletons, by every method, against exact areas."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
from field_cases import Row, level_set
from field_nets import EXACT_AREA, NETS, PAPER_AREA, sampled
from field_pictures import Shown

from dualms.field.field import Field
from dualms.field.phase_field import solve_phase_field
from dualms.field.torus import Torus
from dualms.field.training import train
from dualms.grid import Grid
from dualms.measure.curvature import away_from_boundary, mean_curvature, vertex_areas
from dualms.progress import Silent
from dualms.spec import DistilledField, NeuralField
from dualms.tpms import Kind, tpms_field

NODAL: dict[str, Kind] = {"P": "p", "G": "gyroid", "D": "d", "I-WP": "iwp"}
STRIP = 4 / 192
"""Along the cell's faces, left out of the curvature figures: fits are one-sided there."""


def classical(given: argparse.Namespace, told: Callable[[Row], Row]) -> tuple[list[Row], list[Shown]]:
    """Rows by surface and method, and what is shown: each method's surface but the diffused one."""
    rows, shown = [], []
    phase_field = given.methods == ["phase-field"]
    grid = _cell(192 if phase_field else 96)
    for name in given.surfaces:
        hot, cold = (sampled(net, 1.0) for net in NETS[name]())
        nets: Any = SimpleNamespace(hot=hot, cold=cold)
        solvers: dict[str, Callable[[], Any]] = {"nodal": lambda name=name: _Nodal(NODAL[name])}
        if "phase-field" in given.methods:
            for label, minimality in (("diffused", 0.5), ("minimal", 1.0)):
                solvers[label] = lambda n=nets, m=minimality: solve_phase_field(Torus(), n, given.grid, m, Silent())
        for method in ("distilled", "neural"):
            if method in given.methods:
                solvers[method] = lambda n=nets, m=method: _trained(m, n, given.grid)
        for label, solve in solvers.items():
            began, busy = time.perf_counter(), time.process_time()
            field = solve()
            spent = {"seconds": time.perf_counter() - began, "cpu_seconds": time.process_time() - busy}
            vertices, faces = level_set(field, grid)
            h = np.abs(mean_curvature(vertices, faces)[away_from_boundary(vertices, faces, STRIP)])
            area = float(vertex_areas(vertices, faces).sum())
            rows.append(
                told(
                    {
                        "surface": name,
                        "kind": label,
                        "area": area,
                        "exact": EXACT_AREA[name],
                        "error_%": 100 * (area / EXACT_AREA[name] - 1),
                        "paper_error_%": 100 * (PAPER_AREA[name] - 1) if name in PAPER_AREA else None,
                        "median_abs_H": float(np.nanmedian(h)),
                        "max_abs_H": float(np.nanmax(h)),
                        "vertices": len(vertices),
                        "faces": len(faces),
                        **spent,
                    }
                )
            )
            if label != "diffused":
                shown.append((f"{name}, {label}: area {area:.4f}", vertices, faces))
    return rows, shown


class _Nodal:
    """A nodal formula as a field."""

    def __init__(self, kind: Kind) -> None:
        self._kind = kind

    def on(self, grid: Grid) -> np.ndarray:
        """Values on a grid."""
        return tpms_field(self._kind, grid, 1.0)


def _trained(method: str, nets: Any, resolution: int) -> Field:
    """A network on one cell, at a CPU's budget: 950 and 1,500 steps of 2,048 points each.

    Frequencies are whole numbers here: of the paper's standard deviation they gave stray pockets, of a third none.
    The step size has fallen to 1/115 where the distilled network's last lesson, the paper's losses, begins: they lead
    away from a minimal surface (decision note 0004).
    """
    spec: DistilledField | NeuralField
    if method == "distilled":
        budget = {"teaching_steps": 900, "steps": 50, "points": 2048, "decay_every": 20, "minimality": 1.0}
        spec = DistilledField.model_validate({"method": "distilled", "resolution": resolution, **budget})
    else:
        budget = {"steps": 1500, "decay_every": 75, "fourier_scale": 0.7}
        spec = NeuralField.model_validate({"method": "neural", "preset": "cpu", "connect": False, **budget})
    return train(Torus(), nets, spec, 0, "cpu", None, Silent())  # type: ignore[arg-type]


def _cell(resolution: int) -> Grid:
    return Grid(np.zeros(3), 1 / resolution, (resolution + 1,) * 3)
