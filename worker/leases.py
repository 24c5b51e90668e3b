"""Leases: who works on a design's step, until when, and what only they may write.

A lease is a row's ``(attempt, worker_id, lease_until)``. Claiming a step and taking it away both raise ``attempt``, and
every write of a worker names the attempt that it was given: whoever comes late hits no row and learns that it lost.

A message names a design, but a woken worker claims whatever is first in its queue: the owner with the fewest running
designs, then priority, then age. So a lost, repeated or reordered message changes nothing but the moment of waking.
"""

from __future__ import annotations

from sqlalchemy import func, or_, select, update

from dualms.spec import Spec
from dualms.steps import STEPS, steps_of
from worker import tables, totals, views
from worker.code import code_id
from worker.database import Now
from worker.failures import Failure
from worker.lease import Lease, StepRecord
from worker.records import Records
from worker.requeue import Requeue, waiting
from worker.rows import change, end
from worker.step_cache import StepCache, add_result
from worker.views import DesignRecord
from worker.weights import progress_of


class Leases:
    """What workers do to the records: ``requeue`` gives steps back, ``cache`` knows those that were carried out."""

    def __init__(self, records: Records) -> None:
        self.records = records
        self.settings = records.settings
        self.requeue = Requeue(records)
        self.cache = StepCache(records.database)
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
            .order_by(func.coalesce(running.c.n, 0), d.priority.desc(), d.id)
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
            # A design that starts over still lists what its later steps made, which may be gone.
            earlier = STEPS[: STEPS.index(row.step)]
            a = tables.DesignArtifact
            files = session.scalars(select(a).where(a.design_id == design_id, a.step.in_(earlier)))
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
                    **waiting(session, following[0], spec, self.settings.worker_gone_s),
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
            add_result(session, lease, result)
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

    def _progress(self, lease: Lease, stage: str, fraction: float) -> float:
        return progress_of(steps_of(lease.spec), _is_neural(lease.spec), lease.step, stage, fraction)


def _is_neural(spec: Spec) -> bool:
    return spec.field.method not in ("auto", "phase-field")
