"""The field solvers against closed forms, the paper, and each other.

    python benchmarks/field.py classical                     P, G, D, I-WP from their skeletons, against exact areas;
                                                             with --methods distilled neural by networks
    python benchmarks/field.py minimal DOMAIN SPEC …         the minimal end: curvature, area density, topology, by seed
    python benchmarks/field.py convergence DOMAIN SPEC       the same on three grids
    python benchmarks/field.py control DOMAIN SPEC           equidistant to minimal in one envelope
    python benchmarks/field.py smoothing DOMAIN SPEC         against Laplacian smoothing (paper, Table 1)
    python benchmarks/field.py compare DOMAIN SPEC           phase field and distilled, or other --methods
    python benchmarks/field.py ablate DOMAIN SPEC            the paper's ablations with the network, at a CPU's budget
    python benchmarks/field.py ratio DOMAIN SPEC             against a transcription of the paper's training loop
    python benchmarks/field.py growth DOMAIN SPEC            time and memory at grids 64 to 384

Each prints a table and writes ``benchmarks/results/field/MODE.json``, some with a picture coloured by mean curvature.
Curvature is that of :mod:`dualms.measure.curvature` on a surface sampled at 256 (ablations at 128), a strip of 4/128
along the wall left out; area density is in 1 / longest side.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path

import numpy as np
import trimesh
from field_cases import MEASURED_AT, Case, Row, figures, level_set, mesh_figures, minimal_at, prepared, solved
from field_nets import NETS
from field_pictures import by_curvature

from dualms.spec import DistilledField, GraphSpec, NeuralField, PhaseField, Spec

RESULTS = Path(__file__).parent / "results" / "field"
SMOOTHING_ROUNDS = (0, 3, 10, 30)
NETWORK_MEASURED_AT = 128  # where networks are compared with networks: at 256 one takes minutes


def main() -> int:
    """Run one mode."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter, allow_abbrev=False
    )
    parser.add_argument("mode", choices=list(MODES), nargs="?", default="classical")
    parser.add_argument("files", nargs="*", type=Path, help="pairs of a domain and its specification")
    parser.add_argument("--grid", type=int, default=128)
    parser.add_argument("--grids", type=int, nargs="+", default=[64, 128, 192, 256, 384])
    parser.add_argument("--minimality", type=float, nargs="+", default=[0.0, 0.25, 0.5, 0.75, 1.0])
    parser.add_argument("--seeds", type=int, nargs="+", default=[0])
    parser.add_argument("--sites", type=int, help="instead of the specification's")
    parser.add_argument("--graph", choices=["aligned", "paper"], help="graph preset instead of the specification's")
    parser.add_argument("--methods", nargs="+", choices=["phase-field", "distilled", "neural"])
    parser.add_argument("--surfaces", nargs="+", choices=list(NETS), default=list(NETS))
    parser.add_argument("--points", type=int, default=32_768)
    parser.add_argument("--name", help="of the result, instead of the mode's")
    parser.add_argument("--one", type=int, help=argparse.SUPPRESS)
    given = parser.parse_args()
    rows = MODES[given.mode](given)
    if given.one is None:
        show(rows)
        RESULTS.mkdir(parents=True, exist_ok=True)
        document = {"command": [Path(a).name for a in sys.argv[1:]], **provenance(), "rows": rows}
        (RESULTS / f"{given.name or given.mode}.json").write_text(json.dumps(document, indent=1) + "\n")
    return 0


def classical(given: argparse.Namespace) -> list[Row]:
    """One cell of each surface on the torus by each method, and the nodal formula beside them."""
    from field_classical import classical

    given.methods = given.methods or ["phase-field"]
    rows, shown = classical(given, told)
    by_curvature(shown, 0.5, RESULTS / f"{given.name or given.mode}.png")
    return rows


