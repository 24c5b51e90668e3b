"""A study in this process, resumable: steps that a folder has already are not run again."""

from __future__ import annotations

import fcntl
import json
import os
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from dualms.errors import InvalidSpec
from dualms.spec import Spec
from dualms.steps import (
    ARTIFACTS,
    CHECKPOINT,
    INTERNAL,
    OPTIONAL_ARTIFACTS,
    STAGES,
    Step,
    sha256_of,
    step_keys,
    steps_of,
)
from dualms.study.figures import Scalar, default_metrics, figure, objectives_of, problem_of
from dualms.study.grid import Point
from dualms.study.table import PICTURE, Row, Table, make_table
from service.designs.resolve import resolved
from service.local import openfoam_found
from service.offline import WEIGHTS
from service.studies.schemas import StudyPlan
from service.studies.submission import study_points
from service.tables import DesignProgress, progress_console
from worker.failures import failure_of
from worker.gpus import gpus

STEPS_FOLDER = ".steps"  # results by cache key; may be deleted when the study is done
POINTS_FOLDER = "points"


def study_here(domain: Path, plan: StudyPlan, title: str, folder: Path) -> Table:
    """Make the designs of a study one after the other; the table and the picture grow with them.

    Parameters
    ----------
    domain
        Envelope file.
    plan
        What is varied and shown.
    title
        For people, where the plan has no name.
    folder
        Receives ``table.csv|json|html``, ``picture.png`` and a folder for each point. What is there from an earlier
        call, of this study or another, is used where inputs, parameters and code are the same; failed points are
        tried again.

    Raises
    ------
    Problem, DualMSError
        If the plan is refused. A point that fails is a row of the table that says why.
    """
    gpu = bool(gpus())
    points = _resolved(domain, study_points(plan.spec, plan.grid), gpu)
    specs = [point.spec for point in points]
    metrics, objectives = plan.metrics or default_metrics(specs), objectives_of(specs)
    shown = tuple(dict.fromkeys([*metrics, objectives.small, objectives.large]))
    rows = [Row(p.values, "", "queued", dict.fromkeys(shown)) for p in points]
    with _alone(folder), DesignProgress(progress_console()) as bar:
        cache = StepCache(folder / STEPS_FOLDER, domain, "cuda" if gpu else "cpu")
        for k, point in enumerate(points):
            rows[k] = _run(cache, point, _Share(bar, k, points), folder, k + 1, shown)
            table = make_table(plan.name or title, tuple(plan.grid), metrics, objectives, rows)
            _write(table, folder)
        bar.show("drawing", "", 1.0)
        _draw(table, folder)
        bar.show("succeeded", "", 1.0)
    return table


class StepCache:
    """Runs steps, each once for its cache key.

    Parameters
    ----------
    folder
        Where the results are kept.
    domain
        Envelope file.
    device
        For the field.
    """

    def __init__(self, folder: Path, domain: Path, device: str) -> None:
        self._folder, self._domain, self._device = folder, domain, device
        self._sha256 = sha256_of(domain)
        folder.mkdir(parents=True, exist_ok=True)

    def keys(self, spec: Spec) -> dict[Step, str]:
        """Cache key of each step."""
        return step_keys(self._sha256, spec)

    def files(self, spec: Spec, progress: _Share) -> dict[str, Path]:
        """Name to path of everything that a design's steps leave; what is missing is made."""
        files: dict[str, Path] = {}
        for step, key in self.keys(spec).items():
            result = self._folder / key
            if not result.is_dir():
                self._make(step, result, files, spec, progress)
            files |= {path.name: path for path in result.iterdir()}
        return files

    def _make(self, step: Step, result: Path, inputs: Mapping[str, Path], spec: Spec, progress: _Share) -> None:
        from dualms.pipeline import run_step

        work, ready = result.with_suffix(".work"), result.with_suffix(".ready")
        work.mkdir(exist_ok=True)
        for path in work.iterdir():  # an interrupted run's checkpoint stays: the step goes on from there
            if path.is_file():
                path.unlink()
            elif path.name != CHECKPOINT:
                shutil.rmtree(path)
        for name, path in inputs.items():
            shutil.copyfile(path, work / name)  # not a link: evaluate writes the report anew
        run_step(step, work, self._domain, spec, progress, device=self._device)
        shutil.rmtree(ready, ignore_errors=True)
        ready.mkdir()
        for name in (*ARTIFACTS[step], *INTERNAL[step], *OPTIONAL_ARTIFACTS[step]):
            if (work / name).exists():
                shutil.move(work / name, ready / name)
        ready.rename(result)
        shutil.rmtree(work)


