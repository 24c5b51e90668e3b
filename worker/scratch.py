"""Temporary folders of steps, removed by whoever made them, or by the next worker on this machine."""

from __future__ import annotations

import logging
import os
import shutil
import signal
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import psutil

from worker.child import FOLDER_VARIABLE
from worker.host import is_alive, started_at

log = logging.getLogger(__name__)


@contextmanager
def step_folder(scratch: Path, job_id: str) -> Iterator[Path]:
    """An empty folder for one step; its name says whose it is and for which design."""
    scratch.mkdir(parents=True, exist_ok=True)
    pid = os.getpid()
    folder = Path(tempfile.mkdtemp(prefix=f"step-{pid}-{int(started_at(pid) * 100)}-{job_id}-", dir=scratch))
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def sweep(scratch: Path) -> int:
    """Remove what dead workers of this machine have left, and end processes that still work there; returns how many."""
    orphans = [path for path in scratch.glob("step-*-*-*") if not _owner_lives(path)]
    if not orphans:
        return 0
    folders = {str(path) for path in orphans}
    for process in psutil.process_iter():
        try:
            if process.environ().get(FOLDER_VARIABLE) in folders:
                os.kill(process.pid, signal.SIGKILL)
        except (psutil.Error, OSError):
            continue
    for path in orphans:
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)
    log.info("removed %d folders of dead workers", len(orphans))
    return len(orphans)


def _owner_lives(path: Path) -> bool:
    _, pid, started, *_ = path.name.split("-")
    return is_alive(int(pid), int(started) / 100)