def minimal(given: argparse.Namespace) -> list[Row]:
    """The minimal end, by domain and seed."""
    rows, shown = [], []
    for file, spec in pairs(given):
        for seed in given.seeds:
            case = prepared(file, spec.model_copy(update={"seed": seed}))
            field, spent = solved(case, PhaseField(method="phase-field", resolution=given.grid, minimality=1.0))
            own = {"domain": case.name, "graph": spec.graph.preset, "sites": case.sites, "seed": seed}
            rows.append(told({**own, **figures(case, field), **spent}))
            if seed == given.seeds[0]:
                shown.append((case.name, *inside(case, *level_set(field, case.domain.grid(128)))))
    by_curvature(shown, 10.0, RESULTS / f"{given.name or given.mode}.png")
    return rows


def convergence(given: argparse.Namespace) -> list[Row]:
    """The minimal end on three grids, in ratios of 1.2."""
    case = first(given)
    level = int(min(given.grids))
    levels = [level, round(1.2 * level), round(1.44 * level)]
    return [told({"grid": level, **figures(case, minimal_at(case, level))}) for level in levels]


def control(given: argparse.Namespace) -> list[Row]:
    """The trade-off of the one parameter."""
    case = first(given)
    rows = []
    for minimality in given.minimality:
        field, spent = solved(case, PhaseField(method="phase-field", resolution=given.grid, minimality=minimality))
        rows.append(told({"minimality": minimality, **figures(case, field), **spent}))
    return rows


def smoothing(given: argparse.Namespace) -> list[Row]:
    """The equidistant surface, smoothed by Laplacian rounds on its mesh, beside the solver's surfaces."""
    case = first(given)
    grid = case.domain.grid(MEASURED_AT)
    meshes = {}
    for minimality in (0.0, 0.5, 1.0):
        field, _ = solved(case, PhaseField(method="phase-field", resolution=given.grid, minimality=minimality))
        meshes[f"minimality {minimality:g}"] = level_set(field, grid)
    start = meshes.pop("minimality 0")
    for rounds in SMOOTHING_ROUNDS:
        mesh = trimesh.Trimesh(*start, process=False)
        trimesh.smoothing.filter_laplacian(mesh, iterations=rounds, volume_constraint=False)
        meshes[f"equidistant, {rounds} rounds"] = np.array(mesh.vertices), np.array(mesh.faces)
    shown = [(name, *inside(case, *mesh)) for name, mesh in meshes.items()]
    by_curvature(shown, 10.0, RESULTS / "smoothing.png", columns=3)
    return [told({"surface": name, **mesh_figures(case, *mesh)}) for name, mesh in meshes.items()]


def compare(given: argparse.Namespace) -> list[Row]:
    """The methods in one envelope; ratios to the first."""
    case = first(given)
    specs = {
        "phase-field": PhaseField(method="phase-field", resolution=given.grid),
        "neural": NeuralField(method="neural", preset="cpu"),
        "distilled": DistilledField(method="distilled", resolution=given.grid),
    }
    rows: list[Row] = []
    for name in given.methods or ["phase-field", "distilled"]:
        field, spent = solved(case, specs[name])
        rows.append({"method": name, **figures(case, field), **spent})
        for key in ("area_density", "median_abs_H"):
            rows[-1][f"{key}_over_first"] = rows[-1][key] / rows[0][key]
        told(rows[-1])
    return rows


def ablate(given: argparse.Namespace) -> list[Row]:
    """Smoothness loss off; noise 0, 0.05, 0.08; weight a of transverse edges 1 and 5 (paper, section 6.1, appendix)."""
    file, spec = pairs(given)[0]
    rows, shown = [], []
    for name, weight, changes in (
        ("as published", 5.0, {}),
        ("a = 1", 1.0, {}),
        ("no smoothness loss", 5.0, {"smoothness_weight": 0.0}),
        ("noise 0", 5.0, {"noise_std": 0.0}),
        ("noise 0.05", 5.0, {"noise_std": 0.05}),
        ("noise 0.08", 5.0, {"noise_std": 0.08}),
    ):
        graph = GraphSpec(preset="paper", sites=spec.graph.sites, transverse_weight=weight)
        case = prepared(file, spec.model_copy(update={"graph": graph}))
        method = NeuralField.model_validate({"method": "neural", "preset": "cpu", "connect": False, **changes})
        field, spent = solved(case, method)
        rows.append(told({"ablation": name, **figures(case, field, NETWORK_MEASURED_AT), **spent}))
        shown.append((name, *inside(case, *level_set(field, case.domain.grid(96)))))
    by_curvature(shown, 20.0, RESULTS / "ablate.png", columns=3)
    return rows


