"""The report: every figure of a design with its unit in its name, the certificate, timings and provenance."""

from __future__ import annotations

import platform
from importlib.metadata import version as installed
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from dualms import __version__
from dualms.body.body import Body, Fluid
from dualms.body.patches import INTERFACE
from dualms.body.thickness import Wall, thickness_at
from dualms.body.walls import half_on_grid, wall_share
from dualms.cut.partition import Partition
from dualms.domain import Domain
from dualms.field.field import Field
from dualms.measure.channels import Channel, measure_channel
from dualms.measure.curvature import mean_curvature
from dualms.measure.printing import best_build_direction, overhang_fraction, wall_samples
from dualms.spec import RequireSpec, Spec
from dualms.surface import Surface
from dualms.triangles import TriangleMesh

LIBRARIES = ("numpy", "scipy", "scikit-image", "trimesh", "manifold3d", "libigl", "torch", "numba", "pyamg")


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
    min_channel_m: float
    passage_m: float
    filled_fraction: float
    inlet_to_outlet_connected: bool


class FluidsFigures(Figures):
    """Both fluids."""

    hot: FluidFigures
    cold: FluidFigures


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


class Check(Figures):
    """One line of the certificate."""

    name: str
    value: float
    limit: str
    passed: bool


class BuildDirection(Figures):
    """The direction to print in that leaves the least overhang."""

    direction: tuple[float, float, float]
    overhang_area_fraction: float


class Provenance(Figures):
    """What made this, exactly."""

    version: str
    seed: int
    domain_sha256: str
    spec: dict[str, Any]
    device: str
    field_method: str
    libraries: dict[str, str]
    python: str


class Report(Figures):
    """Everything measured on one design."""

    units: str
    scale_m: float
    domain_volume_m3: float
    area_m2: float
    area_density_per_m: float
    mean_curvature: CurvatureFigures
    wall: WallFigures
    shell_thickness_m: float
    solid_volume_m3: float
    solid_volume_fraction: float
    wall_volume_fraction: float
    volume_closure_error: float
    fluids: FluidsFigures
    leak_free: bool
    watertight: dict[str, bool]
    trapped_volume_m3: float
    overhang_area_fraction: float
    best_build_direction: BuildDirection
    partition: PartitionFigures
    certificate: tuple[Check, ...]
    certified: bool
    timings_s: dict[str, float]
    provenance: Provenance
    evaluation: dict[str, Any] | None

    def timed(self, seconds: dict[str, float]) -> Report:
        """The report with the seconds that each stage took."""
        return self.model_copy(update={"timings_s": {k: round(v, 3) for k, v in seconds.items()}})


