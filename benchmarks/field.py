"""The field solvers: classical surfaces, area control, the network's step, growth with the grid.

    python benchmarks/field.py classical                       P, G, D, I-WP from their skeletons, against exact areas
    python benchmarks/field.py control DOMAIN SPEC             equidistant to minimal in one envelope
    python benchmarks/field.py compare DOMAIN SPEC             phase field, neural and distilled in one envelope
    python benchmarks/field.py ablate DOMAIN SPEC              the paper's ablations with the network, at a CPU's budget
    python benchmarks/field.py step                            one training step, ours and a straightforward one
    python benchmarks/field.py growth DOMAIN SPEC              time and memory at grids 64, 96, 128, 192, 256

Each prints a table and writes ``benchmarks/results/field/MODE.json``. Curvature is that of
:mod:`dualms.measure.curvature`, a strip of four voxels along the wall left out, on a surface sampled at 256.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import platform
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from skimage.measure import marching_cubes

from dualms.cut.partition import max_cut
from dualms.domain import Domain
from dualms.field import topology
from dualms.field.field import Field
from dualms.field.phase_field import solve_phase_field
from dualms.field.solve import solve_field
from dualms.flow import flow_field
from dualms.graph.graph import site_graph
from dualms.grid import Grid
from dualms.measure.curvature import away_from_boundary, mean_curvature, vertex_areas
from dualms.ports import resolve_ports
from dualms.progress import Silent
from dualms.reading import read_domain_mesh
from dualms.skeletons import Skeletons, skeletons
from dualms.spec import DistilledField, GraphSpec, NeuralField, PhaseField, Spec, Unit

RESULTS = Path(__file__).parent / "results" / "field"
EXACT_AREA = {"P": 2.3451028840, "G": 3.0914437988, "D": 3.8377847135, "I-WP": 2 * math.sqrt(3)}
PAPER_AREA = {"P": 3.79 / 3.79, "G": 4.72 / 4.99, "I-WP": 5.63 / 5.73}  # theirs over the classical one, Table 2
PAPER_STEPS = 51_200
STRIP_VOXELS = 4

Row = dict[str, Any]


def main() -> int:
    """Run one mode."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("mode", choices=list(MODES), nargs="?", default="classical")
    parser.add_argument("domain", nargs="?", type=Path)
    parser.add_argument("spec", nargs="?", type=Path)
    parser.add_argument("--grid", type=int, default=128)
    parser.add_argument("--minimality", type=float, nargs="+", default=[0.0, 0.25, 0.5, 0.75, 1.0])
    parser.add_argument("--surfaces", nargs="+", default=list(EXACT_AREA))
    parser.add_argument("--points", type=int, default=4096)
    parser.add_argument("--one", type=int, help=argparse.SUPPRESS)
    given = parser.parse_args()
    rows = MODES[given.mode](given)
    if given.one is None:
        show(rows)
        RESULTS.mkdir(parents=True, exist_ok=True)
        machine = {"machine": platform.machine(), "cores": os.cpu_count(), "load": round(os.getloadavg()[0], 1)}
        path = RESULTS / f"{given.mode}.json"
        path.write_text(
            json.dumps({"command": [Path(a).name for a in sys.argv[1:]], **machine, "rows": rows}, indent=1) + "\n"
        )
    return 0


