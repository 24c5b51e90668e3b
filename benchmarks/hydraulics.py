"""Pressure drop and heat transfer of designs against periodic surfaces, solved in the same envelope.

Rows are appended to ``benchmarks/results/hydraulics/NAME.json`` as they are solved; a row that is there is not solved
again, so a broken run goes on where it stopped. Modes:

    curve   periodic surfaces over cell sizes: what a design of any UA is compared with
    table   ours at 300 to 800 sites, and a gyroid of equal solid fraction for each (the paper's appendix C)
    trend   one gyroid and one design over the grids 64, 96, 128
    sweep   a grid over any fields of the specification:  --vary graph.transverse_weight=5,20 --vary seed=0,1,2
    whole   table, larger gyroids so that ours lies between solved ones, two more seeds; then the trend, with --trend
    show    prints the rows

The domain is ``examples/u_bend.stl`` unless another is given with its specification. ``--longest-side-m`` scales it:
the paper's U-shape has its two Reynolds numbers at 0.14 m.
"""

from __future__ import annotations

import argparse
import hashlib
import itertools
import json
import os
import platform
import shutil
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from dualms import __version__
from dualms.cfd.baselines import PowerLaw, cell_of_solid_fraction, exact_distance, tpms_exchanger
from dualms.cfd.channels import VoxelExchanger, voxelise
from dualms.cfd.exchanger import solve_exchanger
from dualms.cfd.openfoam import require_openfoam
from dualms.cut.partition import max_cut
from dualms.domain import Domain
from dualms.errors import DualMSError
from dualms.field.solve import solve_field
from dualms.flow import flow_field
from dualms.graph.graph import site_graph
from dualms.ports import resolve_ports
from dualms.progress import Silent
from dualms.reading import read_domain_mesh
from dualms.skeletons import skeletons
from dualms.spec import EvaluationSpec, PhaseField, Spec, Unit

HERE = Path(__file__).parent
RESULTS = HERE / "results" / "hydraulics"
PACKAGE = HERE.parent / "dualms"
EXAMPLES = HERE.parent / "examples"
CELLS = {"gyroid": (0.17, 0.2, 0.238, 0.28), "p": (0.17, 0.238), "d": (0.238, 0.3), "iwp": (0.24, 0.32)}
SITES = (300, 400, 500, 600, 800)
GRIDS = (64, 96, 128)
WIDER = (1.0, 1.25, 1.5)  # times the cell of equal solid: gyroids whose UA stands on both sides of ours
OTHER_SEEDS = (1, 2)
ASIDE = {
    "acceleration",
    "bound",
    "pictures",
    "streamlines",
    "training",
    "wheels",
}  # beside the figures: a change there changes none
CLOSED = 10  # times the least ΔP of all cell sizes: one that happens to be closed at a port is no baseline

PUBLISHED = {  # paper, appendix C: (ΔT hot K, ΔT cold K, ΔP hot Pa, ΔP cold Pa) of the gyroid, and of theirs
    300: ((8.11, 8.138, 1415, 1837), (7.578, 7.573, 912, 976)),
    400: ((9.427, 9.321, 1878, 1842), (9.468, 9.282, 1142, 964)),
    500: ((10.684, 10.171, 2026, 2270), (11.287, 9.071, 1274, 1503)),
    600: ((10.766, 10.676, 2015, 1959), (11.885, 11.75, 1525, 1530)),
    800: ((12.569, 12.353, 2563, 2091), (11.644, 11.427, 1253, 1407)),
}


@dataclass(frozen=True)
class Case:
    """An envelope with its specification, a scale, and where its rows go."""

    name: str
    domain: Domain
    spec: Spec
    units_m: float
    wall: float
    sha256: str

    @classmethod
    def read(cls, arguments: argparse.Namespace) -> Case:
        """From the command line."""
        spec = Spec.model_validate_json(arguments.spec.read_bytes())
        mesh = read_domain_mesh(arguments.domain, spec.units)
        units = spec.units or Unit(mesh.units)
        domain = Domain.from_mesh(mesh, resolve_ports(mesh, spec.fluids, units))
        if arguments.longest_side_m:
            domain = replace(domain, scale_m=arguments.longest_side_m)
        sha256 = hashlib.sha256(arguments.domain.read_bytes()).hexdigest()
        return cls(arguments.name or arguments.domain.stem, domain, spec, units.metres, arguments.wall, sha256)


