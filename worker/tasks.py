"""What a woken worker does: claim a step, carry it out in a child, record what came of it, wake whoever is next.

Running it twice is harmless: the second claims nothing, or another step that waits.
"""

from __future__ import annotations

import logging
import threading
from dataclasses import dataclass

from celery import Celery

from dualms.spec import NeuralField, Spec
from worker.artifacts import ArtifactStore
from worker.child import Limits, Outcome, Watch, run_child
from worker.failures import GPU_OUT_OF_MEMORY, Failure, failure_of
from worker.leases import Lease, Leases, StepRecord, files_from
from worker.logs import current_job
from worker.queue import TASK, Wakeups
from worker.scratch import step_folder
from worker.settings import Settings
from worker.views import DesignRecord

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Station:
    """Where steps of one queue are carried out: what the task needs, made once a process."""

    queue: str
    worker_id: str
    settings: Settings
    leases: Leases
    store: ArtifactStore
    wakeups: Wakeups
    drain: threading.Event

    @property
    def device(self) -> str:
        """Torch device of this queue's steps."""
        return "cuda" if self.queue == "gpu" else "cpu"

    @property
    def limits(self) -> Limits:
        """What one step may take."""
        s = self.settings
        return Limits(s.step_memory_bytes, s.step_seconds, s.grace_s, s.heartbeat_s, s.drain_s)


def register(app: Celery, station: Station) -> None:
    """Add the one task to the app."""

    @app.task(name=TASK)
    def step(job_id: str, step: str) -> None:
        take_one(station)


def take_one(station: Station) -> bool:
    """Carry out the step that is first in the queue; False if none waits or the worker is to end."""
    if station.drain.is_set():
        return False
    lease = station.leases.claim(station.queue, station.worker_id)
    if lease is None:
        return False
    with current_job(lease.id):
        log.info("step %s, try %d", lease.step, lease.design.tries)
        try:
            following = carry_out(station, lease)
        except Exception as error:  # noqa: BLE001 - the task's boundary: whatever went wrong ends up in the record
            station.leases.fail(lease, failure_of(error))
            return True
        if following is not None and not following.final:
            station.wakeups.send(following)
    return True


def carry_out(station: Station, lease: Lease) -> DesignRecord | None:
    """Carry out a claimed step. Returns the design where something is left to do with it."""
    leases, store = station.leases, station.store
    result = leases.cached(lease)
    if result is not None:
        if all(store.size(file.sha256) == file.size for file in result.files):
            log.info("step %s: reused", lease.step)
            return leases.commit(lease, StepRecord(result.files, result.metrics, {}), reused=True)
        leases.forget(lease.key)
    outcome = _run(station, lease)
    log.info("step %s: %s %s", lease.step, outcome.ending, outcome.reason)
    match outcome.ending:
        case "done":
            files = files_from(outcome.result["files"])
            record = StepRecord(files, outcome.result["metrics"], outcome.result["timings"])
            return leases.commit(lease, record)
        case "failed":
            return _failed(station, lease, outcome.failure or failure_of(RuntimeError("no failure given")))
        case "missing":
            return leases.start_over(lease, outcome.reason)
        case "stopped":
            # If the lease is lost this writes nothing; else the worker is to end, which is not the step's fault.
            return leases.hand_back(lease, "its worker was stopped", counts=False)
        case "lost":
            return leases.hand_back(lease, outcome.reason)


def _run(station: Station, lease: Lease) -> Outcome:
    job = {
        "step": lease.step,
        "spec": lease.design.spec,
        "domain": {"sha256": lease.domain.sha256, "suffix": lease.domain.suffix},
        "inputs": [{"name": file.name, "sha256": file.sha256} for file in lease.inputs],
        "checkpoint": lease.checkpoint,
        "device": station.device,
    }
    watch = Watch(
        beat=lambda report: station.leases.renew(lease, report),
        checkpoint=lambda sha256, size: station.leases.keep_checkpoint(lease, sha256, size),
        drain=station.drain,
    )
    with step_folder(station.settings.scratch) as folder:
        return run_child(job, folder, station.limits, watch)


def _failed(station: Station, lease: Lease, failure: Failure) -> DesignRecord | None:
    """Record a failure; a GPU that is too small gets a smaller batch first, once, and the record says so."""
    field = lease.spec.field
    if failure.code == GPU_OUT_OF_MEMORY and isinstance(field, NeuralField) and "points" not in lease.hints:
        points = max(field.points // 4, 64)
        smaller: Spec = lease.spec.model_copy(update={"field": field.model_copy(update={"points": points})})
        reason = f"the GPU's memory is too small for {field.points} points a step; again with {points}"
        return station.leases.hand_back(lease, reason, spec=smaller, points=points)
    station.leases.fail(lease, failure)
    return None
