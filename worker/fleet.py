"""Workers and queues as people and metrics see them: who is alive, what waits, what runs."""

from __future__ import annotations

from sqlalchemy import and_, func, select

from worker import tables, views
from worker.database import Database
from worker.routing import QUEUES
from worker.rows import moment
from worker.views import QueueFacts, WorkerRecord


def workers(database: Database, gone_s: float) -> tuple[WorkerRecord, ...]:
    """All registered workers; ``alive`` where the last heartbeat is younger than ``gone_s``."""
    with database.read() as session:
        now = moment(session)
        rows = session.scalars(select(tables.Worker).order_by(tables.Worker.started_at)).all()
        return tuple(views.worker_record(row, abs(now - row.heartbeat_at) < gone_s) for row in rows)


def queues(database: Database, gone_s: float) -> tuple[QueueFacts, ...]:
    """What waits and runs on each queue, and how many living workers serve it."""
    d, w = tables.Design, tables.Worker
    waits = and_(d.status.in_(views.LIVE), d.lease_until.is_(None))
    runs = and_(d.status == "running", d.lease_until.is_not(None))
    with database.read() as session:
        now = moment(session)
        counts = {
            name: (waiting, running, now - oldest if oldest is not None else 0.0)
            for name, waiting, running, oldest in session.execute(
                select(
                    d.queue,
                    func.count().filter(waits),
                    func.count().filter(runs),
                    func.min(d.waiting_since).filter(waits),
                )
                .where(d.status.in_(views.LIVE))
                .group_by(d.queue)
            )
        }
        living = select(w.queue, func.count()).where(func.abs(now - w.heartbeat_at) < gone_s).group_by(w.queue)
        alive = {row[0]: row[1] for row in session.execute(living)}
    return tuple(QueueFacts(name, *counts.get(name, (0, 0, 0.0)), alive.get(name, 0)) for name in QUEUES)