class Table:
    """Rows in a file, looked up by their key."""

    def __init__(self, case: Case, foam_version: str) -> None:
        self.path = RESULTS / f"{case.name}.json"
        self.rows: list[dict[str, Any]] = []
        self._case = {
            "domain_sha256": case.sha256,
            "longest_side_m": case.domain.scale_m,
            "wall_over_longest_side": case.wall,
            "fluids": case.spec.fluids.model_dump(mode="json", exclude_none=True),
        }
        self._provenance = {
            "dualms": __version__,
            "science_sha256": hash_of("graph", "cut", "field", "flow.py", "skeletons.py"),
            "solver_sha256": hash_of("cfd"),
            "openfoam": foam_version,
            "python": platform.python_version(),
            "numpy": np.__version__,
            "machine": f"{platform.machine()}, {os.cpu_count()} cores",
        }
        if self.path.exists():
            found = json.loads(self.path.read_text())
            if found["case"] != self._case:
                raise SystemExit(f"{self.path.name} holds another case: give a new --name")
            self.rows = found["rows"]

    def find(self, key: dict[str, Any]) -> dict[str, Any] | None:
        """The row of a key, if the same solver made it, and if it is one of ours the same science too."""
        code = ("solver_sha256", "science_sha256") if key["surface"] == "ours" else ("solver_sha256",)
        return next(
            (
                row
                for row in self.rows
                if row["key"] == key and all(row["provenance"].get(c) == self._provenance[c] for c in code)
            ),
            None,
        )

    def add(self, row: dict[str, Any]) -> None:
        """Append a row and write the file, as a whole."""
        self.rows.append({**row, "provenance": self._provenance})
        self.path.parent.mkdir(parents=True, exist_ok=True)
        text = json.dumps({"case": self._case, "rows": self.rows}, indent=1, allow_nan=False)
        unfinished = self.path.with_suffix(".part")
        unfinished.write_text(text + "\n")
        unfinished.replace(self.path)


class Bench:
    """Solves rows that are not there yet."""

    def __init__(self, case: Case) -> None:
        self.case, self.foam = case, require_openfoam()
        self.table = Table(case, self.foam.version)

    def periodic(self, kind: str, cell: float, grid: int) -> dict[str, Any]:
        """A periodic surface of a cell size (unit-cube units)."""
        target = self.case.domain.grid(grid, padding=2)
        key = {"surface": kind, "cell": round(cell, 5), "grid": grid}
        return self._row(key, lambda: tpms_exchanger(self.case.domain, kind, cell, target, self.case.wall))  # type: ignore[arg-type]

    def equal_solid(self, kind: str, row: dict[str, Any]) -> dict[str, Any] | None:
        """A periodic surface of the solid fraction of a solved row, at its grid."""
        if row.get("figures") is None:
            return None
        grid = row["key"]["grid"]
        target = self.case.domain.grid(grid, padding=2)
        cell = cell_of_solid_fraction(self.case.domain, kind, target, self.case.wall, row["figures"]["solid_fraction"])  # type: ignore[arg-type]
        return self.periodic(kind, cell, grid)

    def design(self, overrides: dict[str, Any], grid: int) -> dict[str, Any]:
        """Ours, with fields of the specification overridden."""
        return self._row({"surface": "ours", **overrides, "grid": grid}, lambda: self._voxels(overrides, grid))

    def _voxels(self, overrides: dict[str, Any], grid: int) -> VoxelExchanger:
        case, spec = self.case, overridden(self.case.spec, overrides)
        method = spec.field
        if not isinstance(method, PhaseField):
            method = PhaseField(method="phase-field")
        domain, quiet = case.domain, Silent()
        flow = flow_field(domain, spec.flow, case.units_m)
        graph = site_graph(domain, flow, spec.graph, spec.seed)
        partition = max_cut(graph, spec.partition, spec.seed)
        lines = skeletons(domain, graph, partition)
        with tempfile.TemporaryDirectory() as folder:
            field = solve_field(domain, lines, method, spec.seed, "cpu", Path(folder) / "checkpoint", quiet)
        target = domain.grid(grid, padding=2)
        fine = domain.grid(192, padding=4)
        distance = exact_distance(domain, field.on(fine), fine, target, case.wall)
        return voxelise(domain, distance, target, case.wall)

    def _row(self, key: dict[str, Any], make: Any) -> dict[str, Any]:
        found = self.table.find(key)
        if found is not None:
            return found
        began = time.monotonic()
        row: dict[str, Any] = {"key": key, "figures": None, "problem": None}
        folder = Path(tempfile.mkdtemp(prefix="hydraulics-"))
        try:
            exchanger = make()
            row["geometry_s"] = round(time.monotonic() - began, 1)
            solved = solve_exchanger(
                self.foam, exchanger, self.case.spec.fluids, EvaluationSpec(resolution=key["grid"]), folder
            )
            row["figures"] = solved.figures.model_dump(mode="json")
        except DualMSError as error:
            row["problem"] = {"code": error.code, "message": error.message}
        finally:
            shutil.rmtree(folder, ignore_errors=True)
        row["seconds"] = round(time.monotonic() - began, 1)
        self.table.add(row)
        print(line(row), flush=True)
        return row


