"""Designs to solve for, and the figures of a surface; lengths in units of the domain's longest side."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from skimage.measure import marching_cubes

from dualms.cut.partition import max_cut
from dualms.domain import Domain
from dualms.field import minimal, topology
from dualms.field.diffusion import diffuse
from dualms.field.field import Field, History
from dualms.field.interface import continued, distance_of
from dualms.field.lattice import Lattice, typical_gap
from dualms.field.solve import solve_field
from dualms.flow import flow_field
from dualms.graph.graph import site_graph
from dualms.grid import Grid
from dualms.measure.curvature import mean_curvature, vertex_areas
from dualms.ports import resolve_ports
from dualms.progress import Silent
from dualms.reading import read_domain_mesh
from dualms.skeletons import Skeletons, skeletons
from dualms.spec import DistilledField, NeuralField, PhaseField, Spec, Unit

MEASURED_AT = 256
STRIP = 4 / 128
"""Depth of the strip along the wall that is left out of the curvature figures."""

Row = dict[str, Any]


@dataclass(frozen=True)
class Case:
    """A domain and its skeletons."""

    name: str
    domain: Domain
    skeletons: Skeletons
    sites: int
    seed: int


def prepared(file: Path, spec: Spec) -> Case:
    """Everything before the field."""
    mesh = read_domain_mesh(file, spec.units)
    units: Unit = spec.units or mesh.units
    domain = Domain.from_mesh(mesh, resolve_ports(mesh, spec.fluids, units))
    graph = site_graph(domain, flow_field(domain, spec.flow, units.metres), spec.graph, spec.seed)
    bones = skeletons(domain, graph, max_cut(graph, spec.partition, spec.seed))
    return Case(file.stem, domain, bones, spec.graph.sites, spec.seed)


def solved(case: Case, spec: PhaseField | NeuralField | DistilledField) -> tuple[Field, Row]:
    """The field, and the time that it took."""
    began, busy = time.perf_counter(), time.process_time()
    field = solve_field(case.domain, case.skeletons, spec, case.seed, "cpu", None, Silent())
    return field, {"seconds": time.perf_counter() - began, "cpu_seconds": time.process_time() - busy}


def figures(case: Case, field: Field, level: int = MEASURED_AT) -> Row:
    """Area, curvature and topology of a field's surface, sampled on a grid."""
    lattice = Lattice.of(case.domain, case.skeletons, level)
    values = field.on(lattice.grid)  # once: a network takes minutes
    found: Row = {
        **mesh_figures(case, *level_set_of(values, lattice.grid)),
        "pieces": topology.component_counts(values > 0, lattice.inside),
        "euler_start_solved": None,
        "euler_solved": None,
    }
    if "resolution" in field.history.columns:
        solved_on = Lattice.of(case.domain, case.skeletons, int(field.history.column("resolution")[-1]))
        found |= euler(case, solved_on, field.on(solved_on.grid), "_solved")
    return found | euler(case, lattice, values)


def mesh_figures(case: Case, vertices: np.ndarray, faces: np.ndarray) -> Row:
    """Area and curvature of a mesh's part in the domain."""
    depth = case.domain.signed_distance(vertices)
    faces = faces[(depth[faces] > 0).all(axis=1)]
    h, areas = mean_curvature(vertices, faces), vertex_areas(vertices, faces)
    density = float(areas.sum()) / case.domain.volume
    inner = (areas > 0) & (depth > STRIP) & np.isfinite(h)
    absolute = np.abs(h[inner])
    rms = math.sqrt(float(np.average(h[inner] ** 2, weights=areas[inner])))
    return {
        "area_density": density,
        "median_abs_H": float(np.median(absolute)),
        "p90_abs_H": float(np.quantile(absolute, 0.9)),
        "p99_abs_H": float(np.quantile(absolute, 0.99)),
        "median_H_times_Dh": float(np.median(absolute)) * 2 / density,
        "rms_H_scaled": rms * (case.domain.volume / case.sites) ** (1 / 3),
    }


def euler(case: Case, lattice: Lattice, values: np.ndarray, suffix: str = "") -> Row:
    """Euler characteristics of both fluids' voxels, of the equidistant surface and of a field's values."""
    start = lattice.colouring(lattice.nearer_to_hot(case.skeletons) - np.float32(0.5))
    return {
        name + suffix: tuple(topology.euler_characteristic(part & lattice.inside) for part in (hot, ~hot))
        for name, hot in (("euler_start", start), ("euler", values > 0))
    }


def minimal_at(case: Case, level: int) -> Field:
    """The minimal end on exactly one grid, whatever it costs."""
    log: list[list[float]] = []

    def listen(step: int, steps: int, energy: float, kept: int) -> None:
        log.append([float(len(log)), float(level), energy])

    gap = typical_gap(case.domain, case.skeletons)
    lattice = Lattice.of(case.domain, case.skeletons, level)
    away = lattice.distances(case.skeletons)
    u, _, eps = diffuse(lattice, away, gap, 1.0, listen, sealed=True)
    samples = continued(distance_of(u, eps), lattice.inside, lattice.grid)
    samples = minimal.lower_energy(lattice, samples, away, gap, minimal.DESCENT_ITERATIONS, listen)
    samples = minimal.straightened(case.domain, lattice, samples, gap, minimal.NEWTON_STEPS, listen)
    return Field(samples, "phase-field", History(("iteration", "resolution", "energy"), np.array(log)), "cpu")


def level_set(field: Field, grid: Grid) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces of the zero set on a grid, unit-cube frame; it may end at the grid's outermost voxels."""
    return level_set_of(field.on(grid), grid)


def level_set_of(values: np.ndarray, grid: Grid) -> tuple[np.ndarray, np.ndarray]:
    """The same from the values (nx, ny, nz) on the grid."""
    vertices, faces, _, _ = marching_cubes(values, 0.0)
    return np.asarray(vertices * grid.spacing + grid.origin, dtype=float), faces.astype(np.int64)
