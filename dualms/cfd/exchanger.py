"""Solves one exchanger: both flows side by side, then the heat between them."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dualms.cfd.case import FlowControl
from dualms.cfd.channels import COLD, HOT, OUTSIDE, VoxelExchanger
from dualms.cfd.flow import FlowSolution, solve_flow
from dualms.cfd.heat import HeatSolution, exchange, isothermal
from dualms.cfd.mesh import ChannelMesh, channel_mesh
from dualms.cfd.openfoam import OpenFoam
from dualms.cfd.results import ExchangerFigures, FluidFigures, counterflow_ntu
from dualms.cfd.stream import Stream, stream_of
from dualms.spec import EvaluationSpec, FluidsSpec

NAMES = {HOT: "hot", COLD: "cold"}


@dataclass(frozen=True)
class SolvedFluid:
    """One fluid's mesh, flow and temperatures."""

    mesh: ChannelMesh
    flow: FlowSolution
    heat: HeatSolution


@dataclass(frozen=True)
class SolvedExchanger:
    """A solved exchanger with its figures."""

    exchanger: VoxelExchanger
    hot: SolvedFluid
    cold: SolvedFluid
    figures: ExchangerFigures


def solve_exchanger(
    foam: OpenFoam,
    exchanger: VoxelExchanger,
    fluids: FluidsSpec,
    spec: EvaluationSpec,
    folder: Path,
    report: Callable[[float, str], None] = lambda fraction, note: None,
) -> SolvedExchanger:
    """Solve flow and heat of both fluids.

    Parameters
    ----------
    foam
        The installation.
    exchanger
        Geometry.
    fluids
        Properties, mass flows, inlet temperatures.
    spec
        Limits, scheme, the wall's conductivity.
    folder
        Receives the cases ``hot`` and ``cold`` with their logs.
    report
        Called from one thread at a time with the done fraction and a note; what it raises stops both solvers.

    Raises
    ------
    EvaluationFailed
        If a flow diverges with the robust scheme too.
    """
    control = FlowControl(iterations=spec.iterations, scheme=spec.scheme)
    given = {HOT: fluids.hot, COLD: fluids.cold}
    meshes = {sign: channel_mesh(exchanger, sign) for sign in (HOT, COLD)}
    both = _Both(report)

    def run(sign: int) -> FlowSolution:
        try:
            return solve_flow(foam, meshes[sign], given[sign], folder / NAMES[sign], control, both.of(sign))
        except BaseException:
            both.stop.set()
            raise

    with ThreadPoolExecutor(2) as pool:
        waiting = {sign: pool.submit(run, sign) for sign in (HOT, COLD)}
    errors = [error for future in waiting.values() if (error := future.exception()) is not None]
    for error in sorted(errors, key=lambda e: isinstance(e, _OtherStopped)):
        raise error
    flows = {sign: future.result() for sign, future in waiting.items()}
    report(0.95, "temperatures")
    streams = {
        sign: stream_of(exchanger, sign, meshes[sign], flow.flux_m3_s, flow.velocity_m_s, flow.pressure_pa, given[sign])
        for sign, flow in flows.items()
    }
    heats = dict(
        zip((HOT, COLD), exchange(exchanger, streams[HOT], streams[COLD], spec.wall_conductivity_w_m_k), strict=True)
    )
    middle = (fluids.hot.inlet_temperature_k + fluids.cold.inlet_temperature_k) / 2
    films = {sign: isothermal(stream, middle) for sign, stream in streams.items()}
    figures = {
        sign: _fluid_figures(exchanger, sign, streams[sign], flows[sign], heats[sign], films[sign], middle)
        for sign in (HOT, COLD)
    }
    solved = {sign: SolvedFluid(meshes[sign], flows[sign], heats[sign]) for sign in (HOT, COLD)}
    both_figures = _exchanger_figures(exchanger, fluids, streams, heats, figures)
    report(1.0, f"ΔP {both_figures.pressure_drop_pa:.4g} Pa, UA {both_figures.ua_w_k:.4g} W/K")
    return SolvedExchanger(exchanger, solved[HOT], solved[COLD], both_figures)


