"""Evaluates a design: both flows and the heat between them, periodic surfaces in its place, and the floor."""

from __future__ import annotations

import resource
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dualms.body.header import Header
from dualms.body.headers import bounds
from dualms.body.thickness import Wall, greatest, mean_thickness
from dualms.cfd.baselines import PowerLaw, cell_of_solid_fraction, exact_distance, tpms_exchanger
from dualms.cfd.channels import COLD, HOT, VoxelExchanger, voxelise
from dualms.cfd.exchanger import SolvedExchanger, solve_exchanger
from dualms.cfd.limits import straight_passage
from dualms.cfd.openfoam import OpenFoam, require_openfoam
from dualms.cfd.results import (
    MODE,
    BaselineFigures,
    Comparison,
    Evaluation,
    ExchangerFigures,
    Problem,
    StraightPassage,
)
from dualms.domain import Domain
from dualms.errors import DualMSError
from dualms.grid import Grid
from dualms.progress import Progress
from dualms.spec import EvaluationSpec, FluidsSpec
from dualms.tpms import Kind

SOLVES_FOR_UA = 3  # the baseline is solved at most so often to meet the design's UA
CLOSE = 0.03  # a baseline whose UA is within this share of the design's is near enough to interpolate from


def evaluate(
    domain: Domain,
    distance: NDArray[np.floating],
    grid: Grid,
    wall: Wall,
    fluids: FluidsSpec,
    spec: EvaluationSpec,
    progress: Progress,
    workdir: Path,
    shell_thickness: float = 0.0,
    picture: Path | None = None,
    headers: tuple[Header, ...] = (),
    skin: float = 0.0,
) -> Evaluation:
    """Solve a design and its baselines.

    Parameters
    ----------
    domain
        Envelope, ports and scale.
    distance, grid
        Signed distance to the separating surface, or any field with the same zero level set, positive in the hot fluid;
        unit-cube frame, on any grid that covers the domain.
    wall, shell_thickness
        Of the separating wall and of a shell inside the envelope, unit-cube units. Baselines get a graded wall's mean.
    fluids
        Properties, mass flows, inlet temperatures.
    spec
        Resolution, baselines, limits.
    progress
        Stage ``evaluation``.
    workdir
        Receives the solver's cases and logs: the design's ``hot`` and ``cold`` under ``design`` stay if
        ``spec.keep_case``; of all others only the logs stay.
    picture
        PNG file for streamlines and wall pressures, or for the reason why there are none.
    headers, skin
        Pipes on ports, which are solved too, and thickness of a shell outside the envelope, whose short passages at
        ports without a header are not.

    Returns
    -------
    Evaluation
        A flow that diverged or a blocked channel is stated there, not raised.

    Raises
    ------
    EvaluationUnavailable
        If OpenFOAM is missing.
    """
    foam = require_openfoam()
    began = time.monotonic()
    target = Grid.around(*bounds(domain, headers, skin), spec.resolution, padding=2)
    even = mean_thickness(wall, domain, target)
    solves = 1 + len(spec.baselines) * (SOLVES_FOR_UA if spec.match == "ua" else 1)
    around = _Surroundings(domain, target, even, shell_thickness, headers, skin)
    runner = _Runner(foam, around, fluids, spec, progress, workdir, solves)
    problem: Problem | None = None
    solved: SolvedExchanger | None = None
    floor: dict[str, StraightPassage] = {}
    try:
        field = exact_distance(distance, grid, target, greatest(wall))
        exchanger = voxelise(domain, field, target, wall, shell_thickness, headers, skin)
        solved = runner.solve(exchanger, "design")
        floor = _floor(solved, fluids)
    except DualMSError as error:
        problem = _problem(error)
    figures = solved.figures if solved is not None else None
    if picture is not None:
        _draw(solved, problem, picture)
    baselines: list[BaselineFigures] = []
    comparisons: list[Comparison] = []
    for kind in spec.baselines:
        rows, compared = _baseline(runner, kind, figures)
        baselines += rows
        comparisons += compared
    progress.report("evaluation", 1.0, "done")
    used = [resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return Evaluation(
        mode=MODE,
        solver=f"OpenFOAM {foam.version} simpleFoam, laminar",
        resolution=spec.resolution,
        voxel_m=target.spacing * domain.scale_m,
        design=figures,
        problem=problem,
        floor=floor,
        baselines=tuple(baselines),
        comparisons=tuple(comparisons),
        seconds=time.monotonic() - began,
        peak_memory_bytes=max(used) * 1024,
    )


def _draw(solved: SolvedExchanger | None, problem: Problem | None, picture: Path) -> None:
    # Imported here: the renderer is heavy, and an evaluation without a picture does not need it.
    from dualms.cfd.pictures import flow_picture, problem_picture

    if solved is not None:
        flow_picture(solved, picture)
    elif problem is not None:
        problem_picture(problem.message, picture)


@dataclass(frozen=True)
class _Surroundings:
    """What a design and its baselines have in common, unit-cube units."""

    domain: Domain
    grid: Grid
    wall: float
    shell: float
    headers: tuple[Header, ...]
    skin: float


class _Runner:
    """Solves one exchanger after the other and reports them as one stage."""

    def __init__(
        self,
        foam: OpenFoam,
        around: _Surroundings,
        fluids: FluidsSpec,
        spec: EvaluationSpec,
        progress: Progress,
        workdir: Path,
        solves: int,
    ) -> None:
        self.around, self.spec = around, spec
        self._foam, self._fluids, self._progress, self._workdir = foam, fluids, progress, workdir
        self._solves, self._done = solves, 0

    def solve(self, exchanger: VoxelExchanger, name: str) -> SolvedExchanger:
        folder = self._workdir / name

        def report(fraction: float, note: str) -> None:
            share = min((self._done + fraction) / self._solves, 0.99)
            self._progress.report("evaluation", share, f"{name}, {note}")

        try:
            return solve_exchanger(self._foam, exchanger, self._fluids, self.spec, folder, report)
        finally:
            self._done += 1
            if not (self.spec.keep_case and name == "design"):
                _leave_logs(folder)


def _leave_logs(folder: Path) -> None:
    """Remove a case but for the solver's logs."""
    for path in sorted(folder.rglob("*"), reverse=True):
        if path.is_file() and not path.name.startswith("log."):
            path.unlink()
        elif path.is_dir() and not any(path.iterdir()):
            path.rmdir()


def _baseline(
    runner: _Runner, kind: Kind, design: ExchangerFigures | None
) -> tuple[list[BaselineFigures], list[Comparison]]:
    """Solve a periodic surface at equal solid fraction and, if asked for, towards equal UA."""
    if design is None:
        return [], []
    around = runner.around
    domain, grid, wall = around.domain, around.grid, around.wall
    cell = cell_of_solid_fraction(domain, kind, grid, wall, design.solid_fraction)
    rows: list[BaselineFigures] = []
    points: list[tuple[float, ExchangerFigures]] = []
    for k in range(SOLVES_FOR_UA if runner.spec.match == "ua" else 1):
        figures, problem = None, None
        try:
            exchanger = tpms_exchanger(domain, kind, cell, grid, wall, around.shell, around.headers, around.skin)
            figures = runner.solve(exchanger, f"{kind}-{k}").figures
            points.append((cell, figures))
        except DualMSError as error:
            problem = _problem(error)
        rows.append(BaselineFigures(surface=kind, cell_m=cell * domain.scale_m, figures=figures, problem=problem))
        if figures is None or abs(figures.ua_w_k / design.ua_w_k - 1) < CLOSE:
            break
        cell = float(np.clip(_law(points).cell_at(design.ua_w_k), 0.6 * cell, 1.6 * cell))
    return rows, _compare(kind, design, points, runner)


def _compare(
    kind: Kind, design: ExchangerFigures, points: list[tuple[float, ExchangerFigures]], runner: _Runner
) -> list[Comparison]:
    if not points:
        return []
    cell, first = points[0]
    found = [
        Comparison(
            surface=kind,
            match="solid-fraction",
            cell_m=cell * runner.around.domain.scale_m,
            pressure_ratio=design.pressure_drop_pa / first.pressure_drop_pa,
            ua_ratio=design.ua_w_k / first.ua_w_k,
        )
    ]
    if runner.spec.match == "ua":
        law = _law(points)
        found.append(
            Comparison(
                surface=kind,
                match="ua",
                cell_m=law.cell_at(design.ua_w_k) * runner.around.domain.scale_m,
                pressure_ratio=design.pressure_drop_pa / law.pressure_at(design.ua_w_k),
                ua_ratio=1.0,
            )
        )
    return found


def _law(points: list[tuple[float, ExchangerFigures]]) -> PowerLaw:
    cells, figures = zip(*points, strict=True)
    return PowerLaw(tuple(cells), tuple(f.ua_w_k for f in figures), tuple(f.pressure_drop_pa for f in figures))


def _floor(solved: SolvedExchanger, fluids: FluidsSpec) -> dict[str, StraightPassage]:
    found = {}
    for sign, side, figures, fluid in (
        (HOT, solved.hot, solved.figures.hot, fluids.hot),
        (COLD, solved.cold, solved.figures.cold, fluids.cold),
    ):
        volume = len(side.mesh.cells) * side.mesh.spacing_m**3
        name = "hot" if sign == HOT else "cold"
        found[name] = straight_passage(solved.exchanger, sign, volume, figures.hydraulic_diameter_m, fluid)
    return found


def _problem(error: DualMSError) -> Problem:
    return Problem(code=error.code, message=error.message, advice=error.advice)