def make_report(
    domain: Domain,
    domain_sha256: str,
    partition: Partition,
    edges: int,
    field: Field,
    surface: Surface,
    body: Body,
    asked: Wall,
    spec: Spec,
    units: str,
) -> Report:
    """Measure a body.

    Parameters
    ----------
    domain
        The envelope, for its size and ports.
    domain_sha256
        Hash of the uploaded file.
    partition, edges
        The cut, and how many edges the graph had.
    field
        For its method and device.
    surface, body
        What is measured.
    asked
        Thickness of the separating wall, unit-cube units.
    spec
        The resolved specification.
    units
        Unit of the meshes that go with the report.
    """
    volume = domain.volume * domain.scale_m**3
    area = surface.mesh.area
    outside = spec.shell is not None and spec.shell.side == "outside"
    hot, cold = (
        _fluid(fluid, _channel(domain, surface, body, asked, outside, sign), domain.scale_m)
        for fluid, sign in ((body.hot, 1), (body.cold, -1))
    )
    fluids = FluidsFigures(hot=hot, cold=cold)
    wall = _wall(domain, body, asked, spec.seed)
    solid_volume = body.solid.volume
    filled = solid_volume + body.dropped_m3 + hot.volume_m3 + cold.volume_m3
    closure = abs(filled / body.outline_m3 - 1)
    watertight = {
        "solid": body.solid.is_closed,
        "fluid_hot": body.hot.mesh.is_closed,
        "fluid_cold": body.cold.mesh.is_closed,
    }
    figures: dict[str, Any] = {
        "units": units,
        "scale_m": domain.scale_m,
        "domain_volume_m3": volume,
        "area_m2": area,
        "area_density_per_m": area / volume,
        "mean_curvature": _curvature(surface, volume, (hot, cold), len(partition.labels)),
        "wall": wall,
        "shell_thickness_m": body.shell_m,
        "solid_volume_m3": solid_volume,
        "solid_volume_fraction": solid_volume / volume,
        "wall_volume_fraction": wall_share(surface, half_on_grid(surface, asked)),
        "volume_closure_error": closure,
        "fluids": fluids,
        "leak_free": body.leak_m3 == 0.0,
        "watertight": watertight,
        "trapped_volume_m3": _trapped(body.solid),
        "overhang_area_fraction": overhang_fraction(body.solid, np.array(spec.build_direction, dtype=float)),
        "best_build_direction": _best_direction(body),
        "partition": PartitionFigures(
            method=partition.method,
            sites=len(partition.labels),
            edges=edges,
            cut_weight=partition.cut_weight,
            total_weight=partition.total_weight,
            upper_bound=partition.upper_bound,
            iterations=partition.iterations,
            history=tuple((float(a), float(b)) for a, b in partition.history),
        ),
        "timings_s": {},
        "provenance": Provenance(
            version=__version__,
            seed=spec.seed,
            domain_sha256=domain_sha256,
            spec=spec.model_dump(mode="json"),
            device=field.device,
            field_method=field.method,
            libraries={name: installed(name) for name in LIBRARIES},
            python=platform.python_version(),
        ),
        "evaluation": None,
    }
    certificate = (
        *_certificate(body, fluids, wall, closure, watertight, figures["trapped_volume_m3"]),
        *_required(spec.require, fluids, wall, figures),
    )
    return Report(**figures, certificate=certificate, certified=all(c.passed for c in certificate))


def _fluid(fluid: Fluid, channel: Channel, scale_m: float) -> FluidFigures:
    wetted = float(fluid.mesh.areas[fluid.patch <= 1].sum())
    volume = fluid.mesh.volume
    return FluidFigures(
        volume_m3=volume,
        interface_area_m2=float(fluid.mesh.areas[fluid.patch == INTERFACE].sum()),
        wetted_area_m2=wetted,
        hydraulic_diameter_m=4 * volume / wetted,
        components=fluid.components,
        dead_end_fraction=channel.dead_end_fraction,
        min_channel_m=channel.min_width * scale_m,
        passage_m=channel.passage * scale_m,
        filled_fraction=fluid.filled_m3 / (volume + fluid.filled_m3),
        inlet_to_outlet_connected=channel.connected,
    )


def _channel(domain: Domain, surface: Surface, body: Body, asked: Wall, outside: bool, sign: int) -> Channel:
    """Within the envelope: headers are plain pipes."""
    shell = 0.0 if outside else body.shell_m / domain.scale_m
    room = (sign * surface.distance > half_on_grid(surface, asked)) & (surface.depth > shell)
    return measure_channel(domain, room, surface.grid, sign)


def _wall(domain: Domain, body: Body, asked: Wall, seed: int) -> WallFigures:
    points, thickness = wall_samples(body, seed)
    over = thickness / (thickness_at(asked, (points - domain.offset_m) / domain.scale_m) * domain.scale_m)
    (low, high), (least, most) = (np.quantile(values, (0.01, 0.99)) for values in (thickness, over))
    return WallFigures(
        thickness_m=body.wall_m,
        thickness_min_m=float(low),
        thickness_max_m=float(high),
        over_asked_min=float(least),
        over_asked_max=float(most),
    )


def _curvature(
    surface: Surface, volume: float, fluids: tuple[FluidFigures, FluidFigures], sites: int
) -> CurvatureFigures:
    curvature = np.abs(_inner(mean_curvature(surface.mesh.vertices, surface.mesh.faces)))
    median, p90, p99 = (float(q) for q in np.quantile(curvature, (0.5, 0.9, 0.99)))
    diameter = sum(f.hydraulic_diameter_m for f in fluids) / 2
    return CurvatureFigures(
        abs_median_per_m=median,
        abs_p90_per_m=p90,
        abs_p99_per_m=p99,
        abs_median_times_dh=median * diameter,
        rms_times_cell=float(np.sqrt((curvature**2).mean())) * (volume / sites) ** (1 / 3),
    )


