"""What a build costs and how true its body is, over seven envelopes at grid 256.

    python benchmarks/bodies.py [NAME …] [--u-shape FILE] [--grid 256]      build the rows that are missing, print all
    python benchmarks/bodies.py --show                                       print the rows

Every row is built in a process of its own, so that its peak memory is the build's; the memory and the processor time of
the second process that a build starts are counted too. A row that this code has built is
not built again, so a broken run goes on where it stopped. Rows stand in ``benchmarks/results/bodies/bodies.json``.
Seconds by the clock mean something on an idle machine only; the load at the start is kept with them.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import platform
import resource
import subprocess
import sys
import tempfile
import time
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from bodies_envelopes import CASES, write_domain

from dualms.body.walls import BAND_VOXELS, channel
from dualms.booleans import Solid
from dualms.field.field import load_field
from dualms.nearest import Nearest
from dualms.pipeline import Prepared, run_step
from dualms.reading import read_domain_mesh
from dualms.spec import Spec, Unit, WallFraction
from dualms.surface import extract_surface
from dualms.triangles import TriangleMesh
from dualms.values import load

HERE = Path(__file__).parent
RESULTS = HERE / "results" / "bodies" / "bodies.json"
PACKAGE = HERE.parent / "dualms"
SHARP_DEGREES = 30.0
SAMPLES_AN_EDGE = 32
STAGES = ("surface", "body", "report")
LIMITS = {
    "build_s": 60.0,
    "peak_gb": 4.0,
    "megabytes_3mf": 60.0,
    "closure": 0.002,
    "thickness_low": 0.97,
    "thickness_high": 1.03,
    "fraction_error": 0.01,
    "sharp_edges": 0.001,
}

Row = dict[str, Any]


class StageClock:
    """Progress that notes the seconds that each stage takes."""

    def __init__(self) -> None:
        self.wall: dict[str, float] = {}
        self._began = 0.0

    def report(self, stage: str, fraction: float, note: str = "") -> None:
        """Start at 0, stop at 1."""
        now = time.perf_counter()
        if fraction == 0.0:
            self._began = now
        elif fraction == 1.0:
            self.wall[stage] = self.wall.get(stage, 0.0) + now - self._began


def main() -> int:
    """Build what is missing and print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("names", nargs="*", default=list(CASES))
    parser.add_argument("--u-shape", type=Path, help="the authors' domain; without it, that row is left out")
    parser.add_argument("--grid", type=int, default=256)
    parser.add_argument("--work", type=Path, help="folder for the designs; default a temporary one")
    parser.add_argument("--show", action="store_true")
    parser.add_argument("--step", choices=["field", "build"], help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.step:
        return _child(given.step, given.names[0], given.work)
    table = _Table()
    if not given.show:
        with tempfile.TemporaryDirectory(prefix="bodies-") as temporary:
            for name in given.names:
                if name != "u_shape" or given.u_shape:
                    table.build(name, given.grid, (given.work or Path(temporary)) / name, given.u_shape)
    for row in table.rows:
        print(_line(row))
    return 0


class _Table:
    """The rows, in their file."""

    def __init__(self) -> None:
        self.rows: list[Row] = json.loads(RESULTS.read_text())["rows"] if RESULTS.exists() else []

    def build(self, name: str, grid: int, folder: Path, u_shape: Path | None) -> None:
        """Add the row of an envelope, unless this code has built it at that grid."""
        code, spec = _hash_of_code(), CASES[name].spec(grid)
        asked = json.loads(spec.model_dump_json(exclude_unset=True))
        same = [r for r in self.rows if (r["name"], r["grid"]) == (name, grid)]
        if any(r["provenance"]["code_sha256"] == code and r["asked"] == asked for r in same):
            return
        folder.mkdir(parents=True, exist_ok=True)
        domain = write_domain(CASES[name], folder, u_shape)
        (folder / "spec.json").write_text(spec.model_dump_json())
        (folder / "domain").write_text(str(domain))
        load = os.getloadavg()[0]
        if not (folder / "field.safetensors").exists():
            subprocess.run(_command("field", name, folder), check=True)
        built = json.loads(subprocess.run(_command("build", name, folder), check=True, capture_output=True).stdout)
        row = {"name": name, "grid": grid, **built, **_figures(folder, domain)}
        row["asked"] = asked
        row["failures"] = _failures(row)
        row["provenance"] = {**_provenance(code), "load": round(load, 1), "domain_sha256": _sha256(domain)}
        self.rows = [r for r in self.rows if r not in same] + [row]
        self.rows.sort(key=lambda r: (list(CASES).index(r["name"]), r["grid"]))
        RESULTS.parent.mkdir(parents=True, exist_ok=True)
        RESULTS.write_text(json.dumps({"limits": LIMITS, "rows": self.rows}, indent=1, allow_nan=False) + "\n")
        print(_line(row), file=sys.stderr, flush=True)


def _command(step: str, name: str, folder: Path) -> list[str]:
    return [sys.executable, str(Path(__file__)), name, "--step", step, "--work", str(folder)]


def _child(step: str, name: str, folder: Path) -> int:
    """In a process of its own: the steps up to the field, or the build with what it costs, as JSON."""
    domain = Path((folder / "domain").read_text())
    spec = Spec.model_validate_json((folder / "spec.json").read_text())
    clock = StageClock()
    began, before = time.perf_counter(), _used()
    for part in ("prepare", "solve") if step == "field" else ("build",):
        run_step(part, folder, domain, spec, clock)  # type: ignore[arg-type]
    if step == "build":
        figures = {"build_s": time.perf_counter() - began, "cpu_s": _used()[0] - before[0], "peak_gb": _used()[1] / 1e6}
        figures |= {f"{k}_s": v for k, v in clock.wall.items()}
        rounded = {k: round(v, 2) for k, v in figures.items()}
        print(json.dumps({**rounded, "fraction_error": _fraction_error(folder, spec)}))
    return 0


def _used() -> tuple[float, int]:
    """Processor seconds of this process and those that it started, and kilobytes that each had at the most, added."""
    usage = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(u.ru_utime + u.ru_stime for u in usage), sum(u.ru_maxrss for u in usage)


def _fraction_error(folder: Path, spec: Spec) -> float | None:
    """How far the wall's share of the envelope, by booleans, lies off the asked one, over it; None where none is."""
    if not isinstance(spec.wall, WallFraction):
        return None
    domain = load(Prepared, folder / "prepared.safetensors").domain
    wall = json.loads((folder / "report.json").read_text())["wall"]["thickness_m"] / domain.scale_m
    grid = domain.grid(spec.surface.resolution, padding=4)
    values = load_field(folder / "field.safetensors").on(grid)
    surface = extract_surface(domain, values, grid, wall / 2 + BAND_VOXELS * grid.spacing)
    envelope = Solid.of(domain.boundary)
    left = sum((side & envelope).volume for side in (channel(surface, wall, 0.0, sign) for sign in (1, -1)))
    return abs((1 - left / envelope.volume) / spec.wall.volume_fraction - 1)


def _figures(folder: Path, domain: Path) -> Row:
    report = json.loads((folder / "report.json").read_text())
    return {
        "faces": report["faces"]["solid"],
        "megabytes_3mf": round((folder / "solid.3mf").stat().st_size / 1e6, 1),
        "closure": report["volume_closure_error"],
        "wall_in_voxels": round(report["wall"]["thickness_m"] / report["separation"]["voxel_m"], 2),
        "thickness_low": round(report["wall"]["over_asked_min"], 4),
        "thickness_high": round(report["wall"]["over_asked_max"], 4),
        "solid_fraction": round(report["solid_volume_fraction"], 5),
        "sharp_edges": _sharp_edges(folder, domain, report),
        "certified": report["certified"],
        "not_passed": [[c["name"], c["value"], c["limit"]] for c in report["certificate"] if not c["passed"]],
    }


def _sharp_edges(folder: Path, domain: Path, report: Row) -> float | None:
    """Farthest that the envelope's sharp edges lie from the body (solid and fluids), over the envelope's size."""
    unit = Unit(report["units"])
    mesh = read_domain_mesh(domain, unit)
    pairs, edges = trimesh.graph.face_adjacency(mesh.faces, return_edges=True)
    cosine = np.einsum("ij,ij->i", mesh.normals[pairs[:, 0]], mesh.normals[pairs[:, 1]])
    sharp = edges[cosine < np.cos(np.radians(SHARP_DEGREES))]
    if len(sharp) == 0:
        return None
    share = np.linspace(0, 1, SAMPLES_AN_EDGE)[:, None, None]
    a, b = mesh.vertices_m[sharp].transpose(1, 0, 2) / unit.metres
    points = ((1 - share) * a + share * b).reshape(-1, 3)
    parts = [trimesh.load_mesh(folder / f"{n}.stl", process=False) for n in ("solid", "fluid_hot", "fluid_cold")]
    whole = trimesh.util.concatenate(parts)
    body = TriangleMesh(np.asarray(whole.vertices, dtype=float), np.asarray(whole.faces, dtype=np.int64))
    return float(Nearest(body).distance(points).max() / np.ptp(mesh.vertices_m / unit.metres, axis=0).max())


def _failures(row: Row) -> list[str]:
    least = {"thickness_low"}
    return [
        name
        for name, limit in LIMITS.items()
        if row[name] is not None and (row[name] < limit if name in least else row[name] > limit)
    ] + ([] if row["certified"] else ["certified"])


def _provenance(code: str) -> Row:
    commit = subprocess.run(["git", "describe", "--always", "--dirty"], capture_output=True, text=True, check=False)
    return {
        "commit": commit.stdout.strip(),
        "code_sha256": code,
        "machine": f"{platform.machine()}, {os.cpu_count()} cores",
        "python": platform.python_version(),
        **{name: version(name) for name in ("numpy", "libigl", "manifold3d", "numba", "mitsuba")},
    }


def _hash_of_code() -> str:
    """Of what makes and measures a body."""
    digest = hashlib.sha256()
    files = [*PACKAGE.glob("*.py"), *PACKAGE.glob("body/*.py"), *PACKAGE.glob("measure/*.py")]
    for path in sorted(files):
        digest.update(path.relative_to(PACKAGE).as_posix().encode() + path.read_bytes())
    return digest.hexdigest()


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _line(row: Row) -> str:
    edges = "-" if row["sharp_edges"] is None else f"{100 * row['sharp_edges']:.4f} %"
    error = "-" if row["fraction_error"] is None else f"{100 * row['fraction_error']:.2f} %"
    stages = (f"{name} {row[f'{name}_s']:4.1f}" for name in STAGES)
    return (
        f"{row['name']:<11} {row['build_s']:5.1f} s ({', '.join(stages)}; {row['cpu_s']:5.1f} CPU)  "
        f"{row['peak_gb']:.1f} GB  {row['faces']:>9,} faces  3MF {row['megabytes_3mf']:4.1f} MB  "
        f"closure {row['closure']:.1e}  wall {row['wall_in_voxels']} voxels: {row['thickness_low']:.3f}-"
        f"{row['thickness_high']:.3f}  fraction off {error}  edges {edges}  "
        f"{'certified' if row['certified'] else row['not_passed']}"
        + (f"  FAILS {', '.join(row['failures'])}" if row["failures"] else "")
    )


if __name__ == "__main__":
    sys.exit(main())
