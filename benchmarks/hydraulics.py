"""Pressure drop and heat transfer of designs against periodic surfaces, solved in the same envelope.

Rows are appended to ``benchmarks/results/hydraulics/NAME.json`` as they are solved; a row that is there is not solved
again, so a broken run goes on where it stopped. Modes:

    curve   periodic surfaces over cell sizes: what a design of any UA is compared with
    table   ours at 300 to 800 sites, and a gyroid of equal solid fraction for each (the paper's appendix C)
    trend   one gyroid and one design over the grids 64, 96, 128
    sweep   a grid over any fields of the specification:  --vary graph.transverse_weight=5,20 --vary seed=0,1,2
    whole   table, larger gyroids so that ours lies between solved ones, two more seeds; then the trend, with --trend
    timed   what a job's evaluation of one design costs: seconds and memory
    show    prints the rows

The domain is ``examples/u_bend.stl`` unless another is given with its specification. ``--longest-side-m`` scales it:
the paper's U-shape has its two Reynolds numbers at 0.14 m.
"""

from __future__ import annotations

import argparse
import itertools
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from hydraulics_rows import RESULTS, Bench, Case, Table, line

from dualms.cfd.baselines import PowerLaw

HERE = Path(__file__).parent
EXAMPLES = HERE.parent / "examples"
CELLS = {"gyroid": (0.17, 0.2, 0.238, 0.28), "p": (0.17, 0.238), "d": (0.238, 0.3), "iwp": (0.24, 0.32)}
SITES = (300, 400, 500, 600, 800)
GRIDS = (64, 96, 128)
WIDER = (1.0, 1.25, 1.5)  # times the cell of equal solid: gyroids whose UA stands on both sides of ours
OTHER_SEEDS = (1, 2)
CLOSED = 10  # times the least ΔP of all cell sizes: one that happens to be closed at a port is no baseline

PUBLISHED = {  # paper, appendix C: (ΔT hot K, ΔT cold K, ΔP hot Pa, ΔP cold Pa) of the gyroid, and of theirs
    300: ((8.11, 8.138, 1415, 1837), (7.578, 7.573, 912, 976)),
    400: ((9.427, 9.321, 1878, 1842), (9.468, 9.282, 1142, 964)),
    500: ((10.684, 10.171, 2026, 2270), (11.287, 9.071, 1274, 1503)),
    600: ((10.766, 10.676, 2015, 1959), (11.885, 11.75, 1525, 1530)),
    800: ((12.569, 12.353, 2563, 2091), (11.644, 11.427, 1253, 1407)),
}


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
    elif arguments.mode == "timed":
        cost = bench.evaluation(fixed(varied), grids[0])
        path = RESULTS / f"{bench.case.name}_evaluation_cost.json"
        path.write_text(json.dumps(cost, indent=1) + "\n")
        print(f"grid {cost['grid']}: {cost['seconds']:.0f} s, {cost['peak_memory_gb']:.2f} GB")
        return
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
        "mode", nargs="?", default="table", choices=["curve", "table", "trend", "sweep", "whole", "timed", "show"]
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