def hash_of(*names: str) -> str:
    """Hash of the files and folders of the package that a row's figures come from."""
    files = [
        p for name in names for p in ((PACKAGE / name).glob("*.py") if (PACKAGE / name).is_dir() else [PACKAGE / name])
    ]
    return hashlib.sha256(b"".join(p.read_bytes() for p in sorted(files) if p.stem not in ASIDE)).hexdigest()[:16]


def overridden(spec: Spec, overrides: dict[str, Any]) -> Spec:
    """The specification with dotted fields replaced."""
    document = spec.model_dump(mode="json")
    for name, value in overrides.items():
        *path, last = name.split(".")
        place = document
        for part in path:
            place = place[part]
        if path == ["field"]:
            place["method"] = "phase-field"
        place[last] = value
    return Spec.model_validate(document)


def line(row: dict[str, Any]) -> str:
    """One row for people."""
    name = " ".join(f"{k.split('.')[-1]}={v}" for k, v in row["key"].items())
    if row["figures"] is None:
        return f"{name}: {row['problem']['message']}"
    f = row["figures"]
    return (
        f"{name}: ΔP {f['hot']['pressure_drop_pa']:.0f}/{f['cold']['pressure_drop_pa']:.0f} Pa"
        f" (±{f['hot']['pressure_scatter_pa']:.0f}/{f['cold']['pressure_scatter_pa']:.0f}), UA {f['ua_w_k']:.3f} W/K,"
        f" ΔT {-f['hot']['temperature_change_k']:.2f}/{f['cold']['temperature_change_k']:.2f} K,"
        f" solid {f['solid_fraction']:.4f}, {row['seconds']:.0f} s"
    )


def at_equal_ua(table: Table, row: dict[str, Any]) -> str:
    """ΔP of a row over a gyroid's of the same UA, and whether that gyroid lies between solved ones."""
    found = law(table, row)
    if found is None or row["figures"] is None:
        return ""
    ua = row["figures"]["ua_w_k"]
    between = min(found.ua_w_k) <= ua <= max(found.ua_w_k)
    ratio = row["figures"]["pressure_drop_pa"] / found.pressure_at(ua)
    return f", ΔP / gyroid at equal UA {ratio:.3f}" + ("" if between else " (extrapolated)")


def law(table: Table, row: dict[str, Any], kind: str = "gyroid") -> PowerLaw | None:
    """What a periodic surface needs for any UA: its cell sizes solved at a row's grid by the same solver."""
    solver = row["provenance"].get("solver_sha256")
    rows = [
        r
        for r in table.rows
        if r["figures"]
        and (r["key"].get("surface"), r["key"]["grid"]) == (kind, row["key"]["grid"])
        and r["provenance"].get("solver_sha256") == solver
    ]
    if not rows:
        return None
    least = min(r["figures"]["pressure_drop_pa"] for r in rows)
    rows = [r for r in rows if r["figures"]["pressure_drop_pa"] < CLOSED * least]
    return PowerLaw(
        tuple(r["key"]["cell"] for r in rows),
        tuple(r["figures"]["ua_w_k"] for r in rows),
        tuple(r["figures"]["pressure_drop_pa"] for r in rows),
    )


