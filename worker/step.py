"""Runs inside the child process of one step: fetch the inputs, call the pipeline, store what it made.

Speaks JSON lines with :mod:`worker.child`: one line in with what to do, later perhaps ``cancel``; out come reports,
checkpoints and, last, the outcome. The child does not write to the records: only its parent does, who holds the lease.
"""

from __future__ import annotations

import ctypes
import io
import json
import logging
import os
import signal
import sys
import tarfile
import threading
import time
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any, BinaryIO

from dualms.progress import Cancelled
from dualms.spec import Spec
from dualms.steps import ARTIFACTS, CHECKPOINT, INTERNAL, OPTIONAL_ARTIFACTS, Step
from worker.artifacts import ArtifactStore, MissingBlob, StoreFull, fetch, put_file
from worker.failures import STORE_FULL, Failure, failure_of
from worker.settings import Settings
from worker.stores import open_store

CHECKPOINT_S = 20.0  # between two looks for a new checkpoint
_REPORT_S = 0.2  # between two reports of one stage
_LONG = 24  # lists with more entries than this stay in the report


def main() -> None:
    """Carry out the step that stdin names."""
    out = _private_stdout()
    job = json.loads(sys.stdin.readline())
    _die_with(job["parent"])
    logging.basicConfig(level=logging.INFO, format="%(levelname)s %(name)s %(message)s")
    cancel = threading.Event()
    threading.Thread(target=_listen, args=(cancel,), daemon=True).start()
    channel = _Channel(out)
    channel.send({"outcome": _outcome(job, channel, cancel)})
    out.flush()
    os._exit(0)  # nothing is left to do, and some libraries' threads take seconds to stop


def _outcome(job: dict[str, Any], channel: _Channel, cancel: threading.Event) -> dict[str, Any]:
    folder = Path.cwd()
    store = open_store(Settings())
    progress = _Progress(channel, cancel, store, folder / CHECKPOINT)
    try:
        domain_file = _fetch_inputs(job, store, folder)
        _run(job, folder, domain_file, progress)
        files = _store_files(job["step"], store, folder)
    except Cancelled:
        progress.save_checkpoint()
        return {"cancelled": True}
    except _PipelineFailed as failed:
        return {"failure": failed.failure.as_json()}
    except BrokenProcessPool:  # killed from outside, as this one could have been
        return {"away": "a process that it had started was ended"}
    except MissingBlob as error:
        return {"missing": str(error.args[0])}
    except StoreFull as error:
        logging.error("store full: %s", error)
        failure = Failure(STORE_FULL, "The artifact store has no room left.", "Free some space, then send it again.")
        return {"failure": failure.as_json()}
    except OSError as error:  # the store or this machine's disk; another try may do
        logging.exception("inputs or outputs")
        return {"away": f"its files could not be moved: {type(error).__name__}"}
    timings = progress.timings()
    return {"files": files, "timings": timings, "stages": progress.stages, "metrics": _metrics(folder)}


class _PipelineFailed(Exception):
    def __init__(self, failure: Failure) -> None:
        super().__init__(failure.message)
        self.failure = failure


def _run(job: dict[str, Any], folder: Path, domain_file: Path, progress: _Progress) -> None:
    try:
        from dualms.pipeline import run_step

        run_step(job["step"], folder, domain_file, Spec.model_validate(job["spec"]), progress, job["device"])
        missing = [name for name in (*ARTIFACTS[job["step"]], *INTERNAL[job["step"]]) if not (folder / name).exists()]
        if missing:
            raise RuntimeError(f"the step left no {missing}")
    except (Cancelled, BrokenProcessPool):
        raise
    except Exception as error:
        raise _PipelineFailed(failure_of(error)) from error


def _fetch_inputs(job: dict[str, Any], store: ArtifactStore, folder: Path) -> Path:
    domain_file = folder / f"domain{job['domain']['suffix']}"
    fetch(store, job["domain"]["sha256"], domain_file)
    for item in job["inputs"]:
        fetch(store, item["sha256"], folder / item["name"])
    if job["checkpoint"] is not None:
        try:
            with tarfile.open(fileobj=io.BytesIO(b"".join(store.get(job["checkpoint"]["sha256"])))) as archive:
                archive.extractall(folder / CHECKPOINT, filter="data")
        except (MissingBlob, tarfile.TarError) as error:
            logging.warning("starting without the checkpoint: %s", error)
    return domain_file


