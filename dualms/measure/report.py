"""The report: every figure of a design with its unit in its name, the certificate, timings and provenance."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from dualms.body.body import Body, Fluid
from dualms.body.patches import INTERFACE
from dualms.body.thickness import Wall, thickness_at
from dualms.body.walls import half_on_grid, wall_share
from dualms.cut.partition import Partition
from dualms.domain import Domain
from dualms.field.field import Field
from dualms.measure.certificate import Check, Measured, certificate
from dualms.measure.channels import Channel, measure_channel
from dualms.measure.figures import (
    BuildDirection,
    CurvatureFigures,
    Figures,
    FluidFigures,
    FluidsFigures,
    OverhangFigures,
    PartitionFigures,
    SeparationFigures,
    WallFigures,
)
from dualms.measure.printing import (
    best_build_direction,
    overhang_fraction,
    trapped_volume,
    wall_overhang,
    wall_samples,
)
from dualms.measure.provenance import Provenance, provenance
from dualms.measure.separation import separation
from dualms.spec import Spec
from dualms.surface import Surface


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
    separation: SeparationFigures
    watertight: dict[str, bool]
    faces: dict[str, int]
    trapped_volume_m3: float
    overhang_area_fraction: float
    overhang: OverhangFigures
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

    def with_files(self, sha256: dict[str, str]) -> Report:
        """The report with the hashes of the files that go with it."""
        known = self.provenance.model_copy(update={"files_sha256": self.provenance.files_sha256 | sha256})
        return self.model_copy(update={"provenance": known})


def make_report(
    domain: Domain,
    domain_sha256: str,
    partition: Partition,
    edges: int,
    field: Field,
    surface: Surface,
    curvature: NDArray[np.float64],
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
    curvature
        (V,) mean curvature at the vertices of the surface's mesh, 1/m.
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
    wall = _wall(domain, body, asked, spec.seed)
    solid_volume = body.solid.volume
    filled = solid_volume + body.dropped_m3 + hot.volume_m3 + cold.volume_m3
    watertight = {
        "solid": body.solid.is_closed,
        "fluid_hot": body.hot.mesh.is_closed,
        "fluid_cold": body.cold.mesh.is_closed,
    }
    up = np.array(spec.build_direction, dtype=float)
    walk = separation(body, surface.grid.spacing * domain.scale_m)
    overhang = overhang_fraction(body.solid, up)
    under_wall, under_wall_share = wall_overhang(body, up)
    measured = Measured(
        fluids=FluidsFigures(hot=hot, cold=cold),
        wall=wall,
        separation=walk,
        overhang=OverhangFigures(
            area_m2=overhang * body.solid.area, wall_area_m2=under_wall, wall_fraction=under_wall_share
        ),
        common_volume_m3=body.leak_m3,
        volume_closure_error=abs(filled / body.outline_m3 - 1),
        trapped_volume_m3=trapped_volume(body.solid),
        loose_volume_m3=body.dropped_m3,
        solid_volume_m3=solid_volume,
        meshes_not_closed=sum(not closed for closed in watertight.values()),
        crossing_triangles=body.crossing + body.hot.crossing + body.cold.crossing,
        solid_faces=len(body.solid.faces),
        overhang_area_fraction=overhang,
        solid_volume_fraction=solid_volume / volume,
        area_density_per_m=area / volume,
    )
    lines = certificate(measured, spec.surface.max_faces, spec.require)
    return Report(
        units=units,
        scale_m=domain.scale_m,
        domain_volume_m3=volume,
        area_m2=area,
        area_density_per_m=measured.area_density_per_m,
        mean_curvature=_curvature(curvature, volume, (hot, cold), len(partition.labels)),
        wall=wall,
        shell_thickness_m=body.shell_m,
        solid_volume_m3=solid_volume,
        solid_volume_fraction=measured.solid_volume_fraction,
        wall_volume_fraction=wall_share(surface, half_on_grid(surface, asked)),
        volume_closure_error=measured.volume_closure_error,
        fluids=measured.fluids,
        leak_free=body.leak_m3 == 0.0 and walk.hot_to_cold == 0,
        separation=walk,
        watertight=watertight,
        faces={
            "solid": len(body.solid.faces),
            "fluid_hot": len(body.hot.mesh.faces),
            "fluid_cold": len(body.cold.mesh.faces),
        },
        trapped_volume_m3=measured.trapped_volume_m3,
        overhang_area_fraction=overhang,
        overhang=measured.overhang,
        best_build_direction=_best_direction(body),
        partition=PartitionFigures(
            method=partition.method,
            sites=len(partition.labels),
            edges=edges,
            cut_weight=partition.cut_weight,
            total_weight=partition.total_weight,
            upper_bound=partition.upper_bound,
            iterations=partition.iterations,
            history=tuple((float(a), float(b)) for a, b in partition.history),
        ),
        certificate=lines,
        certified=all(line.passed for line in lines),
        timings_s={},
        provenance=provenance(spec, domain_sha256, field),
        evaluation=None,
    )


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
        dead_end_volume_m3=channel.dead_end_fraction * volume,
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
    found: NDArray[np.float64], volume: float, fluids: tuple[FluidFigures, FluidFigures], sites: int
) -> CurvatureFigures:
    curvature = np.abs(_inner(found))
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
