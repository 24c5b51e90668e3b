"""The files that clients download: meshes in the domain's own units, and the report as JSON and page."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np

from dualms.body.body import Body, Fluid, in_units
from dualms.body.files import COLD, HOT, METAL, SIDE_COLOURS, single_precision, write_3mf, write_glb, write_stl
from dualms.body.regions import write_regions
from dualms.cut.partition import Partition
from dualms.domain import Domain
from dualms.exchange import write_formats
from dualms.graph.graph import Graph
from dualms.measure.report import Report
from dualms.page import report_page
from dualms.skeleton_mesh import skeleton_meshes
from dualms.spec import MeshFormat, Unit
from dualms.steps import ARTIFACTS, OPTIONAL_ARTIFACTS, sha256_of
from dualms.triangles import TriangleMesh

REGIONS = {"hot": "fluid_hot_patches.stl.gz", "cold": "fluid_cold_patches.stl.gz"}


def write_meshes(
    folder: Path,
    domain: Domain,
    graph: Graph,
    partition: Partition,
    surface: TriangleMesh,
    body: Body,
    units: Unit,
    formats: tuple[MeshFormat, ...] = (),
) -> None:
    """Write surface (in metres), solid, fluids, patches, scene, and other formats asked for."""
    scaled = in_units(body, units.metres)
    write_stl(single_precision(surface.moved(1 / units.metres, np.zeros(3))), folder / "surface.stl")
    write_stl(scaled.solid, folder / "solid.stl")
    write_3mf(scaled.solid, scaled.solid_side, units, folder / "solid.3mf")
    write_stl(scaled.hot.mesh, folder / "fluid_hot.stl")
    write_stl(scaled.cold.mesh, folder / "fluid_cold.stl")
    write_regions(scaled.hot, folder / REGIONS["hot"])
    write_regions(scaled.cold, folder / REGIONS["cold"])
    write_json(folder / "patches.json", patches(body, units))
    write_formats(formats, folder, surface, body, units)
    colours = np.array([SIDE_COLOURS[s] for s in (-1, 0, 1)], dtype=np.uint8)[body.solid_side + 1]
    bones = skeleton_meshes(domain, graph, partition)
    # glTF is in metres by definition.
    write_glb(
        {
            "solid": (body.solid, colours),
            "fluid_hot": (body.hot.mesh, HOT),
            "fluid_cold": (body.cold.mesh, COLD),
            "surface": (surface, METAL),
            "skeleton_hot": (bones["skeleton_hot"], HOT),
            "skeleton_cold": (bones["skeleton_cold"], COLD),
            "cut_edges": (bones["cut_edges"], METAL),
        },
        folder / "scene.glb",
    )


def patches(body: Body, units: Unit) -> dict[str, Any]:
    """The named patches of both fluids: which triangles of their STL files, area (m²), centre and outward normal."""

    def describe(fluid: Fluid) -> list[dict[str, Any]]:
        listed = []
        for k, name in enumerate(fluid.patches):
            part = fluid.mesh.part(fluid.patch == k)
            if len(part.faces) == 0:
                continue
            normal = part.crosses.sum(axis=0)
            centre = np.average(part.centroids, axis=0, weights=part.areas)
            listed.append(
                {
                    "name": name,
                    "index": k,
                    "area_m2": part.area,
                    "centre": (centre / units.metres).tolist(),
                    "normal": (normal / max(float(np.linalg.norm(normal)), 1e-300)).tolist(),
                    "triangles": _runs(np.flatnonzero(fluid.patch == k)),
                }
            )
        return listed

    return {
        "units": units.value,
        "triangles": "half-open ranges [first, last) of triangle indices in the STL file",
        "hot": {"file": "fluid_hot.stl", "regions": REGIONS["hot"], "patches": describe(body.hot)},
        "cold": {"file": "fluid_cold.stl", "regions": REGIONS["cold"], "patches": describe(body.cold)},
    }


def read_report(folder: Path) -> Report:
    """The report that an earlier step wrote."""
    return Report.model_validate_json((folder / "report.json").read_text(encoding="utf-8"))


def write_evaluation(
    folder: Path, report: Report, evaluation: dict[str, Any], seconds: dict[str, float], case: Path, archive: str
) -> None:
    """Write ``evaluation.json``, join it to the report, and pack what the solvers left under a name."""
    write_json(folder / "evaluation.json", evaluation)
    joined = report.model_copy(update={"evaluation": evaluation}).timed(report.timings_s | seconds)
    write_report(folder, joined)
    if case.is_dir():
        shutil.make_archive(str(folder / archive), "zip", case)


def write_report(folder: Path, report: Report) -> None:
    """Write ``report.json`` and the self-contained page ``report.html``, with the hashes of the files beside them."""
    files = [
        f for step in (*ARTIFACTS.values(), OPTIONAL_ARTIFACTS["build"]) for f in step if not f.startswith("report")
    ]
    report = report.with_files({name: sha256_of(folder / name) for name in files if (folder / name).exists()})
    write_json(folder / "report.json", report.model_dump(mode="json"))
    (folder / "report.html").write_text(report_page(report, folder), encoding="utf-8")


def write_json(path: Path, document: dict[str, Any]) -> None:
    """Write JSON with sorted keys and no NaN."""
    path.write_text(json.dumps(document, indent=1, sort_keys=True, allow_nan=False) + "\n", encoding="utf-8")


def _runs(indices: np.ndarray[Any, np.dtype[np.int64]]) -> list[list[int]]:
    """Sorted indices as half-open ranges."""
    breaks = np.flatnonzero(np.diff(indices) > 1)
    firsts = np.concatenate([indices[:1], indices[breaks + 1]])
    lasts = np.concatenate([indices[breaks], indices[-1:]]) + 1
    return [[int(a), int(b)] for a, b in zip(firsts, lasts, strict=True)]
