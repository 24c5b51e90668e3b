"""Runs the flow of one fluid and judges it: settled, wandering, or diverged."""

from __future__ import annotations

import math
import re
import shutil
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from dualms.cfd.case import STOP_FILE, FlowControl, write_case
from dualms.cfd.foamfile import read_field
from dualms.cfd.mesh import PATCHES, ChannelMesh
from dualms.cfd.openfoam import OpenFoam
from dualms.errors import EvaluationFailed
from dualms.grid import Array
from dualms.spec import FluidSpec

_PRESSURE = re.compile(r"of p = (\S+)")
_RESIDUAL = re.compile(r"Solving for (\w+), Initial residual = ([^\s,]+)")


@dataclass(frozen=True)
class FlowSolution:
    """The solved flow of one fluid.

    Parameters
    ----------
    velocity_m_s
        (N, 3) of the cells.
    pressure_pa
        (N,) static pressure over the outlet's.
    flux_m3_s
        (F,) volume flow through the mesh's faces along their normals; zero on walls.
    history_pa
        (I,) static pressure drop at each iteration.
    pressure_drop_pa, pressure_scatter_pa
        Mean and standard deviation over the last window: flux-weighted inlet pressure over the outlet's.
    total_pressure_drop_pa
        The same with the dynamic pressure, from the last iteration's fields.
    residuals
        Last initial residual of Ux, Uy, Uz and p.
    state
        ``steady``, ``wandering`` (the mean has settled) or ``unsettled`` (the iterations ran out).
    scheme
        Of the momentum convection, after a fallback if one was needed.
    notes
        What a reader should know, such as a divergence on the way.
    seconds
        Wall-clock time of the solver.
    """

    velocity_m_s: Array
    pressure_pa: Array
    flux_m3_s: Array
    history_pa: Array
    pressure_drop_pa: float
    pressure_scatter_pa: float
    total_pressure_drop_pa: float
    residuals: dict[str, float]
    state: str
    scheme: str
    notes: tuple[str, ...]
    seconds: float

    def __post_init__(self) -> None:
        if not all(np.isfinite(a).all() for a in (self.velocity_m_s, self.pressure_pa, self.flux_m3_s)):
            raise ValueError("a flow solution must be finite")


class _Diverged(Exception):
    """The iteration left all bounds."""


def solve_flow(
    foam: OpenFoam,
    mesh: ChannelMesh,
    fluid: FluidSpec,
    folder: Path,
    control: FlowControl,
    report: Callable[[float, str], None] = lambda fraction, note: None,
) -> FlowSolution:
    """Solve the flow; on divergence once more by first-order upwind from rest.

    Parameters
    ----------
    foam, mesh, fluid
        Installation, cells, properties and mass flow.
    folder
        Of the case, which stays there with its logs.
    control
        Limits and schemes.
    report
        Called with the done fraction and a note; what it raises stops the solver.

    Raises
    ------
    EvaluationFailed
        If the flow diverges with the robust scheme too, or the program fails.
    """
    robust = replace(control, scheme="upwind", velocity_relaxation=0.7, pressure_relaxation=0.7)
    try:
        return _attempt(foam, mesh, fluid, folder, control, report, ())
    except _Diverged as first:
        note = f"The flow diverged with {control.scheme} ({first}); solved by upwind instead."
    try:
        return _attempt(foam, mesh, fluid, folder.with_name(folder.name + "-upwind"), robust, report, (note,))
    except _Diverged as second:
        raise EvaluationFailed(
            f"The flow on {len(mesh.cells)} cells diverged, with the robust scheme too ({second}).",
            advice="Raise the evaluation's resolution, lower the mass flow (the model is laminar), or widen the ports.",
            measured={"cells": len(mesh.cells)},
        ) from second


def state_of(history: Array, control: FlowControl) -> str | None:
    """``steady`` or ``wandering`` as soon as a history of pressure drops (I,) allows to stop; None before."""
    half = control.window // 2
    if len(history) < control.window:
        return None
    mean = abs(float(history[-control.window :].mean()))
    if float(np.ptp(history[-half:])) <= control.steady * mean:
        return "steady"
    if len(history) >= 2 * control.window:
        before = float(history[-2 * control.window : -control.window].mean())
        if abs(abs(before) - mean) <= control.drift * mean:
            return "wandering"
    return None


