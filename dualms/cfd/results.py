"""The figures of an evaluation, as they stand in ``evaluation.json``."""

from __future__ import annotations

import math
from typing import Any, Literal

from pydantic import Field

from dualms.spec import Model

MODE = "quick: for ranking"


class FluidFigures(Model):
    """What one fluid does."""

    pressure_drop_pa: float = Field(
        description="Static pressure, inlet (flux-weighted) over outlet: mean of the window."
    )
    pressure_scatter_pa: float = Field(description="Standard deviation over the last iterations.")
    total_pressure_drop_pa: float = Field(description="The same with the dynamic pressure.")
    pumping_power_w: float = Field(description="Total pressure drop times volume flow; no pump losses.")
    outlet_temperature_k: float = Field(description="Mixed-cup temperature at the outlets.")
    temperature_change_k: float = Field(description="Outlet less inlet.")
    film_conductance_w_k: float = Field(
        description="UA of this side alone, from a second solution with an isothermal wall: m·cp·ln(ΔT in/ΔT out)."
    )
    hydraulic_diameter_m: float = Field(description="Four times the volume over the wetted surface, wall and envelope.")
    reynolds: float = Field(description="With the hydraulic diameter and the mean speed (RMS of the cells).")
    mass_imbalance: float = Field(description="Outflow over inflow less one, as solved.")
    energy_imbalance: float = Field(description="Heat through the wall over the enthalpy's change, less one.")
    cells: int
    iterations: int
    state: Literal["steady", "wandering", "unsettled"] = Field(
        description="steady; wandering: the mean has settled; unsettled: the iterations ran out."
    )
    scheme: str
    residuals: dict[str, float]
    dropped_fraction: float = Field(description="Share of the fluid that leads from no inlet to any outlet.")
    seconds: float = Field(description="Wall-clock time of the flow solver.")
    notes: tuple[str, ...]


class ExchangerFigures(Model):
    """What one separating surface does in the envelope."""

    hot: FluidFigures
    cold: FluidFigures
    duty_w: float = Field(description="Heat from hot to cold.")
    effectiveness: float = Field(description="Duty over what an ideal counter-flow exchanger would reach.")
    ntu: float = Field(description="UA over the smaller capacity rate.")
    ua_w_k: float = Field(
        description="UA of the counter-flow exchanger of the same duty, with films from the solved shear on the wall. "
        "In oils it still grows with the resolution; its ratio between two surfaces hardly does: for ranking."
    )
    pressure_drop_pa: float = Field(description="Mean of the two fluids.")
    pumping_power_w: float = Field(description="Sum of the two fluids.")
    wall_area_m2: float = Field(description="Exchanging area, mean of the two sides of the wall.")
    area_density_per_m: float = Field(description="Exchanging area over the envelope's volume.")
    solid_fraction: float = Field(description="Separating wall over the envelope's volume.")


class Problem(Model):
    """Why figures are missing."""

    code: str
    message: str
    advice: str


class BaselineFigures(Model):
    """A periodic surface in the same envelope, ports and wall."""

    surface: str
    cell_m: float
    figures: ExchangerFigures | None
    problem: Problem | None


class Comparison(Model):
    """The design against one kind of baseline."""

    surface: str
    match: Literal["solid-fraction", "ua"]
    cell_m: float = Field(description="Cell of the baseline that matches.")
    pressure_ratio: float = Field(description="ΔP of the design over ΔP of the baseline that matches.")
    ua_ratio: float = Field(description="UA of the design over UA of the baseline that matches.")


class StraightPassage(Model):
    """Straight round tubes with the fluid's volume and hydraulic diameter: a floor for ΔP, not a design."""

    length_m: float = Field(description="Shortest way from inlet to outlet within the envelope.")
    hydraulic_diameter_m: float
    pressure_drop_pa: float = Field(description="Poiseuille.")
    film_conductance_w_k: float = Field(description="Graetz, isothermal wall (Hausen's mean Nusselt number).")


class Evaluation(Model):
    """``evaluation.json``."""

    mode: Literal["quick: for ranking"]
    solver: str = Field(description="Program and version.")
    resolution: int
    voxel_m: float
    design: ExchangerFigures | None
    problem: Problem | None = Field(description="Why the design has no figures, such as a flow that diverged.")
    floor: dict[str, StraightPassage]
    baselines: tuple[BaselineFigures, ...]
    comparisons: tuple[Comparison, ...]
    seconds: float
    peak_memory_bytes: int = Field(description="Of this process or of its largest solver, whichever is larger.")

    def to_json(self) -> dict[str, Any]:
        """The document."""
        return self.model_dump(mode="json")


def counterflow_ntu(effectiveness: float, ratio: float) -> float:
    """NTU of a counter-flow exchanger.

    Parameters
    ----------
    effectiveness
        0 to 1.
    ratio
        Smaller over larger capacity rate, 0 to 1.

    Returns
    -------
    float
        Kays and London, "Compact heat exchangers"; infinite at an effectiveness of 1.
    """
    if effectiveness >= 1:
        return math.inf
    if abs(1 - ratio) < 1e-6:
        return effectiveness / (1 - effectiveness)
    return math.log((1 - effectiveness * ratio) / (1 - effectiveness)) / (1 - ratio)