def show(table: Table) -> None:
    """All rows, with ΔP over a gyroid's of the same UA at the same grid by the same solver."""
    for row in table.rows:
        print(line(row) + at_equal_ua(table, row))
    print("Published (paper, appendix C), by sites: gyroid and theirs, ΔT hot, cold (K), ΔP hot, cold (Pa)")
    for sites, (gyroid, theirs) in PUBLISHED.items():
        print(f"  {sites}: {gyroid}, {theirs}")


def run(arguments: argparse.Namespace) -> None:
    """Run a mode."""
    bench = Bench(Case.read(arguments))
    varied = [(name, values.split(",")) for name, values in (v.split("=", 1) for v in arguments.vary)]
    grids = arguments.grid or [96]
    if arguments.mode == "curve":
        for grid, kind in itertools.product(grids, arguments.surface or ["gyroid"]):
            for cell in arguments.cell or CELLS[kind]:
                bench.periodic(kind, cell, grid)
    elif arguments.mode == "table":
        for grid in grids:
            table(bench, grid, fixed(varied))
    elif arguments.mode == "trend":
        trend(bench, arguments.grid or GRIDS, fixed(varied), 0.238)
    elif arguments.mode == "whole":
        whole(bench, grids[0], fixed(varied), arguments.trend)
    elif arguments.mode == "sweep":
        names = [name for name, _ in varied]
        for grid in grids:
            for values in itertools.product(*(v for _, v in varied)):
                bench.design({n: json.loads(v) for n, v in zip(names, values, strict=True)}, grid)
    show(bench.table)


def table(bench: Bench, grid: int, changes: dict[str, Any]) -> float | None:
    """Ours by the number of sites, and gyroids of equal solid fraction; gives the cell of the first of them."""
    cells = []
    for sites in SITES:
        gyroid = bench.equal_solid("gyroid", bench.design({"graph.sites": sites, **changes}, grid))
        cells += [gyroid["key"]["cell"]] if gyroid else []
    return cells[0] if cells else None


def trend(bench: Bench, grids: Sequence[int], changes: dict[str, Any], cell: float) -> None:
    """One gyroid and one design over grids."""
    for grid in grids:
        bench.periodic("gyroid", cell, grid)
        bench.design(changes, grid)


def whole(bench: Bench, grid: int, changes: dict[str, Any], grids: Sequence[int]) -> None:
    """Everything that is asked of one envelope."""
    cell = table(bench, grid, changes)
    if cell is None:
        return
    for factor in WIDER:
        bench.periodic("gyroid", cell * factor, grid)
    first = {"graph.sites": SITES[0], **changes}
    for seed in OTHER_SEEDS:
        bench.design({**first, "seed": seed}, grid)
    trend(bench, grids, first, cell)


def fixed(varied: list[tuple[str, list[str]]]) -> dict[str, Any]:
    """The first value of each varied field."""
    return {name: json.loads(values[0]) for name, values in varied}


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "mode", nargs="?", default="table", choices=["curve", "table", "trend", "sweep", "whole", "show"]
    )
    parser.add_argument("--domain", type=Path, default=EXAMPLES / "u_bend.stl")
    parser.add_argument("--spec", type=Path, default=EXAMPLES / "u_bend.json")
    parser.add_argument("--name", help="of the results' file; the domain's name by default")
    parser.add_argument("--longest-side-m", type=float, help="scales the domain")
    parser.add_argument("--wall", type=float, default=0.0075, help="thickness over the longest side")
    parser.add_argument("--grid", type=int, action="append", help="voxels along the longest side; may be repeated")
    parser.add_argument("--trend", type=int, nargs="*", default=[], help="grids, for whole")
    parser.add_argument("--surface", action="append", choices=sorted(CELLS), help="for curve; may be repeated")
    parser.add_argument("--cell", type=float, action="append", help="for curve: over the longest side; may be repeated")
    parser.add_argument("--vary", action="append", default=[], metavar="FIELD=V1,V2", help="for sweep; may be repeated")
    run(parser.parse_args())


if __name__ == "__main__":
    main()