def _attempt(
    foam: OpenFoam,
    mesh: ChannelMesh,
    fluid: FluidSpec,
    folder: Path,
    control: FlowControl,
    report: Callable[[float, str], None],
    notes: tuple[str, ...],
) -> FlowSolution:
    shutil.rmtree(folder, ignore_errors=True)
    write_case(folder, mesh, fluid, control)
    history: list[float] = []
    residuals: dict[str, float] = {}
    states: list[str] = []
    ceiling = _ceiling(mesh, fluid)

    def on_line(line: str) -> None:
        found = _RESIDUAL.search(line)
        if found:
            residuals[found.group(1)] = float(found.group(2))
        found = _PRESSURE.search(line)
        if not found:
            return
        history.append(float(found.group(1)) * fluid.density_kg_m3)
        if not math.isfinite(history[-1]) or abs(history[-1]) > ceiling:
            raise _Diverged(f"{history[-1]:.3g} Pa at iteration {len(history)}")
        fraction = min(1.0, len(history) / (2.5 * control.window), 0.99)
        report(fraction, f"iteration {len(history)}, {history[-1]:.4g} Pa")
        if not states and (state := state_of(np.array(history), control)) is not None:
            states.append(state)
            (folder / STOP_FILE).touch()

    began = time.monotonic()
    code = foam.run("simpleFoam", folder, on_line)
    seconds = time.monotonic() - began
    if code != 0:
        if len(history) > 1:
            raise _Diverged(f"the solver stopped with code {code} at iteration {len(history)}")
        raise EvaluationFailed(
            f"simpleFoam stopped with code {code} before its first iteration.",
            advice="Look into the solver's log in the case; `dualms doctor` checks the installation.",
            measured={"exit_code": code},
        )
    values = np.array(history)
    velocity, pressure, flux, ends = _read(folder, mesh, fluid)
    last = values[-control.window :]
    return FlowSolution(
        velocity,
        pressure,
        flux,
        values,
        float(last.mean()),
        float(last.std()),
        float(last.mean()) + ends,
        residuals,
        states[0] if states else "unsettled",
        control.scheme,
        notes,
        seconds,
    )


def _ceiling(mesh: ChannelMesh, fluid: FluidSpec) -> float:
    """A pressure drop (Pa) far above any sane one: the whole flow through one voxel after the other."""
    speed = fluid.mass_flow_kg_s / fluid.density_kg_m3 / mesh.face_area_m2
    friction = 100.0 * fluid.viscosity_pa_s * speed * len(mesh.cells) / mesh.spacing_m
    return fluid.density_kg_m3 * speed**2 + friction


def _read(folder: Path, mesh: ChannelMesh, fluid: FluidSpec) -> tuple[Array, Array, Array, float]:
    """Velocity, pressure, fluxes, and the drop of dynamic pressure from inlet to outlet (flux-weighted)."""
    last = max((p for p in folder.iterdir() if p.name.isdigit() and p.name != "0"), key=lambda p: int(p.name))
    sizes = {name: mesh.starts[k + 1] - mesh.starts[k] for k, name in enumerate(PATCHES)}
    velocity, at = read_field(last / "U", len(mesh.cells), sizes)
    pressure, _ = read_field(last / "p", len(mesh.cells), sizes)
    inside, boundary = read_field(last / "phi", len(mesh.neighbour), sizes)
    flux = np.concatenate([inside, *(boundary[name] for name in PATCHES)])
    dynamic = {}
    for name in ("inlet", "outlet"):
        weight = np.abs(flux[mesh.patch(name)])
        dynamic[name] = 0.5 * fluid.density_kg_m3 * float(weight @ (at[name] ** 2).sum(axis=1)) / float(weight.sum())
    return velocity, pressure * fluid.density_kg_m3, flux, dynamic["inlet"] - dynamic["outlet"]