def ratio(given: argparse.Namespace) -> list[Row]:
    """One training step, and the paper's whole schedule over the phase field's time on the same machine."""
    from field_step import steps

    case = first(given)
    rows = steps(case, given.points)
    solved(case, PhaseField(method="phase-field", resolution=given.grid))  # once for the compiled functions
    for minimality in (0.5, 1.0):
        _, spent = solved(case, PhaseField(method="phase-field", resolution=given.grid, minimality=minimality))
        for row in rows:
            days = row["days_for_the_papers_schedule"]
            row[f"schedule_over_phase_field_{minimality:g}"] = 86_400 * days / spent["seconds"]
    return rows


def growth(given: argparse.Namespace) -> list[Row]:
    """Each grid in a process of its own, so that its peak memory is its own."""
    rows: list[Row] = []
    if given.one is not None:
        case = first(given)
        for minimality in (0.5, 1.0):
            _, spent = solved(case, PhaseField(method="phase-field", resolution=given.one, minimality=minimality))
            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
            rows.append({"grid": given.one, "minimality": minimality, **spent, "peak_GB": peak})
        began, busy = time.perf_counter(), time.process_time()
        minimal_field = minimal_at(case, given.one) if given.one <= 192 else None
        if minimal_field is not None:
            spent = {"seconds": time.perf_counter() - began, "cpu_seconds": time.process_time() - busy}
            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
            rows.append({"grid": given.one, "minimality": "1, all on this grid", **spent, "peak_GB": peak})
        print(json.dumps(rows))
        return rows
    for grid in given.grids:
        own = [f"--{key}={value}" for key in ("sites", "graph") if (value := getattr(given, key))]
        command = [sys.executable, __file__, "growth", *map(str, given.files), "--one", str(grid), *own]
        rows += [
            told(r) for r in json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
        ]
    for kind in {str(row["minimality"]) for row in rows}:
        own_rows = [row for row in rows if str(row["minimality"]) == kind]
        logs = np.log([[r["grid"], r["cpu_seconds"], r["peak_GB"]] for r in own_rows])
        for row in own_rows:
            row["time_exponent"], row["memory_exponent"] = (
                (float(np.polyfit(logs[:, 0], logs[:, k], 1)[0]) for k in (1, 2)) if len(logs) > 1 else (None, None)
            )
    return rows


def pairs(given: argparse.Namespace) -> list[tuple[Path, Spec]]:
    """The domains and their specifications, with what the command line changes."""
    if not given.files or len(given.files) % 2:
        raise SystemExit("give pairs of a domain and its specification")
    found = []
    for domain, file in zip(given.files[::2], given.files[1::2], strict=True):
        spec = Spec.model_validate_json(file.read_text())
        if given.graph or given.sites:
            graph = {"preset": given.graph or spec.graph.preset, "sites": given.sites or spec.graph.sites}
            spec = spec.model_copy(update={"graph": GraphSpec.model_validate(graph)})
        found.append((domain, spec))
    return found


def first(given: argparse.Namespace) -> Case:
    """The first pair's case."""
    file, spec = pairs(given)[0]
    return prepared(file, spec.model_copy(update={"seed": given.seeds[0]}))


def inside(case: Case, vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The part of a mesh in the domain."""
    return vertices, faces[(case.domain.signed_distance(vertices)[faces] > 0).all(axis=1)]


def provenance() -> Row:
    """What the figures were made with."""
    commit = subprocess.run(["git", "describe", "--always", "--dirty"], capture_output=True, text=True, check=False)
    return {
        "commit": commit.stdout.strip(),
        "machine": platform.machine(),
        "cores": os.cpu_count(),
        "load": round(os.getloadavg()[0], 1),
        "python": platform.python_version(),
        **{name: version(name) for name in ("numpy", "scipy", "numba", "torch")},
    }


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
    mode.__name__: mode
    for mode in (classical, minimal, convergence, control, smoothing, compare, ablate, ratio, growth)
}


if __name__ == "__main__":
    sys.exit(main())
