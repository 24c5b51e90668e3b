"""The certificate: one line a figure, with its limit and whether it is met."""

from __future__ import annotations

from dualms.measure.figures import (
    Figures,
    FluidsFigures,
    OverhangFigures,
    SeparationFigures,
    WallFigures,
)
from dualms.spec import RequireSpec

WALL_TOLERANCE = 0.05
CLOSURE = 0.002
DEAD_ENDS = 0.25
LOOSE = 1e-3  # of the solid


class Check(Figures):
    """One line of the certificate."""

    name: str
    value: float
    limit: str
    passed: bool


class Measured(Figures):
    """What is certified."""

    fluids: FluidsFigures
    wall: WallFigures
    separation: SeparationFigures
    overhang: OverhangFigures
    common_volume_m3: float
    volume_closure_error: float
    trapped_volume_m3: float
    loose_volume_m3: float
    solid_volume_m3: float
    meshes_not_closed: int
    crossing_triangles: int
    solid_faces: int
    overhang_area_fraction: float
    solid_volume_fraction: float
    area_density_per_m: float


def certificate(measured: Measured, max_faces: int, require: RequireSpec) -> tuple[Check, ...]:
    """Every line: what any body must meet, then what this specification requires."""
    return (*_sound(measured, max_faces), *_required(measured, require))


def _sound(m: Measured, max_faces: int) -> list[Check]:
    wall, walk = m.wall, m.separation
    lines = [
        _zero("hot and cold: common volume by booleans, m³", m.common_volume_m3),
        _zero(f"hot and cold: ways between them at voxels of {1e3 * walk.voxel_m:.3g} mm", walk.hot_to_cold),
        _zero("ways out but through a port", walk.to_outside),
        _zero("ports that a walk from their fluid's first misses", walk.ports_apart),
        _least("wall thickness over asked, 1st percentile", wall.over_asked_min, 1 - WALL_TOLERANCE),
        _most("wall thickness over asked, 99th percentile", wall.over_asked_max, 1 + WALL_TOLERANCE),
        _positive("least wall, m", wall.thickness_min_m),
        _most("volume closure error", m.volume_closure_error, CLOSURE),
        _zero("meshes not closed", m.meshes_not_closed),
        _zero("triangles that cross others, in single precision", m.crossing_triangles),
        _most("triangles of the solid", m.solid_faces, max_faces),
        _zero("powder trapped in closed cavities, m³", m.trapped_volume_m3),
        _most("loose solid left out, m³", m.loose_volume_m3, LOOSE * m.solid_volume_m3),
        Check(name="overhang below 45°, m²", value=m.overhang.area_m2, limit="stated", passed=True),
    ]
    for name, fluid in (("hot", m.fluids.hot), ("cold", m.fluids.cold)):
        joined = fluid.inlet_to_outlet_connected
        lines += [
            Check(name=f"{name}: parts", value=fluid.components, limit="= 1", passed=fluid.components == 1),
            Check(name=f"{name}: joined from inlets to outlets", value=joined, limit="= 1", passed=joined),
            _positive(f"{name}: narrowest passage, m", fluid.passage_m),
            _positive(f"{name}: least channel, m", fluid.min_channel_m),
            _most(f"{name}: dead-end volume, m³", fluid.dead_end_volume_m3, DEAD_ENDS * fluid.volume_m3),
        ]
    return lines


def _required(m: Measured, require: RequireSpec) -> list[Check]:
    both = (m.fluids.hot, m.fluids.cold)
    least = (
        ("least channel, m", require.min_channel_m, min(f.min_channel_m for f in both)),
        ("narrowest passage, m", require.min_passage_m, min(f.passage_m for f in both)),
        ("least wall, m", require.min_wall_m, m.wall.thickness_min_m),
        ("area density, 1/m", require.min_area_density_per_m, m.area_density_per_m),
    )
    most = (
        ("dead-end share", require.max_dead_end_fraction, max(f.dead_end_fraction for f in both)),
        ("overhang share", require.max_overhang_fraction, m.overhang_area_fraction),
        ("solid share", require.max_solid_fraction, m.solid_volume_fraction),
    )
    return [
        *(_least(f"required: {name}", value, limit) for name, limit, value in least if limit is not None),
        *(_most(f"required: {name}", value, limit) for name, limit, value in most if limit is not None),
    ]


def _zero(name: str, value: float) -> Check:
    return Check(name=name, value=float(value), limit="= 0", passed=value == 0)


def _positive(name: str, value: float) -> Check:
    return Check(name=name, value=value, limit="> 0", passed=value > 0)


def _least(name: str, value: float, limit: float) -> Check:
    return Check(name=name, value=value, limit=f"≥ {limit:.4g}", passed=value >= limit)


def _most(name: str, value: float, limit: float) -> Check:
    return Check(
        name=name,
        value=value,
        limit=f"≤ {limit:,}" if isinstance(limit, int) else f"≤ {limit:.4g}",
        passed=value <= limit,
    )
