"""Rows of designs, written in the caller's transaction: added, changed, ended.

Every visible change gives a design a new version and one event of that number. Nothing else writes a design's status.
"""

from __future__ import annotations

import secrets
import time
from dataclasses import dataclass
from typing import Any

from sqlalchemy import delete, func, select, update
from sqlalchemy.orm import Session

from dualms.spec import Spec
from dualms.steps import steps_of
from worker import tables, totals, views
from worker.database import Now
from worker.outbox import record_ending
from worker.routing import queue_of
from worker.views import Status


@dataclass(frozen=True)
class NewDesign:
    """A design to record; ``spec`` must be resolved (no ``auto``, units filled in)."""

    domain_id: str
    spec: Spec
    name: str | None = None
    labels: tuple[str, ...] = ()
    webhook: str | None = None
    deadline_s: float | None = None
    owner: str | None = None
    study_id: str | None = None
    priority: int = 0
    trace: str | None = None  # the span that asked for it, as W3C traceparent


def new_id() -> str:
    """32 hexadecimal digits that sort by time (to the millisecond), random after that."""
    return id_at(time.time()) + secrets.token_hex(10)


def id_at(seconds: float) -> str:
    """The first 12 digits of the ids that are made at a time."""
    return f"{min(max(int(seconds * 1000), 0), 16**12 - 1):012x}"


def add_design(session: Session, new: NewDesign, design_id: str, now: float, live: frozenset[str]) -> tables.Design:
    """Write the rows of a queued design.

    Parameters
    ----------
    session
        One that writes.
    new, design_id
        What to make, and its id.
    now
        Seconds since 1970 by the database's clock.
    live
        Queues that some worker serves.
    """
    step = steps_of(new.spec)[0]
    row = tables.Design(
        id=design_id,
        domain_id=new.domain_id,
        spec=new.spec.model_dump(mode="json"),
        name=new.name,
        labels=list(new.labels),
        webhook=new.webhook,
        owner=new.owner,
        study_id=new.study_id,
        priority=new.priority,
        status="queued",
        step=step,
        queue=queue_of(step, new.spec, live),
        stage=None,
        progress=0.0,
        note="",
        attempt=0,
        tries=0,
        lease_until=None,
        worker_id=None,
        dispatched_at=now,
        waiting_since=now,
        created_at=now,
        started_at=None,
        finished_at=None,
        deadline_at=now + new.deadline_s if new.deadline_s is not None else None,
        timings={},
        metrics={},
        error=None,
        checkpoint=None,
        hints={"trace": new.trace} if new.trace is not None else {},
        version=1,
    )
    session.add(row)
    session.flush()
    session.add_all(tables.DesignLabel(label=label, design_id=row.id) for label in sorted(set(new.labels)))
    session.add(tables.Event(design_id=row.id, sequence=1, kind="queued", data={}, created_at=now))
    return row


def live_queues(session: Session, gone_s: float) -> frozenset[str]:
    """Queues with a worker that has shown signs of life within ``gone_s``, either side of now: clocks are set back."""
    w = tables.Worker
    lives = func.abs(Now() - w.heartbeat_at) < gone_s
    return frozenset(session.scalars(select(w.queue).where(lives, w.draining.is_(False))))


def end(
    session: Session, design_id: str, status: Status, data: dict[str, Any], *conditions: Any, **values: Any
) -> bool:
    """Bring a design that has not ended to its final status, with one event; the only way to end one.

    Parameters
    ----------
    session
        One that writes.
    design_id, status, data
        Which design, how it ended, what the event says.
    conditions
        Further conditions on the row, such as the fence.
    values
        Further columns to set.

    Returns
    -------
    bool
        False if the design had ended before, or a condition does not hold; then nothing was written.
    """
    values = {
        "status": status,
        "finished_at": Now(),
        "lease_until": None,
        "worker_id": None,
        "checkpoint": None,
    } | values
    if not change(session, design_id, status, data, *conditions, attempt=tables.Design.attempt + 1, **values):
        return False
    session.execute(delete(tables.Event).where(tables.Event.design_id == design_id, tables.Event.kind == "progress"))
    record_ending(session, design_id, status)
    totals.add(session, "ended", {status: 0.0})
    if status == "failed":
        totals.add(session, "failure", {str(data["error"]["code"]): 0.0})
    return True


def change(session: Session, design_id: str, kind: str, data: dict[str, Any], *conditions: Any, **values: Any) -> bool:
    """Write columns of a design that has not ended, and the event that says so; False if a condition does not hold."""
    d = tables.Design
    version = session.execute(
        update(d)
        .where(d.id == design_id, d.status.in_(views.LIVE), *conditions)
        .values(version=d.version + 1, **values)
        .returning(d.version)
        .execution_options(synchronize_session=False)
    ).scalar_one_or_none()
    if version is None:
        return False
    session.add(tables.Event(design_id=design_id, sequence=version, kind=kind, data=data, created_at=moment(session)))
    return True


def moment(session: Session) -> float:
    """Seconds since 1970 by the database's clock."""
    return session.execute(select(Now())).scalar_one()