class _Share:
    """One point's share of the bar."""

    def __init__(self, bar: DesignProgress, index: int, points: Sequence[Point]) -> None:
        self._bar, self._index, self._count = bar, index, len(points)
        stages = [stage for step in steps_of(points[index].spec) for stage in STAGES[step]]
        total = sum(WEIGHTS[stage] for stage in stages)
        self._spans = {
            stage: (sum(WEIGHTS[s] for s in stages[:i]) / total, WEIGHTS[stage] / total)
            for i, stage in enumerate(stages)
        }

    def report(self, stage: str, fraction: float, note: str = "") -> None:
        """Move the bar."""
        start, share = self._spans[stage]
        whole = (self._index + start + share * min(max(fraction, 0.0), 1.0)) / self._count
        self._bar.show("running", f"{self._index + 1}/{self._count} {stage}", whole, note)


def _resolved(domain: Path, points: Sequence[Point], gpu: bool) -> tuple[Point, ...]:
    from dualms.reading import inspect_file

    units = points[0].spec.units or inspect_file(domain, None).units
    queues = frozenset({"cpu", *(["gpu"] if gpu else []), *(["cfd"] if openfoam_found() else [])})
    return tuple(Point(p.values, resolved(p.spec, p.spec.units or units, queues)) for p in points)


def _run(cache: StepCache, point: Point, progress: _Share, folder: Path, number: int, shown: Sequence[str]) -> Row:
    place = folder / POINTS_FOLDER / f"{number:03d}"
    shutil.rmtree(place, ignore_errors=True)
    key = list(cache.keys(point.spec).values())[-1][:32]
    try:
        files = cache.files(point.spec, progress)
    except Exception as error:  # noqa: BLE001 - one point's failure is a row; the others go on
        failure = failure_of(error)
        return Row(point.values, key, "failed", dict.fromkeys(shown), error=(failure.code, failure.message))
    steps = steps_of(point.spec)
    wanted = {name for step in steps for name in (*ARTIFACTS[step], *OPTIONAL_ARTIFACTS[step])}
    place.mkdir(parents=True)
    for name in sorted(wanted & set(files)):
        _link(files[name], place / name)
    report = _read(files["report.json"])
    figures: dict[str, Scalar] = {path: figure(report, path) for path in shown}
    return Row(point.values, key, "succeeded", figures, f"{POINTS_FOLDER}/{number:03d}/report.html", problem_of(report))


def _write(table: Table, folder: Path) -> None:
    for name, text in (
        ("table.csv", table.to_csv()),
        ("table.json", table.to_json()),
        ("table.html", table.to_html()),
    ):
        partial = folder / f"{name}.partial"
        partial.write_text(text, encoding="utf-8")
        partial.replace(folder / name)


def _draw(table: Table, folder: Path) -> None:
    from dualms.study.picture import study_picture

    (folder / PICTURE).write_bytes(study_picture(table))


def _read(path: Path) -> dict[str, Any]:
    document: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return document


def _link(source: Path, target: Path) -> None:
    """The same file at another place, without the room of a second one where the file system can."""
    with suppress(OSError):
        os.link(source, target)
        return
    shutil.copyfile(source, target)


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """Keep a second process out of the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / ".lock").open("w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InvalidSpec(
                f"Another study is writing to {folder}.", advice="Wait for it, or give another --out."
            ) from None
        yield
