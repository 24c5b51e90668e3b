"""The four steps of a design, each from files to files, so that any of them can run on another machine."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dualms.beside import second_process
from dualms.body.body import Body, Recipe
from dualms.body.headers import headers_of
from dualms.body.thickness import greatest
from dualms.body.walls import BAND_VOXELS, graded_wall, wall_thickness
from dualms.cfd.evaluate import evaluate as solve_evaluation
from dualms.cut.partition import Partition, max_cut
from dualms.domain import Domain
from dualms.field.field import load_field
from dualms.field.solve import solve_field
from dualms.field_file import write as write_field
from dualms.flow import flow_field
from dualms.flow_picture import flow_picture
from dualms.graph.graph import Graph, site_graph
from dualms.measure.curvature import mean_curvature
from dualms.measure.report import Report, make_report
from dualms.ports import resolve_ports
from dualms.progress import Progress
from dualms.reading import read_domain_mesh
from dualms.selfsupport import Compression, compression
from dualms.skeletons import Skeletons, skeletons, write_json
from dualms.spec import AutoField, ShellSpec, Spec, Unit
from dualms.steps import CHECKPOINT, Step, sha256_of
from dualms.stopwatch import Stopwatch
from dualms.surface import Sheet, Surface, clipped, extract_sheet
from dualms.triangles import TriangleMesh
from dualms.values import load, save


@dataclass(frozen=True)
class Prepared:
    """What ``prepare`` hands on; with self-support, the skeletons are those of the compressed domain."""

    domain: Domain
    graph: Graph
    partition: Partition
    skeletons: Skeletons
    units: str
    compression: Compression | None


def run_step(step: Step, folder: Path, domain_file: Path, spec: Spec, progress: Progress, device: str = "cpu") -> None:
    """Run one step in a folder that holds the earlier steps' files; it leaves the files that ``dualms.steps`` names."""
    if step == "prepare":
        prepare(folder, domain_file, spec, progress)
    elif step == "solve":
        solve(folder, spec, progress, device)
    elif step == "build":
        build(folder, domain_file, spec, progress)
    else:
        evaluate(folder, spec, progress)


def prepare(folder: Path, domain_file: Path, spec: Spec, progress: Progress) -> None:
    """Domain file → domain, flow guidance, graph, partition, skeletons."""
    watch = Stopwatch(progress)
    mesh = watch.run("domain", lambda: read_domain_mesh(domain_file, spec.units))
    units = spec.units or mesh.units
    domain = watch.run("domain", lambda: Domain.from_mesh(mesh, resolve_ports(mesh, spec.fluids, units)))
    flow = watch.run("flow", lambda: flow_field(domain, spec.flow, units.metres, progress=progress))
    frame = compression(domain, spec.self_support, spec.build_direction)
    solved = frame.domain(domain) if frame else domain
    guide = frame.flow(flow, solved) if frame and flow else flow
    graph = watch.run("graph", lambda: site_graph(solved, guide, spec.graph, spec.seed, progress=progress))
    partition = watch.run("partition", lambda: max_cut(graph, spec.partition, spec.seed, progress=progress))
    sampled = watch.run("skeletons", lambda: skeletons(solved, graph, partition))
    graph = frame.graph_back(graph) if frame else graph
    save(Prepared(domain, graph, partition, sampled, units.value, frame), folder / "prepared.safetensors")
    write_json(folder / "skeletons.json", domain, graph, partition)
    if flow is not None:
        flow_picture(domain, flow, folder / "flow.png")
    watch.save(folder, "prepare")


def solve(folder: Path, spec: Spec, progress: Progress, device: str) -> None:
    """Skeletons → field."""
    if isinstance(spec.field, AutoField):
        raise TypeError("field.method 'auto' is resolved before a design is run")
    method = spec.field
    watch = Stopwatch(progress)
    given = load(Prepared, folder / "prepared.safetensors")
    frame = given.compression
    domain = frame.domain(given.domain) if frame else given.domain
    checkpoint = folder / CHECKPOINT / "training.safetensors"
    field = watch.run(
        "field", lambda: solve_field(domain, given.skeletons, method, spec.seed, device, checkpoint, progress)
    )
    field = frame.field_back(field, given.domain, domain) if frame else field
    write_field(field, given.domain, Unit(given.units), folder / "field.safetensors")
    watch.save(folder, "solve")