def classical(given: argparse.Namespace) -> list[Row]:
    """Two cells along each side; the area of one cell's box in the middle, far from the cube's walls."""
    rows = []
    for name in given.surfaces:
        hot, cold = (sampled(net, 0.5) for net in NETS[name]())
        net = SimpleNamespace(hot=hot, cold=cold)
        for minimality in given.minimality:
            began = time.perf_counter()
            field = solve_phase_field(cube(), net, given.grid, minimality, Silent())  # type: ignore[arg-type]
            seconds = time.perf_counter() - began
            count = 192
            grid = Grid(np.full(3, 0.25), 0.5 / count, (count + 1,) * 3)
            vertices, faces = level_set(field, grid)
            inner = away_from_boundary(vertices, faces, STRIP_VOXELS / given.grid)
            # In units of the cell, whose side is 0.5.
            h, areas = mean_curvature(vertices, faces)[inner] * 0.5, vertex_areas(vertices, faces)
            area = float(areas.sum()) / 0.25
            rows.append(
                {
                    "surface": name,
                    "minimality": minimality,
                    "area": area,
                    "exact": EXACT_AREA[name],
                    "error_%": 100 * (area / EXACT_AREA[name] - 1),
                    "paper_error_%": 100 * (PAPER_AREA[name] - 1) if name in PAPER_AREA else None,
                    "median_abs_H": float(np.nanmedian(np.abs(h))),
                    "max_abs_H": float(np.nanmax(np.abs(h))),
                    "seconds": seconds,
                }
            )
            told(rows[-1])
    return rows


def control(given: argparse.Namespace) -> list[Row]:
    """The trade-off of the one parameter."""
    case = prepared(given)
    return [
        told(figures(case, PhaseField(method="phase-field", resolution=given.grid, minimality=m)))
        for m in given.minimality
    ]


def compare(given: argparse.Namespace) -> list[Row]:
    """The three methods."""
    case = prepared(given)
    return [
        told(figures(case, PhaseField(method="phase-field", resolution=given.grid))),
        told(figures(case, NeuralField(method="neural", preset="cpu"))),
        told(figures(case, DistilledField(method="distilled", resolution=given.grid))),
    ]


def ablate(given: argparse.Namespace) -> list[Row]:
    """Smoothness loss off; noise 0, 0.05, 0.08; weight a of transverse edges 1 and 5 (paper, section 6.1, appendix)."""
    spec = Spec.model_validate_json(given.spec.read_text())
    rows = []
    for name, weight, changes in (
        ("as published", 5.0, {}),
        ("a = 1", 1.0, {}),
        ("no smoothness loss", 5.0, {"smoothness_weight": 0.0}),
        ("noise 0", 5.0, {"noise_std": 0.0}),
        ("noise 0.05", 5.0, {"noise_std": 0.05}),
        ("noise 0.08", 5.0, {"noise_std": 0.08}),
    ):
        graph = GraphSpec(preset="paper", sites=spec.graph.sites, transverse_weight=weight)
        case = prepared(given, spec.model_copy(update={"graph": graph}))
        method = NeuralField.model_validate({"method": "neural", "preset": "cpu", "connect": False, **changes})
        rows.append(told({"ablation": name, **figures(case, method)}))
    return rows


def step(given: argparse.Namespace) -> list[Row]:
    """Seconds of one step at the same batch; the straightforward one differentiates twice."""
    import torch

    from dualms.field.lattice import Lattice
    from dualms.field.objectives import PaperLoss, Samples
    from dualms.field.training import Training

    net = SimpleNamespace(hot=sampled(NETS["P"]()[0], 1.0), cold=sampled(NETS["P"]()[1], 1.0))
    lattice = Lattice.of(cube(), net, 64)  # type: ignore[arg-type]
    device = torch.device("cpu")
    rows: list[Row] = []
    for gradient in ("exact", "secants"):
        spec = NeuralField(method="neural", points=given.points, gradient=gradient)
        training = Training(spec, [(100, PaperLoss(spec, Samples.of(lattice, net, device)))], 0, device)  # type: ignore[arg-type]
        times = []
        for _ in range(6):
            began = time.perf_counter()
            training.advance()
            times.append(time.perf_counter() - began)
        rows.append({"gradient": gradient, "points": given.points, "seconds": sorted(times[1:])[2]})
    for row in rows:
        row["ratio"] = rows[0]["seconds"] / row["seconds"]
        row["paper_schedule_days"] = row["seconds"] * 32_768 / given.points * PAPER_STEPS / 86_400
    return rows


