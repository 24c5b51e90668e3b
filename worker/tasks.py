"""What a woken worker does: claim a step, carry it out in a child, record what came of it, wake whoever is next.

Running it twice is harmless: the second claims nothing, or another step that waits.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from celery import Celery

from dualms.spec import DistilledField, NeuralField, Spec
from worker.artifacts import ArtifactStore
from worker.child import Limits, Outcome, Watch, run_child
from worker.failures import GPU_OUT_OF_MEMORY, STORE_FULL, Failure, failure_of
from worker.lease import Lease, StepRecord, files_from
from worker.leases import Leases
from worker.logs import current_job
from worker.patience import AWAY, patiently
from worker.queue import TASK, Wakeups
from worker.room import short_of_room
from worker.scratch import step_folder
from worker.settings import Settings
from worker.tracing import Attributes, Tracing
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
    free: threading.Semaphore = field(default_factory=threading.Semaphore)  # one for each step at once
    tracing: Tracing = field(default_factory=Tracing)

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
        take_all(station)


def take_all(station: Station) -> None:
    """Carry out what waits in the queue, step after step: while there is work, no message is needed."""
    while take_one(station):
        pass


def take_one(station: Station) -> bool:
    """Carry out the step that is first in the queue; False if none waits, or the worker is busy or to end."""
    if station.drain.is_set() or not station.free.acquire(blocking=False):
        return False
    try:
        return _take_first(station)
    finally:
        station.free.release()


def _take_first(station: Station) -> bool:
    if (full := short_of_room(station.settings, station.store)) is not None:
        log.warning("steps wait: less than %d MiB are free in %s", station.settings.free_bytes >> 20, full)
        return False
    lease = station.leases.claim(station.queue, station.worker_id)
    if lease is None:
        return False
    with current_job(lease.id), _span(station, lease):
        log.info("step %s, try %d", lease.step, lease.design.tries)
        try:
            following = _carry_out_or_record_why_not(station, lease)
        except AWAY:
            log.exception("the records are away; the lease runs out, and the step will be done again")
            return False
        if following is not None and not following.final:
            station.wakeups.send(following)
    return True


@contextmanager
def _span(station: Station, lease: Lease) -> Iterator[None]:
    """The step's span, in the trace of the request that asked for the design; in it the time in the queue."""
    with station.tracing.span(f"step {lease.step}", lease.trace):
        facts: Attributes = {"dualms.job_id": lease.id, "dualms.queue": station.queue, "dualms.try": lease.design.tries}
        station.tracing.note(facts)
        station.tracing.past(f"queue {station.queue}", lease.waiting_since, time.time())
        yield


def carry_out(station: Station, lease: Lease) -> DesignRecord | None:
    """Carry out a claimed step. Returns the design where something is left to do with it."""
    leases, store = station.leases, station.store
    patience_s = station.settings.lease_s
    if lease.of_other_code:
        reason = "DualMS was updated since the earlier steps"
        return patiently(lambda: leases.requeue.start_over(lease, reason), patience_s)
    result = patiently(lambda: leases.cache.find(lease.key), patience_s)
    if result is not None:
        if all(store.size(file.sha256) == file.size for file in result.files):
            log.info("step %s: reused", lease.step)
            record = StepRecord(result.files, result.metrics, {})
            return patiently(lambda: leases.commit(lease, record, reused=True), patience_s)
        leases.cache.forget(lease.key)
    outcome = _run(station, lease)
    if outcome.ending != "done":
        station.tracing.fail(outcome.failure.code if outcome.failure is not None else outcome.reason)
    log.info("step %s: %s %s", lease.step, outcome.ending, outcome.reason)
    return patiently(lambda: _record(station, lease, outcome), patience_s)


def _carry_out_or_record_why_not(station: Station, lease: Lease) -> DesignRecord | None:
    patience_s = station.settings.lease_s
    try:
        return carry_out(station, lease)
    except AWAY:
        raise
    except OSError as error:  # the store or the scratch folder, not the design
        reason = f"this machine could not run it: {type(error).__name__}"
        log.exception("step %s: %s", lease.step, reason)
        return patiently(lambda: station.leases.requeue.hand_back(lease, reason), patience_s)
    except Exception as error:  # noqa: BLE001 - the task's boundary: whatever went wrong ends up in the record
        failure = failure_of(error)
        patiently(lambda: station.leases.fail(lease, failure), patience_s)
        return None


def _record(station: Station, lease: Lease, outcome: Outcome) -> DesignRecord | None:
    leases = station.leases
    match outcome.ending:
        case "done":
            files = files_from(outcome.result["files"])
            design = leases.commit(lease, StepRecord(files, outcome.result["metrics"], outcome.result["timings"]))
            if design is None:
                log.warning("the lease is lost: the result comes too late")
            return design
        case "failed":
            return _failed(station, lease, outcome.failure or failure_of(RuntimeError("no failure given")))
        case "missing":
            return leases.requeue.start_over(lease, outcome.reason)
        case "stopped":
            # If the lease is lost this writes nothing; else the worker is to end, which is not the step's fault.
            return leases.requeue.hand_back(lease, "its worker was stopped", counts=False)
        case "lost":
            return leases.requeue.hand_back(lease, outcome.reason)


def _run(station: Station, lease: Lease) -> Outcome:
    job = {
        "step": lease.step,
        "spec": lease.design.spec,
        "domain": {"sha256": lease.domain.sha256, "suffix": lease.domain.suffix},
        "inputs": [{"name": file.name, "sha256": file.sha256} for file in lease.inputs],
        "checkpoint": lease.checkpoint,
        "device": station.device,
    }
    hold = _Hold(station, lease)
    watch = Watch(
        beat=lambda report: hold.keep(lambda: station.leases.renew(lease, report)),
        checkpoint=lambda sha256, size: hold.keep(lambda: station.leases.keep_checkpoint(lease, sha256, size)),
        drain=station.drain,
    )
    with step_folder(station.settings.scratch, lease.id) as folder:
        outcome = run_child(job, folder, station.limits, watch)
    for stage, began, ended in outcome.result.get("stages", []):
        station.tracing.past(f"stage {stage}", began, ended)
    return outcome


class _Hold:
    """Whether the lease still holds, as far as one can know while the records are away: until it would run out."""

    def __init__(self, station: Station, lease: Lease) -> None:
        self._until_s = station.settings.lease_s
        self._lease = lease
        self._kept = time.monotonic()

    def keep(self, write: Callable[[], bool]) -> bool:
        try:
            kept = write()
        except AWAY as error:
            log.warning("cannot renew the lease: %s", error)
            return time.monotonic() - self._kept < self._until_s
        self._kept = time.monotonic()
        if not kept:
            log.warning("the lease is lost: the step is stopped")
        return kept


def _failed(station: Station, lease: Lease, failure: Failure) -> DesignRecord | None:
    """Record a failure, unless another try may do.

    A GPU that is too small gets a smaller batch, once, and the record says so; a full store may have room again.
    """
    method = lease.spec.field
    too_small = failure.code == GPU_OUT_OF_MEMORY and "points" not in lease.hints
    if too_small and isinstance(method, NeuralField | DistilledField):
        points = max(method.points // 4, 64)
        smaller: Spec = lease.spec.model_copy(update={"field": method.model_copy(update={"points": points})})
        reason = f"the GPU's memory is too small for {method.points} points a step; again with {points}"
        return station.leases.requeue.hand_back(lease, reason, spec=smaller, points=points)
    if failure.code == STORE_FULL:
        return station.leases.requeue.hand_back(lease, failure.message, failure=failure)
    station.leases.fail(lease, failure)
    return None
