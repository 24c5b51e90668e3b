"""Seconds a stage, and its first and last report of progress."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from dualms.progress import Progress

T = TypeVar("T")


class Stopwatch:
    """Runs stages one after the other, reports when each begins and ends, and adds up their seconds.

    Parameters
    ----------
    progress
        Where to report to.
    """

    def __init__(self, progress: Progress) -> None:
        self._progress = progress
        self.seconds: dict[str, float] = {}

    def run(self, stage: str, work: Callable[[], T]) -> T:
        """The result of ``work``, its wall time added to the stage's."""
        self._progress.report(stage, 0.0)
        start = time.perf_counter()
        result = work()
        self.seconds[stage] = self.seconds.get(stage, 0.0) + time.perf_counter() - start
        self._progress.report(stage, 1.0)
        return result

    def save(self, folder: Path, step: str) -> None:
        """Write the seconds as JSON, for the report of a later step."""
        (folder / f"timings-{step}.json").write_text(json.dumps(self.seconds, sort_keys=True))

    def total(self, folder: Path, *earlier: str) -> dict[str, float]:
        """Seconds of every stage so far, with those that earlier steps saved in ``folder``."""
        seconds: dict[str, float] = {}
        for step in earlier:
            seconds |= json.loads((folder / f"timings-{step}.json").read_text())
        return seconds | self.seconds
