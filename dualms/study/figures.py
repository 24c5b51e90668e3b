"""Which figures of the report stand in a study's table, and how a dotted path finds them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from dualms.spec import EvaluationSpec, Spec

Scalar = float | int | bool | str | None

GEOMETRY = (
    "area_density_per_m",
    "solid_volume_fraction",
    "mean_curvature.abs_median_times_dh",
    "fluids.hot.hydraulic_diameter_m",
    "fluids.cold.hydraulic_diameter_m",
    "certified",
)
DESIGN = "evaluation.design"
SOLVED = tuple(f"{DESIGN}.{name}" for name in ("pressure_drop_pa", "ua_w_k", "effectiveness", "pumping_power_w"))


@dataclass(frozen=True)
class Objectives:
    """What a study weighs against each other: one figure that should be small, one that should be large."""

    small: str
    large: str


HYDRAULIC = Objectives(f"{DESIGN}.pressure_drop_pa", f"{DESIGN}.ua_w_k")
GEOMETRIC = Objectives("mean_curvature.abs_median_times_dh", "area_density_per_m")  # the paper's aims, section 3


def objectives_of(specs: Iterable[Spec]) -> Objectives:
    """Pressure drop against UA where flows are solved; mean curvature against area otherwise."""
    return HYDRAULIC if any(spec.evaluation is not None for spec in specs) else GEOMETRIC


def default_metrics(specs: Iterable[Spec]) -> tuple[str, ...]:
    """The figures that a table shows if none are named, in order."""
    evaluations = [spec.evaluation for spec in specs if spec.evaluation is not None]
    solved = SOLVED if evaluations else ()
    compared = [path for evaluation in evaluations for path in _comparisons(evaluation)]
    return tuple(dict.fromkeys([*solved, *compared, *GEOMETRY]))


def _comparisons(evaluation: EvaluationSpec) -> list[str]:
    matches = ("solid-fraction", "ua") if evaluation.match == "ua" else ("solid-fraction",)
    return [
        f"evaluation.comparisons.{surface}.{match}.{ratio}"
        for surface in evaluation.baselines
        for match in matches
        for ratio in (("pressure_ratio",) if match == "ua" else ("pressure_ratio", "ua_ratio"))
    ]


def figure(report: Mapping[str, Any], path: str) -> Scalar:
    """One figure of a report.

    Parameters
    ----------
    report
        The document of ``report.json``, or a part of it.
    path
        Names with dots between. In a list, a number is an index; any other part selects the items that hold it as a
        value, as in ``evaluation.comparisons.gyroid.ua.pressure_ratio``.

    Returns
    -------
    scalar
        None where there is no such figure, or where it is no scalar.
    """
    place: Any = report
    for part in path.split("."):
        if isinstance(place, list | tuple):
            if part.isdecimal():
                place = place[int(part)] if int(part) < len(place) else None
                continue
            selected = [item for item in place if isinstance(item, Mapping) and part in item.values()]
            if selected:
                place = selected
                continue
            place = place[0] if len(place) == 1 else None
        place = place.get(part) if isinstance(place, Mapping) else None
    if isinstance(place, float) and not math.isfinite(place):
        return None
    return place if isinstance(place, str | int | float) else None


def problem_of(report: Mapping[str, Any]) -> tuple[str, str] | None:
    """Code and message, where a design was made but its flow could not be solved."""
    code, message = (figure(report, f"evaluation.problem.{part}") for part in ("code", "message"))
    return (str(code), str(message)) if code is not None else None
