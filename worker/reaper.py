"""The reaper: gives back what dead workers held, repeats lost messages, ends what is late.

Every worker process runs one. Each of its writes is conditional on what it has read, so any number may run at once.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass

from sqlalchemy import delete, func, or_, select, update

from dualms.spec import Spec
from worker import tables, views
from worker.database import Now
from worker.failures import deadline_exceeded
from worker.host import is_alive, this_host
from worker.queue import Wakeups
from worker.records import Records
from worker.requeue import Requeue
from worker.routing import QUEUES, queue_of
from worker.rows import change, end, live_queues
from worker.views import DesignRecord

RESEND_S = 5.0  # a message younger than this may still be on its way
log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Reaped:
    """What one round has done, in numbers of designs."""

    overdue: int
    taken_away: int
    rerouted: int
    resent: int


class Reaper:
    """Looks after designs that nobody looks after."""

    def __init__(self, records: Records, wakeups: Wakeups) -> None:
        self._database = records.database
        self._settings = records.settings
        self._requeue = Requeue(records)
        self._wakeups = wakeups
        self._host = this_host()

    def run_once(self) -> Reaped:
        """One round."""
        self._forget_dead_workers()
        overdue = self._end_overdue()
        taken = self._take_away_expired()
        rerouted = self._reroute()
        return Reaped(overdue, taken, rerouted, self._resend())

    def _forget_dead_workers(self) -> None:
        """Unregister workers of this machine whose process is gone, and any that has been silent for an hour."""
        w = tables.Worker
        with self._database.read() as session:
            mine = session.scalars(select(w).where(w.host == self._host)).all()
        dead = [worker.id for worker in mine if not is_alive(worker.pid, worker.pid_started)]
        with self._database.write() as session:
            session.execute(delete(w).where(or_(w.id.in_(dead), w.heartbeat_at < Now() - 3600)))

    def _end_overdue(self) -> int:
        d = tables.Design
        late = (d.status.in_(views.LIVE), d.deadline_at.is_not(None), d.deadline_at <= Now())
        with self._database.read() as session:
            rows = session.scalars(select(d).where(*late)).all()
        count = 0
        for row in rows:
            error = deadline_exceeded((row.deadline_at or 0.0) - row.created_at).as_json()
            with self._database.write() as session:
                count += end(session, row.id, "failed", {"error": error}, *late, error=error)
        return count

    def _take_away_expired(self) -> int:
        """Designs whose lease has run out, or whose worker is not registered any more.

        A lease that ends implausibly late was granted before the clock was set back; it counts as expired too.
        """
        d, w = tables.Design, tables.Worker
        unregistered = d.worker_id.not_in(select(w.id))
        latest = Now() + 2 * self._settings.lease_s
        query = select(d).where(
            d.status == "running",
            d.lease_until.is_not(None),
            or_(d.lease_until < Now(), d.lease_until > latest, unregistered),
        )
        with self._database.read() as session:
            rows = session.scalars(query).all()
        count = 0
        for row in rows:
            taken = self._requeue.expire(views.design_record(row), "its worker went away")
            if taken is not None:
                count += 1
                log.warning("took step %s away from a lost worker", row.step, extra={"job_id": row.id})
                self._send(taken)
        return count

    def _reroute(self) -> int:
        """Steps that wait for a kind of worker that is gone, and that another kind can do."""
        d = tables.Design
        count = 0
        with self._database.read() as session:
            live = live_queues(session, self._settings.worker_gone_s)
            gone = [queue for queue in QUEUES if queue not in live]
            rows = session.scalars(
                select(d).where(d.status.in_(views.LIVE), d.lease_until.is_(None), d.queue.in_(gone))
            ).all()
        for row in rows:
            queue = queue_of(row.step, Spec.model_validate(row.spec), live)  # type: ignore[arg-type]
            if queue == row.queue or queue not in live:
                continue
            with self._database.write() as session:
                reason = {"step": row.step, "reason": f"no {row.queue} worker is left; {queue} takes it"}
                moved = change(session, row.id, "retrying", reason, d.attempt == row.attempt, queue=queue)
            if moved:
                count += 1
                self._wakeups.send_to(queue, row.id, row.step)
        return count

    def _resend(self) -> int:
        """Messages for steps that wait while their queue at the broker holds fewer messages than steps wait.

        A message sent in the future was sent before the clock was set back; it is repeated, too.
        """
        d = tables.Design
        count = 0
        for queue in QUEUES:
            waits = (d.queue == queue, d.status.in_(views.LIVE), d.lease_until.is_(None))
            with self._database.read() as session:
                ids = session.execute(select(d.id, d.step).where(*waits).order_by(d.id).limit(10_000)).all()
            length = self._wakeups.length(queue) if ids else None
            if length is None:
                continue
            for design_id, step in ids[: max(len(ids) - length, 0)]:
                with self._database.write() as session:
                    mine = session.execute(
                        update(d)
                        .where(d.id == design_id, *waits, func.abs(Now() - d.dispatched_at) > RESEND_S)
                        .values(dispatched_at=Now())
                        .returning(d.id)
                        .execution_options(synchronize_session=False)
                    ).scalar_one_or_none()
                if mine is not None and self._wakeups.send_to(queue, design_id, step):
                    count += 1
        return count

    def _send(self, design: DesignRecord) -> None:
        if not design.final:
            self._wakeups.send(design)
