"""Rows of the hydraulic tables: the case they belong to, the file that keeps them, and what solves missing ones."""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import platform
import shutil
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from dualms import __version__
from dualms.cfd.baselines import cell_of_solid_fraction, exact_distance, tpms_exchanger
from dualms.cfd.channels import VoxelExchanger, voxelise
from dualms.cfd.evaluate import evaluate
from dualms.cfd.exchanger import solve_exchanger
from dualms.cfd.openfoam import require_openfoam
from dualms.cut.partition import max_cut
from dualms.domain import Domain
from dualms.errors import DualMSError
from dualms.field.field import Field
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
ASIDE = {"acceleration", "bound", "pictures", "streamlines", "training", "wheels"}
"""Modules beside the figures: a change there changes none."""


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
        self.provenance = {
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
                if row["key"] == key and all(row["provenance"].get(c) == self.provenance[c] for c in code)
            ),
            None,
        )

    def add(self, row: dict[str, Any]) -> None:
        """Append a row and write the file, as a whole."""
        self.rows.append({**row, "provenance": self.provenance})
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

    def evaluation(self, overrides: dict[str, Any], grid: int) -> dict[str, Any]:
        """What a job's evaluation of one design costs, pictures and all, without baselines."""
        field, grid_of = self._field(overrides), self.case.domain.grid(192, padding=4)
        asked = EvaluationSpec(resolution=grid, baselines=())
        case = self.case
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            found = evaluate(
                case.domain, field.on(grid_of), grid_of, case.wall, case.spec.fluids, asked, Silent(), folder,
                picture=folder / "evaluation.png",
            )  # fmt: skip
        return {
            "grid": grid,
            "seconds": found.seconds,
            "peak_memory_gb": found.peak_memory_bytes / 1e9,
            "load_average": os.getloadavg()[0],
            "provenance": self.table.provenance,
        }

    def _voxels(self, overrides: dict[str, Any], grid: int) -> VoxelExchanger:
        domain, wall = self.case.domain, self.case.wall
        target, fine = domain.grid(grid, padding=2), domain.grid(192, padding=4)
        distance = exact_distance(self._field(overrides).on(fine), fine, target, wall)
        return voxelise(domain, distance, target, wall)

    def _field(self, overrides: dict[str, Any]) -> Field:
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
            return solve_field(domain, lines, method, spec.seed, "cpu", Path(folder) / "checkpoint", quiet)

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