def build(folder: Path, domain_file: Path, spec: Spec, progress: Progress) -> None:
    """Field → surface, body, report, pictures."""
    from dualms import results  # what writes costs a second to load, and the first two steps write no meshes

    watch = Stopwatch(progress)
    given = load(Prepared, folder / "prepared.safetensors")
    field = load_field(folder / "field.safetensors")
    domain, units = given.domain, Unit(given.units)
    inside, outside = shells(spec.shell, units, domain)
    shell = inside or outside
    grid = domain.grid(spec.surface.resolution, padding=4 + ceil(outside * spec.surface.resolution))
    with second_process(grid.size, "dualms.drawing") as beside:
        wall = watch.run("surface", lambda: wall_thickness(spec.wall, units, domain, field.on))
        band = greatest(wall) / 2 + BAND_VOXELS * grid.spacing
        sheet = watch.run("surface", lambda: extract_sheet(domain, field.on(grid), grid, band, shell, outside))
        headers = headers_of(domain, spec.fluids, units, spec.shell)
        recipe = Recipe(domain, sheet, wall, shell, outside > 0, headers, units.metres, spec.surface.max_faces)
        cold = beside.submit(recipe.side, -1)
        clip = beside.submit(_clipped, domain, sheet)
        body = watch.run("body", lambda: recipe.join(recipe.side(1), cold.result(), beside))

        def measure() -> Report:
            graph, cut = given.graph, given.partition
            mesh, curvature = clip.result()
            drawn = beside.submit(_draw, folder, given, mesh, curvature, body, spec.pictures.width)
            results.write_meshes(folder, domain, graph, cut, mesh, body, units, spec.output.formats)
            sha256, edges = sha256_of(domain_file), len(graph.edges)
            surface = Surface(**vars(sheet), mesh=mesh)
            report = make_report(domain, sha256, cut, edges, field, surface, curvature, body, wall, spec, given.units)
            drawn.result()
            return report

        report = watch.run("report", measure)
    results.write_report(folder, report.timed(watch.total(folder, "prepare", "solve")))


def _draw(
    folder: Path, given: Prepared, mesh: TriangleMesh, curvature: NDArray[np.float64], body: Body, width: int
) -> None:
    from dualms.drawing import draw  # only the process that draws loads what draws

    draw(folder, given.domain, given.graph, given.partition, mesh, curvature, body, width)


def _clipped(domain: Domain, sheet: Sheet) -> tuple[TriangleMesh, NDArray[np.float64]]:
    """The separating surface in the domain, metres, and the mean curvature (V,) at its vertices, 1/m."""
    mesh = clipped(domain, sheet)
    return mesh, mean_curvature(mesh.vertices, mesh.faces)


def evaluate(folder: Path, spec: Spec, progress: Progress) -> None:
    """Field → solved pressure drop and heat transfer, joined to the report."""
    from dualms import results

    if spec.evaluation is None:
        raise TypeError("the specification asks for no evaluation")
    asked = spec.evaluation
    watch = Stopwatch(progress)
    given = load(Prepared, folder / "prepared.safetensors")
    domain, units = given.domain, Unit(given.units)
    field = load_field(folder / "field.safetensors")
    report = results.read_report(folder)
    grid = domain.grid(spec.surface.resolution, padding=4)
    wall = graded_wall(spec.wall, units, domain) or report.wall.thickness_m / domain.scale_m
    inside, outside = shells(spec.shell, units, domain)
    headers = headers_of(domain, spec.fluids, units, spec.shell)
    case, picture = folder / "case", folder / "evaluation.png"
    solved = watch.run(
        "evaluation",
        lambda: solve_evaluation(
            domain, field.on(grid), grid, wall, spec.fluids, asked, progress, case, inside, picture, headers, outside
        ),
    )
    results.write_evaluation(
        folder, report, solved.to_json(), watch.seconds, case, "case" if asked.keep_case else "logs"
    )


def shells(spec: ShellSpec | None, units: Unit, domain: Domain) -> tuple[float, float]:
    """Thickness of the shell inside and outside the envelope, unit-cube units; one of them, or both, zero."""
    if spec is None:
        return 0.0, 0.0
    thickness = spec.thickness * units.metres / domain.scale_m
    return (thickness, 0.0) if spec.side == "inside" else (0.0, thickness)