def _store_files(step: Step, store: ArtifactStore, folder: Path) -> list[dict[str, Any]]:
    files = []
    optional = OPTIONAL_ARTIFACTS[step]
    for name in (*ARTIFACTS[step], *INTERNAL[step], *optional):
        path = folder / name
        if name in optional and not path.exists():
            continue
        blob = put_file(store, path)
        files.append({"name": name, "sha256": blob.sha256, "size": blob.size})
    return files


def _metrics(folder: Path) -> dict[str, Any]:
    """The report's figures, without long lists and without what is not about the design."""
    path = folder / "report.json"
    if not path.exists():
        return {}
    document = json.loads(path.read_text())
    figures: dict[str, Any] = _figures(
        {k: v for k, v in document.items() if k not in ("provenance", "timings_s", "spec")}
    )
    return figures


def _figures(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _figures(v) for k, v in value.items() if not (isinstance(v, list) and len(v) > _LONG)}
    return value


class _Channel:
    """Lines of JSON to the parent."""

    def __init__(self, out: BinaryIO) -> None:
        self._out = out
        self._lock = threading.Lock()

    def send(self, message: dict[str, Any]) -> None:
        with self._lock:
            self._out.write(json.dumps(message).encode() + b"\n")
            self._out.flush()


class _Progress:
    """Reports to the parent, keeps stage times, uploads checkpoints, and raises ``Cancelled`` when asked to stop."""

    def __init__(self, channel: _Channel, cancel: threading.Event, store: ArtifactStore, checkpoint: Path) -> None:
        self._channel = channel
        self._cancel = cancel
        self._store = store
        self._checkpoint = checkpoint
        self._saved: tuple[tuple[str, int], ...] = ()
        self._looked = time.monotonic()
        self._stage = ""
        self._stage_began = time.monotonic()
        self._seconds: dict[str, float] = {}
        self.stages: list[tuple[str, float, float]] = []  # with begin and end, seconds since 1970
        self._sent = 0.0

    def report(self, stage: str, fraction: float, note: str = "") -> None:
        if self._cancel.is_set():
            raise Cancelled
        now = time.monotonic()
        changed = stage != self._stage
        if changed:
            self._close_stage(now)
            self._stage = stage
        if changed or fraction >= 1.0 or now - self._sent > _REPORT_S:
            self._sent = now
            self._channel.send({"stage": stage, "fraction": float(fraction), "note": note})
        if now - self._looked > CHECKPOINT_S:
            self._looked = now
            self.save_checkpoint()

    def timings(self) -> dict[str, float]:
        self._close_stage(time.monotonic())
        return {stage: round(seconds, 3) for stage, seconds in self._seconds.items()}

    def save_checkpoint(self) -> None:
        """Store the checkpoint folder if the step has changed it."""
        if not self._checkpoint.is_dir():
            return
        files = sorted(p for p in self._checkpoint.iterdir() if p.is_file() and not p.name.endswith(".partial"))
        state = tuple((p.name, p.stat().st_mtime_ns) for p in files)
        if not files or state == self._saved:
            return
        packed = io.BytesIO()
        with tarfile.open(fileobj=packed, mode="w") as archive:
            for path in files:
                archive.add(path, arcname=path.name)
        try:
            blob = self._store.put([packed.getbuffer().tobytes()])
        except OSError as error:
            logging.warning("going on without storing the checkpoint: %s", error)
            return
        self._saved = state
        self._channel.send({"checkpoint": {"sha256": blob.sha256, "size": blob.size}})

    def _close_stage(self, now: float) -> None:
        if self._stage:
            seconds = now - self._stage_began
            self._seconds[self._stage] = self._seconds.get(self._stage, 0.0) + seconds
            self.stages.append((self._stage, time.time() - seconds, time.time()))
        self._stage_began = now


def _private_stdout() -> BinaryIO:
    """The pipe to the parent; what libraries print to stdout goes to stderr instead."""
    private = os.dup(1)
    os.dup2(2, 1)
    return os.fdopen(private, "wb")


def _listen(cancel: threading.Event) -> None:
    """Wait for the parent's word; a closed pipe says the same."""
    sys.stdin.readline()
    cancel.set()


def _die_with(parent: int) -> None:
    """End when the parent ends, however it ends (Linux); elsewhere the closed pipe must do."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(1, int(signal.SIGKILL))
    if os.getppid() != parent:
        os._exit(1)


if __name__ == "__main__":
    main()
