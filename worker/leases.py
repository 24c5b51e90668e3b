"""Leases: who works on a design's step, until when, and what only they may write.

A lease is a row's ``(attempt, worker_id, lease_until)``. Claiming a step and taking it away both raise ``attempt``, and
every write of a worker names the attempt that it was given: whoever comes late hits no row and learns that it lost.

A message names a design, but a woken worker claims whatever is first in its queue: by priority, then the owner with the
fewest running designs, then age. So a lost, repeated or reordered message changes nothing but the moment of waking.
"""

from __future__ import annotations

import contextlib
from pathlib import PurePath
from typing import Any

from sqlalchemy import delete, func, or_, select, update
from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from dualms.spec import Spec
from dualms.steps import INTERNAL, MEDIA_TYPES, Step, steps_of
from worker import tables, totals, views
from worker.code import code_id
from worker.database import Now
from worker.failures import Failure, worker_lost
from worker.lease import FileRecord, Lease, StepRecord, files_from
from worker.records import Records, change, end, live_queues
from worker.routing import queue_of
from worker.views import DesignRecord
from worker.weights import progress_of


class Leases:
    """What workers do to the records."""

    def __init__(self, records: Records) -> None:
        self.records = records
        self.settings = records.settings
        self._database = records.database

    def claim(self, queue: str, worker_id: str) -> Lease | None:
        """Take the first step that waits in a queue; None where none waits."""
        d = tables.Design
        running = (
            select(d.owner, func.count().label("n"))
            .where(d.status == "running", d.lease_until.is_not(None))
            .group_by(d.owner)
            .subquery()
        )
        first = (
            select(d.id)
            .outerjoin(running, running.c.owner.is_not_distinct_from(d.owner))
            .where(d.queue == queue, d.status.in_(views.LIVE), d.lease_until.is_(None))
            .where(or_(d.deadline_at.is_(None), d.deadline_at > Now()))
            .order_by(d.priority.desc(), func.coalesce(running.c.n, 0), d.id)
            .limit(1)
            .with_for_update(of=d, skip_locked=True)
        )
        with self._database.write() as session:
            design_id = session.scalars(first).first()
            if design_id is None:
                return None
            row = session.get_one(tables.Design, design_id)
            change(
                session,
                design_id,
                "started",
                {"step": row.step, "try": row.tries + 1},
                d.attempt == row.attempt,
                status="running",
                attempt=d.attempt + 1,
                tries=d.tries + 1,
                worker_id=worker_id,
                lease_until=Now() + self.settings.lease_s,
                started_at=func.coalesce(d.started_at, Now()),
            )
            session.refresh(row)
            domain = session.get_one(tables.Domain, row.domain_id)
            files = session.scalars(select(tables.DesignArtifact).where(tables.DesignArtifact.design_id == design_id))
            return Lease(
                design=views.design_record(row),
                domain=views.domain_record(domain),
                attempt=row.attempt,
                worker_id=worker_id,
                inputs=tuple(views.artifact_record(file) for file in files),
                checkpoint=row.checkpoint,
                hints=dict(row.hints),
                waiting_since=row.waiting_since if row.waiting_since is not None else row.created_at,
            )

    def renew(self, lease: Lease, report: tuple[str, float, str] | None = None) -> bool:
        """Keep a lease, and record how far the step is.

        Parameters
        ----------
        lease
            What was claimed.
        report
            Stage, done part of the stage and note, where they changed.

        Returns
        -------
        bool
            False if the lease is lost: the design was cancelled, deleted, ended, or given to another worker.
        """
        d = tables.Design
        until = Now() + self.settings.lease_s
        with self._database.write() as session:
            if report is None:
                statement = update(d).where(d.id == lease.id, d.attempt == lease.attempt, d.status == "running")
                found = session.execute(
                    statement.values(lease_until=until).returning(d.id).execution_options(synchronize_session=False)
                )
                return found.scalar_one_or_none() is not None
            stage, fraction, note = report
            whole = max(lease.design.progress, self._progress(lease, stage, fraction))
            return change(
                session,
                lease.id,
                "progress",
                {"stage": stage, "fraction": round(fraction, 4), "progress": round(whole, 4), "note": note},
                d.attempt == lease.attempt,
                lease_until=until,
                stage=stage,
                progress=whole,
                note=note[:500],
            )

    def keep_checkpoint(self, lease: Lease, sha256: str, size: int) -> bool:
        """Record where the step could go on after its process was lost; False if the lease is lost."""
        d = tables.Design
        with self._database.write() as session:
            found = session.execute(
                update(d)
                .where(d.id == lease.id, d.attempt == lease.attempt, d.status == "running")
                .values(checkpoint={"sha256": sha256, "size": size}, lease_until=Now() + self.settings.lease_s)
                .returning(d.id)
                .execution_options(synchronize_session=False)
            )
            return found.scalar_one_or_none() is not None

    def cached(self, lease: Lease) -> StepRecord | None:
        """What an earlier run of the same step with the same inputs has produced."""
        with self._database.write() as session:
            row = session.get(tables.StepResult, lease.key)
            if row is None:
                return None
            row.used_at = session.execute(select(Now())).scalar_one()
            files = session.scalars(select(tables.StepFile).where(tables.StepFile.key == lease.key)).all()
            return StepRecord(
                tuple(FileRecord(f.name, f.sha256, f.size) for f in files), dict(row.metrics), dict(row.timings)
            )

    def forget(self, key: str) -> None:
        """Forget a cached result whose files are gone."""
        with self._database.write() as session:
            session.execute(delete(tables.StepFile).where(tables.StepFile.key == key))
            session.execute(delete(tables.StepResult).where(tables.StepResult.key == key))

    def commit(self, lease: Lease, result: StepRecord, reused: bool = False) -> DesignRecord | None:
        """Record a step's result, and make the next step wait or the design succeed.

        Returns
        -------
        DesignRecord or None
            The design afterwards; None if the lease is lost, and then nothing was written.
        """
        d = tables.Design
        spec = lease.spec
        steps = steps_of(spec)
        following = steps[steps.index(lease.step) + 1 :]
        timings = lease.design.timings | result.timings
        metrics = lease.design.metrics | result.metrics
        data = {"step": lease.step, "artifacts": [f.name for f in result.files], "reused": reused}
        with self._database.write() as session:
            if following:
                kept = change(
                    session,
                    lease.id,
                    "reused" if reused else "step",
                    data,
                    d.attempt == lease.attempt,
                    attempt=d.attempt + 1,
                    tries=0,
                    checkpoint=None,
                    progress=progress_of(steps, _is_neural(spec), following[0], None, 0.0),
                    timings=timings,
                    metrics=metrics,
                    hints=lease.hints | {"code": code_id()},
                    **self._waiting(session, following[0], spec),
                )
            else:
                kept = end(
                    session,
                    lease.id,
                    "succeeded",
                    data,
                    d.attempt == lease.attempt,
                    progress=1.0,
                    note="",
                    timings=timings,
                    metrics=metrics,
                )
            if not kept:
                return None
            self._add_files(session, lease, result)
            totals.add(session, "stage", result.timings)
            if reused:
                totals.add(session, "reused", {lease.step: 0.0})
            return views.design_record(session.get_one(tables.Design, lease.id, populate_existing=True))

    def fail(self, lease: Lease, failure: Failure) -> bool:
        """End the design as failed; False if the lease is lost."""
        error = failure.as_json()
        with self._database.write() as session:
            return end(
                session, lease.id, "failed", {"error": error}, tables.Design.attempt == lease.attempt, error=error
            )

    def hand_back(
        self, lease: Lease, reason: str, *, counts: bool = True, spec: Spec | None = None, **hints: Any
    ) -> DesignRecord | None:
        """Give a step back, to be started again by anyone.

        Parameters
        ----------
        lease
            What was claimed.
        reason
            For people and the log.
        counts
            Whether this start counts towards ``max_tries`` (being asked to stop does not).
        spec
            A specification to go on with instead, such as one with a smaller batch.
        hints
            Kept with the design.

        Returns
        -------
        DesignRecord or None
            The design afterwards, failed if it was started often enough; None if the lease is lost.
        """
        values: dict[str, Any] = {"hints": lease.hints | hints}
        if spec is not None:
            values |= {"spec": spec.model_dump(mode="json"), "checkpoint": None}
        with self._database.write() as session:
            return self._take_away(
                session, lease.design, reason, tables.Design.attempt == lease.attempt, counts=counts, **values
            )

    def start_over(self, lease: Lease, reason: str) -> DesignRecord | None:
        """Go back to the first step, because an input is gone or unreadable; what is still good is reused."""
        first = steps_of(lease.spec)[0]
        rounds = int(lease.hints.get("rounds", 0)) + 1
        if rounds > self.settings.max_tries:
            self.fail(lease, worker_lost(lease.step, rounds, reason))
            return None
        with self._database.write() as session:
            return self._take_away(
                session,
                lease.design,
                reason,
                tables.Design.attempt == lease.attempt,
                counts=False,
                step=first,
                hints={k: v for k, v in lease.hints.items() if k != "code"} | {"rounds": rounds},
                checkpoint=None,
            )

    def expire(self, design: DesignRecord, reason: str) -> DesignRecord | None:
        """Take a step away from a worker that is gone; None if the row has moved on meanwhile."""
        d = tables.Design
        with self._database.write() as session:
            return self._take_away(
                session, design, reason, d.attempt == design.attempt, d.lease_until.is_not(None), counts=True
            )

    # ----------------------------------------------------------------------------------------------------------

    def _take_away(
        self, session: Session, design: DesignRecord, reason: str, *conditions: Any, counts: bool, **values: Any
    ) -> DesignRecord | None:
        d = tables.Design
        if counts and design.tries >= self.settings.max_tries:
            error = worker_lost(design.step, design.tries, reason).as_json()
            kept = end(session, design.id, "failed", {"error": error}, *conditions, error=error)
        else:
            step = values.get("step", design.step)
            kept = change(
                session,
                design.id,
                "retrying",
                {"step": step, "reason": reason},
                *conditions,
                attempt=d.attempt + 1,
                tries=d.tries if counts else d.tries - 1,  # a lease implies at least one try
                **self._waiting(session, step, Spec.model_validate(values.get("spec", design.spec))) | values,
            )
        if not kept:
            return None
        return views.design_record(session.get_one(tables.Design, design.id, populate_existing=True))

    def _waiting(self, session: Session, step: Step, spec: Spec) -> dict[str, Any]:
        """Columns of a design whose step waits for a worker."""
        return {
            "step": step,
            "queue": queue_of(step, spec, live_queues(session, self.settings.worker_gone_s)),
            "lease_until": None,
            "worker_id": None,
            "dispatched_at": Now(),
            "waiting_since": Now(),
        }

    def _progress(self, lease: Lease, stage: str, fraction: float) -> float:
        return progress_of(steps_of(lease.spec), _is_neural(lease.spec), lease.step, stage, fraction)

    def _add_files(self, session: Session, lease: Lease, result: StepRecord) -> None:
        now = session.execute(select(Now())).scalar_one()
        a = tables.DesignArtifact
        names = [file.name for file in result.files]
        session.execute(delete(a).where(a.design_id == lease.id, a.name.in_(names)))
        session.add_all(
            a(
                design_id=lease.id,
                name=file.name,
                step=lease.step,
                sha256=file.sha256,
                size=file.size,
                media_type=MEDIA_TYPES.get(PurePath(file.name).suffix, "application/octet-stream"),
                internal=file.name in INTERNAL[lease.step],
                created_at=now,
            )
            for file in result.files
        )
        with contextlib.suppress(IntegrityError), session.begin_nested():  # another design may have been as fast
            session.add(
                tables.StepResult(
                    key=lease.key,
                    step=lease.step,
                    metrics=result.metrics,
                    timings=result.timings,
                    created_at=now,
                    used_at=now,
                )
            )
            session.flush()
            session.add_all(
                tables.StepFile(key=lease.key, name=f.name, sha256=f.sha256, size=f.size) for f in result.files
            )


def _is_neural(spec: Spec) -> bool:
    return spec.field.method not in ("auto", "phase-field")


__all__ = ["FileRecord", "Lease", "Leases", "StepRecord", "files_from"]
