"""The report's groups of figures, as they stand in ``report.json``; the unit is in the name."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict


class Figures(BaseModel):
    """A group of figures."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class CurvatureFigures(Figures):
    """Mean curvature of the separating surface, a strip along its border left out."""

    abs_median_per_m: float
    abs_p90_per_m: float
    abs_p99_per_m: float
    abs_median_times_dh: float
    rms_times_cell: float


class WallFigures(Figures):
    """Thickness of the separating wall: asked (its mean, where it is graded), measured, and measured over asked.

    The least and the greatest are the 1st and 99th percentile.
    """

    thickness_m: float
    thickness_min_m: float
    thickness_max_m: float
    over_asked_min: float
    over_asked_max: float


class FluidFigures(Figures):
    """One fluid's volume and channel."""

    volume_m3: float
    interface_area_m2: float
    wetted_area_m2: float
    hydraulic_diameter_m: float
    components: int
    dead_end_fraction: float
    dead_end_volume_m3: float
    min_channel_m: float
    passage_m: float
    filled_fraction: float
    inlet_to_outlet_connected: bool


class FluidsFigures(Figures):
    """Both fluids."""

    hot: FluidFigures
    cold: FluidFigures


class SeparationFigures(Figures):
    """What a walk on the finest grid finds; it passes neither the solid's surface nor a port.

    Ways from the hot fluid's ports to the cold's, ways from either to the outside, and ports that cannot be reached
    from their fluid's first.
    """

    voxel_m: float
    hot_to_cold: int
    to_outside: int
    ports_apart: int


class OverhangFigures(Figures):
    """What faces down more steeply than 45° to the build direction: of the whole solid, and of the separating wall."""

    area_m2: float
    wall_area_m2: float
    wall_fraction: float


class PartitionFigures(Figures):
    """The cut of the graph."""

    method: str
    sites: int
    edges: int
    cut_weight: float
    total_weight: float
    upper_bound: float
    iterations: int
    history: tuple[tuple[float, float], ...]


class BuildDirection(Figures):
    """The direction to print in that leaves the least overhang."""

    direction: tuple[float, float, float]
    overhang_area_fraction: float