def growth(given: argparse.Namespace) -> list[Row]:
    """Each grid in a process of its own, so that its peak memory is its own."""
    if given.one is not None:
        case = prepared(given)
        rows = []
        for minimality in (0.5, 1.0):
            began = time.perf_counter()
            solve_phase_field(case.domain, case.skeletons, given.one, minimality, Silent())
            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
            rows.append(
                {"grid": given.one, "minimality": minimality, "seconds": time.perf_counter() - began, "peak_GB": peak}
            )
        print(json.dumps(rows))
        return rows
    rows = []
    for grid in (64, 96, 128, 192, 256):
        command = [sys.executable, __file__, "growth", str(given.domain), str(given.spec), "--one", str(grid)]
        rows += json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
    for minimality in (0.5, 1.0):
        own = [row for row in rows if row["minimality"] == minimality]
        slope = np.polyfit(np.log([r["grid"] for r in own[1:]]), np.log([r["seconds"] for r in own[1:]]), 1)[0]
        for row in own:
            row["exponent"] = float(slope)
    return rows


def prepared(given: argparse.Namespace, spec: Spec | None = None) -> SimpleNamespace:
    """Domain, skeletons and number of sites of a specification."""
    spec = spec or Spec.model_validate_json(given.spec.read_text())
    mesh = read_domain_mesh(given.domain, spec.units)
    units: Unit = spec.units or mesh.units
    domain = Domain.from_mesh(mesh, resolve_ports(mesh, spec.fluids, units))
    graph = site_graph(domain, flow_field(domain, spec.flow, units.metres), spec.graph, spec.seed)
    sampled_skeletons: Skeletons = skeletons(domain, graph, max_cut(graph, spec.partition, spec.seed))
    return SimpleNamespace(domain=domain, skeletons=sampled_skeletons, sites=spec.graph.sites, seed=spec.seed)


def figures(case: SimpleNamespace, spec: PhaseField | NeuralField | DistilledField) -> Row:
    """Solve and measure; lengths in units of the domain's longest side, with the scale-free figures beside them."""
    began = time.perf_counter()
    field = solve_field(case.domain, case.skeletons, spec, case.seed, "cpu", None, Silent())
    seconds = time.perf_counter() - began
    grid = case.domain.grid(256)
    vertices, faces = level_set(field, grid)
    depth = grid.sample(case.domain.depth(grid, 0.1), vertices)
    faces = faces[(depth[faces] > 0).all(axis=1)]
    used = np.zeros(len(vertices), dtype=bool)
    used[faces] = True
    h, areas = mean_curvature(vertices, faces), vertex_areas(vertices, faces)
    density = float(areas.sum()) / case.domain.volume
    inner = used & (depth > STRIP_VOXELS / 128) & np.isfinite(h)
    absolute = np.abs(h[inner])
    rms = math.sqrt(float(np.average(h[inner] ** 2, weights=areas[inner])))
    inside, hot = case.domain.inside(grid), field.on(grid) > 0
    return {
        "method": spec.method,
        "minimality": getattr(spec, "minimality", None),
        "area_density": density,
        "median_abs_H": float(np.median(absolute)),
        "p90_abs_H": float(np.quantile(absolute, 0.9)),
        "p99_abs_H": float(np.quantile(absolute, 0.99)),
        "median_H_times_Dh": float(np.median(absolute)) * 2 / density,
        "rms_H_scaled": rms * (case.domain.volume / case.sites) ** (1 / 3),
        "pieces": topology.component_counts(hot, inside),
        "euler": (topology.euler_characteristic(hot & inside), topology.euler_characteristic(~hot & inside)),
        "seconds": seconds,
    }