class _OtherStopped(Exception):
    """The other fluid's solver failed or was cancelled."""


class _Both:
    """Joins the progress of two solvers that run side by side."""

    def __init__(self, report: Callable[[float, str], None]) -> None:
        self.stop = threading.Event()
        self._report = report
        self._lock = threading.Lock()
        self._done = {HOT: 0.0, COLD: 0.0}
        self._said = 0.0

    def of(self, sign: int) -> Callable[[float, str], None]:
        def report(fraction: float, note: str) -> None:
            if self.stop.is_set():
                raise _OtherStopped
            with self._lock:
                self._done[sign] = fraction
                self._said = max(self._said, 0.94 * sum(self._done.values()) / 2)
                self._report(self._said, f"{NAMES[sign]}: {note}")

        return report


def _fluid_figures(
    exchanger: VoxelExchanger,
    sign: int,
    stream: Stream,
    flow: FlowSolution,
    heat: HeatSolution,
    film: HeatSolution,
    wall_k: float,
) -> FluidFigures:
    mesh, fluid = stream.mesh, stream.fluid
    inlet = fluid.inlet_temperature_k
    left = (wall_k - film.outlet_k) / (wall_k - inlet)
    diameter = stream.hydraulic_diameter_m
    speed = float(np.sqrt((flow.velocity_m_s**2).sum(axis=1).mean()))
    entering = -float(flow.flux_m3_s[mesh.patch("inlet")].sum())
    leaving = float(flow.flux_m3_s[mesh.patch("outlet")].sum())
    return FluidFigures(
        pressure_drop_pa=flow.pressure_drop_pa,
        pressure_scatter_pa=flow.pressure_scatter_pa,
        total_pressure_drop_pa=flow.total_pressure_drop_pa,
        pumping_power_w=flow.total_pressure_drop_pa * entering,
        outlet_temperature_k=heat.outlet_k,
        temperature_change_k=heat.outlet_k - inlet,
        film_conductance_w_k=-stream.capacity_rate_w_k * float(np.log(max(left, 1e-12))),
        hydraulic_diameter_m=diameter,
        reynolds=fluid.density_kg_m3 * speed * diameter / fluid.viscosity_pa_s,
        mass_imbalance=leaving / entering - 1,
        energy_imbalance=heat.wall_w / heat.enthalpy_w - 1 if heat.enthalpy_w else 0.0,
        cells=len(mesh.cells),
        iterations=len(flow.history_pa),
        state=flow.state,
        scheme=flow.scheme,
        residuals=flow.residuals,
        dropped_fraction=exchanger.dropped(sign),
        seconds=flow.seconds,
        notes=flow.notes,
    )


def _exchanger_figures(
    exchanger: VoxelExchanger,
    fluids: FluidsSpec,
    streams: dict[int, Stream],
    heats: dict[int, HeatSolution],
    figures: dict[int, FluidFigures],
) -> ExchangerFigures:
    rates = [f.mass_flow_kg_s * f.specific_heat_j_kg_k for f in (fluids.hot, fluids.cold)]
    span = fluids.hot.inlet_temperature_k - fluids.cold.inlet_temperature_k
    duty = heats[COLD].wall_w
    effectiveness = duty / (min(rates) * span) if span else 0.0
    ntu = counterflow_ntu(min(effectiveness, 1 - 1e-9), min(rates) / max(rates))
    area = float(np.mean([stream.wall.area_m2.sum() for stream in streams.values()]))
    volume = int((exchanger.labels != OUTSIDE).sum()) * exchanger.spacing_m**3
    return ExchangerFigures(
        hot=figures[HOT],
        cold=figures[COLD],
        duty_w=duty,
        effectiveness=effectiveness,
        ntu=ntu,
        ua_w_k=ntu * min(rates),
        pressure_drop_pa=(figures[HOT].pressure_drop_pa + figures[COLD].pressure_drop_pa) / 2,
        pumping_power_w=figures[HOT].pumping_power_w + figures[COLD].pumping_power_w,
        wall_area_m2=area,
        area_density_per_m=area / volume,
        solid_fraction=exchanger.solid_fraction,
    )