def _inner(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Values where they are defined; zero where they are nowhere (a mesh that is all border)."""
    finite = values[np.isfinite(values)]
    return finite if len(finite) else np.zeros(1)


def _best_direction(body: Body) -> BuildDirection:
    direction, overhang = best_build_direction(body.solid)
    x, y, z = (float(v) for v in direction.round(6))
    return BuildDirection(direction=(x, y, z), overhang_area_fraction=overhang)


def _trapped(solid: TriangleMesh) -> float:
    """Volume of the cavities inside the solid that no opening reaches: its inner shells."""
    n = len(solid.vertices)
    edges = np.concatenate([solid.faces[:, [0, 1]], solid.faces[:, [1, 2]]])
    links = coo_array((np.ones(len(edges)), tuple(edges.T)), shape=(n, n))
    _, label = connected_components(links, directed=False)
    shells = label[solid.faces[:, 0]]
    volumes = [solid.part(shells == k).volume for k in np.unique(shells)]
    return float(-sum(v for v in volumes if v < 0))


def _certificate(
    body: Body,
    fluids: FluidsFigures,
    wall: WallFigures,
    closure: float,
    watertight: dict[str, bool],
    trapped: float,
) -> tuple[Check, ...]:
    both = ((name, getattr(fluids, name)) for name in ("hot", "cold"))
    lines = [
        _check("common volume of hot and cold, m³", body.leak_m3, "= 0", body.leak_m3 == 0),
        _check("least wall thickness over asked", wall.over_asked_min, "≥ 0.95", wall.over_asked_min >= 0.95),
        _check("greatest wall thickness over asked", wall.over_asked_max, "≤ 1.05", wall.over_asked_max <= 1.05),
        _check("volume closure error", closure, "≤ 0.002", closure <= 0.002),
        _check("meshes not closed", sum(not v for v in watertight.values()), "= 0", all(watertight.values())),
        _check("trapped volume, m³", trapped, "= 0", trapped == 0),
        _check("loose solid left out, m³", body.dropped_m3, "< 0.1 % of the solid",
              body.dropped_m3 < 1e-3 * body.solid.volume),
    ]  # fmt: skip
    for name, fluid in both:
        joined = fluid.inlet_to_outlet_connected
        lines += [
            _check(f"{name}: components", fluid.components, "= 1", fluid.components == 1),
            _check(f"{name}: joined from inlets to outlets", joined, "= 1", joined),
            _check(f"{name}: narrowest passage, m", fluid.passage_m, "> 0", fluid.passage_m > 0),
            _check(f"{name}: dead-end share", fluid.dead_end_fraction, "≤ 0.25", fluid.dead_end_fraction <= 0.25),
        ]
    return tuple(lines)


def _required(
    require: RequireSpec, fluids: FluidsFigures, wall: WallFigures, figures: dict[str, Any]
) -> tuple[Check, ...]:
    """The specification's own requirements, as lines of the certificate."""
    both = (fluids.hot, fluids.cold)
    least = (
        ("least channel, m", require.min_channel_m, min(f.min_channel_m for f in both)),
        ("narrowest passage, m", require.min_passage_m, min(f.passage_m for f in both)),
        ("least wall, m", require.min_wall_m, wall.thickness_min_m),
        ("area density, 1/m", require.min_area_density_per_m, figures["area_density_per_m"]),
    )
    most = (
        ("dead-end share", require.max_dead_end_fraction, max(f.dead_end_fraction for f in both)),
        ("overhang share", require.max_overhang_fraction, figures["overhang_area_fraction"]),
        ("solid share", require.max_solid_fraction, figures["solid_volume_fraction"]),
    )
    return (
        *(
            _check(f"required: {name}", v, f"≥ {limit:.4g}", v >= limit)
            for name, limit, v in least
            if limit is not None
        ),
        *(_check(f"required: {name}", v, f"≤ {limit:.4g}", v <= limit) for name, limit, v in most if limit is not None),
    )


def _check(name: str, value: float, limit: str, passed: bool) -> Check:
    return Check(name=name, value=float(value), limit=limit, passed=bool(passed))