def level_set(field: Field, grid: Grid) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces of the zero set on a grid, unit-cube frame."""
    vertices, faces, _, _ = marching_cubes(field.on(grid), 0.0)
    return np.asarray(vertices * grid.spacing + grid.origin, dtype=float), faces.astype(np.int64)


def cube() -> Domain:
    """The unit cube."""
    corners = np.array([(x, y, z) for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = np.array([f for a, b, c, d in quads for f in ((a, b, c), (a, c, d))], dtype=np.int64)
    return Domain(corners, faces, 1.0, np.zeros(3), ())


def links(nodes: np.ndarray, length: float) -> np.ndarray:
    """(K, 2, 3) segments between nodes of one cell and their neighbours at a distance, cell side 1."""
    shifts = np.array([(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)])
    everywhere = (nodes[None] + shifts[:, None]).reshape(-1, 3)
    found = [(a, b) for a in nodes for b in everywhere[np.abs(np.linalg.norm(everywhere - a, axis=1) - length) < 1e-6]]
    return np.array(found)


def gyroid_nets() -> list[np.ndarray]:
    """Both srs nets: nodes where sin x cos y + sin y cos z + sin z cos x is ±3/2, three neighbours at √2/4."""
    nodes = np.array([(x, y, z) for x in range(8) for y in range(8) for z in range(8)]) / 8
    s, c = np.sin(2 * np.pi * nodes), np.cos(2 * np.pi * nodes)
    g = s[:, 0] * c[:, 1] + s[:, 1] * c[:, 2] + s[:, 2] * c[:, 0]
    return [links(nodes[np.abs(g - level) < 1e-9], math.sqrt(2) / 4) for level in (1.5, -1.5)]


def diamond_nets() -> list[np.ndarray]:
    """A diamond net and its copy shifted by half a cell along the diagonal."""
    centred = np.array([(0, 0, 0), (0, 0.5, 0.5), (0.5, 0, 0.5), (0.5, 0.5, 0)])
    nodes = np.concatenate([centred, centred + 0.25])
    return [links(nodes + shift, math.sqrt(3) / 4) for shift in (0.0, 0.5)]


def cubic_nets() -> list[np.ndarray]:
    """Two simple cubic nets."""
    return [links(np.full((1, 3), shift), 1.0) for shift in (0.0, 0.5)]


def package_nets() -> list[np.ndarray]:
    """The body-centred net and the net of its octahedral holes."""
    centred = np.array([(0, 0, 0), (0.5, 0.5, 0.5)])
    holes = np.array([(0.5, 0, 0), (0, 0.5, 0), (0, 0, 0.5), (0.5, 0.5, 0), (0.5, 0, 0.5), (0, 0.5, 0.5)])
    return [links(centred, math.sqrt(3) / 2), links(holes, 0.5)]


NETS: dict[str, Callable[[], list[np.ndarray]]] = {
    "P": cubic_nets,
    "G": gyroid_nets,
    "D": diamond_nets,
    "I-WP": package_nets,
}


def sampled(segments: np.ndarray, cell: float) -> np.ndarray:
    """Samples at 1/256 of a net repeated over the unit cube."""
    t = np.linspace(0, 1, math.ceil(256 * cell) + 1)[:, None]
    one = np.concatenate([a * (1 - t) + b * t for a, b in segments])
    count = round(1 / cell)
    shifts = np.array(
        [(x, y, z) for x in range(-1, count + 1) for y in range(-1, count + 1) for z in range(-1, count + 1)]
    )
    points = ((one[None] + shifts[:, None]) * cell).reshape(-1, 3)
    points = points[((points > -1e-9) & (points < 1 + 1e-9)).all(axis=1)]
    return np.unique(np.round(points, 9), axis=0)


def told(row: Row) -> Row:
    """The row, once it is on the error stream for whoever waits."""
    print(json.dumps(row), file=sys.stderr, flush=True)
    return row


def show(rows: list[Row]) -> None:
    """Print a table."""
    names = list(rows[0])
    table = [names, *([_text(row[name]) for name in names] for row in rows)]
    widths = [max(len(line[k]) for line in table) for k in range(len(names))]
    for line in table:
        print("  ".join(cell.rjust(width) for cell, width in zip(line, widths, strict=True)))


def _text(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else "-" if value is None else str(value)


MODES: dict[str, Callable[[argparse.Namespace], list[Row]]] = {
    "classical": classical,
    "control": control,
    "compare": compare,
    "ablate": ablate,
    "step": step,
    "growth": growth,
}


if __name__ == "__main__":
    sys.exit(main())
