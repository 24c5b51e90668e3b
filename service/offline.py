"""A design in this process: the four steps one after the other, with a progress bar."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path

from dualms.spec import Spec
from dualms.steps import ARTIFACTS, OPTIONAL_ARTIFACTS, STAGES, steps_of
from service.designs.resolve import resolved
from service.local import openfoam_found
from service.tables import DesignProgress
from worker.gpus import gpus

# Shares of the time of a usual design on a CPU, for the bar only.
WEIGHTS = {"domain": 1, "flow": 3, "graph": 3, "partition": 2, "skeletons": 1, "field": 40, "surface": 10, "body": 20,
           "report": 20, "evaluation": 100}  # fmt: skip


class Bar:
    """Progress of a whole design on a bar, from reports of its stages."""

    def __init__(self, bar: DesignProgress, stages: list[str]) -> None:
        self._bar = bar
        total = sum(WEIGHTS[s] for s in stages)
        starts = [sum(WEIGHTS[s] for s in stages[:i]) / total for i in range(len(stages))]
        self._spans = {s: (start, WEIGHTS[s] / total) for s, start in zip(stages, starts, strict=True)}

    def report(self, stage: str, fraction: float, note: str = "") -> None:
        """Move the bar."""
        start, share = self._spans[stage]
        self._bar.show("running", stage, start + share * min(max(fraction, 0.0), 1.0), note)


def design_here(domain: Path, spec: Spec, folder: Path) -> Path:
    """Make a design and leave its files in a folder.

    Parameters
    ----------
    domain
        Envelope file.
    spec
        Specification; ``auto`` means the phase field here unless a GPU answers.
    folder
        Created if need be; files of the same names are replaced once all of them are made.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    DualMSError
        If the inputs cannot become a design.
    """
    from dualms.pipeline import run_step
    from dualms.reading import inspect_file
    from service.tables import progress_console

    gpu = bool(gpus())
    queues = {"cpu"} | ({"gpu"} if gpu else set()) | ({"cfd"} if openfoam_found() else set())
    units = spec.units or inspect_file(domain, None).units
    spec = resolved(spec, units, frozenset(queues))
    steps = steps_of(spec)
    folder.mkdir(parents=True, exist_ok=True)
    with (
        tempfile.TemporaryDirectory(dir=folder, prefix=".dualms-") as scratch,
        DesignProgress(progress_console()) as bar,
    ):
        work = Path(scratch)
        progress = Bar(bar, [stage for step in steps for stage in STAGES[step]])
        for step in steps:
            run_step(step, work, domain, spec, progress, device="cuda" if gpu else "cpu")
        bar.show("succeeded", "", 1.0)
        names = {n for step in steps for n in (*ARTIFACTS[step], *OPTIONAL_ARTIFACTS[step])}
        for name in sorted(names):
            if (work / name).exists():
                shutil.move(work / name, folder / name)
    return folder
