"""The records as clients of the service use them: domains, designs, events, artifacts, workers.

What the holder of a lease may write is in :mod:`worker.leases`. Methods block for one short transaction; call them from
threads. Every visible change of a design gives it a new version and one event of that number.
"""

from __future__ import annotations

from typing import Any, cast

from sqlalchemy import and_, delete, func, select
from sqlalchemy.orm import Session

from worker import tables, views
from worker.database import Database
from worker.migrations import migrate
from worker.rows import NewDesign, add_design, change, end, id_at, live_queues, moment, new_id
from worker.settings import Settings
from worker.views import (
    ArtifactRecord,
    DesignRecord,
    DomainRecord,
    EventRecord,
    Page,
    QueueFacts,
    Status,
    WorkerRecord,
)


class IdempotencyConflict(Exception):
    """The idempotency key was used before with another request."""


class Records:
    """The records of one cluster.

    Parameters
    ----------
    database
        Its tables exist (:meth:`open` sees to that).
    settings
        For the ages at which workers count as gone and keys are forgotten.
    """

    def __init__(self, database: Database, settings: Settings) -> None:
        self.database = database
        self.settings = settings

    @classmethod
    def open(cls, settings: Settings) -> Records:
        """Connect, and bring the tables to the newest version; safe where several processes start at once."""
        settings.folder.mkdir(parents=True, exist_ok=True)
        database = Database(settings.database)
        try:
            migrate(database.engine)
        except BaseException:
            database.close()
            raise
        return cls(database, settings)

    def close(self) -> None:
        """Close the connections."""
        self.database.close()

    def ping(self) -> None:
        """Raise (``sqlalchemy.exc.SQLAlchemyError``) if the records cannot be read."""
        with self.database.read() as session:
            session.execute(select(func.count()).select_from(tables.Worker))

    # --- domains ----------------------------------------------------------------------------------------------

    def add_domain(
        self,
        *,
        id: str,
        sha256: str,
        size: int,
        name: str,
        suffix: str,
        units: str,
        inspection: dict[str, Any],
        owner: str | None = None,
    ) -> DomainRecord:
        """Record an envelope whose bytes are in the store; an id that is known already is returned as it is."""
        with self.database.write() as session:
            row = session.get(tables.Domain, id)
            if row is None:
                row = tables.Domain(
                    id=id,
                    sha256=sha256,
                    size=size,
                    name=name,
                    suffix=suffix,
                    units=units,
                    inspection=inspection,
                    owner=owner,
                    created_at=moment(session),
                )
                session.add(row)
                session.flush()
            return views.domain_record(row)

    def domain(self, domain_id: str) -> DomainRecord | None:
        """The record, or None."""
        with self.database.read() as session:
            row = session.get(tables.Domain, domain_id)
            return views.domain_record(row) if row is not None else None

    # --- designs ----------------------------------------------------------------------------------------------

    def create_design(
        self, new: NewDesign, idempotency: tuple[str, str] | None = None, design_id: str | None = None
    ) -> tuple[DesignRecord, bool]:
        """Record a queued design.

        Afterwards call ``worker.queue.Wakeups.send(record)``; if that is lost, the reaper makes up for it.

        Parameters
        ----------
        new
            What to make.
        idempotency
            The client's key and a SHA-256 of the request; the same key again gives the design that it gave before.
        design_id
            Id to use; a new one by default.

        Returns
        -------
        DesignRecord, bool
            The design, and whether it was made by this call.

        Raises
        ------
        IdempotencyConflict
            If the key belongs to another request.
        """
        owner = new.owner or ""
        with self.database.write() as session:
            now = moment(session)
            if idempotency is not None:
                known = session.get(tables.IdempotencyKey, (owner, idempotency[0]), with_for_update=True)
                if known is not None and known.created_at < now - self.settings.idempotency_days * 86400:
                    session.delete(known)
                    session.flush()
                    known = None
                if known is not None:
                    if known.request_sha256 != idempotency[1]:
                        raise IdempotencyConflict(idempotency[0])
                    row = session.get(tables.Design, known.design_id)
                    if row is not None:
                        return views.design_record(row), False
                    session.delete(known)  # the design was deleted since
                    session.flush()
            row = add_design(session, new, design_id or new_id(), now, self._live_queues(session))
            if idempotency is not None:
                key, digest = idempotency
                session.add(
                    tables.IdempotencyKey(owner=owner, key=key, request_sha256=digest, design_id=row.id, created_at=now)
                )
            return views.design_record(row), True

    def design(self, design_id: str) -> DesignRecord | None:
        """The record, or None."""
        with self.database.read() as session:
            row = session.get(tables.Design, design_id)
            return views.design_record(row) if row is not None else None

    def version(self, design_id: str) -> tuple[int, Status] | None:
        """The design's version and status; cheap, for long polls."""
        with self.database.read() as session:
            row = session.execute(
                select(tables.Design.version, tables.Design.status).where(tables.Design.id == design_id)
            ).first()
            return (row[0], cast("Status", row[1])) if row is not None else None

    def designs(
        self,
        *,
        limit: int = 50,
        cursor: str | None = None,
        status: Status | None = None,
        label: str | None = None,
        created_after: float | None = None,
        created_before: float | None = None,
        owner: str | None = None,
        study_id: str | None = None,
    ) -> Page:
        """Designs, newest first; every filter that is given must hold. ``cursor`` is the id of the last one seen."""
        d = tables.Design
        order = d.id if label is None else tables.DesignLabel.design_id  # the index of labels has that order
        query = select(d).order_by(order.desc()).limit(limit + 1)
        if label is not None:
            query = query.join(tables.DesignLabel, tables.DesignLabel.design_id == d.id)
            query = query.where(tables.DesignLabel.label == label)
        if cursor is not None:
            query = query.where(order < cursor)
        if status is not None:
            query = query.where(d.status == status)
        # Ids begin with the time of their maker's clock: a day either side is generous, and lets the index do the rest.
        if created_after is not None:
            query = query.where(d.created_at >= created_after, order >= id_at(created_after - 86400))
        if created_before is not None:
            query = query.where(d.created_at < created_before, order < id_at(created_before + 86400))
        if owner is not None:
            query = query.where(d.owner == owner)
        if study_id is not None:
            query = query.where(d.study_id == study_id)
        with self.database.read() as session:
            rows = session.scalars(query).all()
        items = tuple(views.design_record(row) for row in rows[:limit])
        return Page(items, items[-1].id if len(rows) > limit else None)

    def cancel(self, design_id: str) -> DesignRecord | None:
        """Cancel a design that has not ended; one that has stays as it is. None if there is none.

        The status changes at once; a worker that runs it finds its lease gone within ``heartbeat_s``, asks the step to
        stop, and ends it after ``grace_s``.
        """
        with self.database.write() as session:
            end(session, design_id, "cancelled", {})
            row = session.get(tables.Design, design_id, populate_existing=True)
            return views.design_record(row) if row is not None else None

    def delete(self, design_id: str) -> bool:
        """Cancel a design if it has not ended, and forget it with its events and artifacts.

        Results that no other design can reuse are forgotten too; the garbage collector then removes the bytes
        (:mod:`worker.garbage`).
        """
        with self.database.write() as session:
            row = session.get(tables.Design, design_id, with_for_update=True)
            if row is None:
                return False
            hashes = select(tables.DesignArtifact.sha256).where(tables.DesignArtifact.design_id == design_id)
            others = select(tables.DesignArtifact.sha256).where(tables.DesignArtifact.design_id != design_id)
            own = select(tables.StepFile.key).where(
                tables.StepFile.sha256.in_(hashes), tables.StepFile.sha256.not_in(others)
            )
            keys = session.scalars(own.distinct()).all()
            for table in (tables.DesignArtifact, tables.Event, tables.DesignLabel, tables.IdempotencyKey):
                session.execute(delete(table).where(table.design_id == design_id))
            session.execute(delete(tables.StepFile).where(tables.StepFile.key.in_(keys)))
            session.execute(delete(tables.StepResult).where(tables.StepResult.key.in_(keys)))
            session.execute(delete(tables.Design).where(tables.Design.id == design_id))
            return True

    def events(self, design_id: str, after: int = 0, limit: int = 500) -> tuple[EventRecord, ...]:
        """Events with a sequence above ``after``, in order. Progress events of an ended design are forgotten."""
        e = tables.Event
        query = select(e).where(e.design_id == design_id, e.sequence > after).order_by(e.sequence).limit(limit)
        with self.database.read() as session:
            return tuple(views.event_record(row) for row in session.scalars(query))

    def artifacts(self, design_id: str, internal: bool = False) -> tuple[ArtifactRecord, ...]:
        """The design's files so far, by name; ``internal`` adds those that only later steps read."""
        a = tables.DesignArtifact
        query = select(a).where(a.design_id == design_id).order_by(a.name)
        if not internal:
            query = query.where(a.internal.is_(False))
        with self.database.read() as session:
            return tuple(views.artifact_record(row) for row in session.scalars(query))

    def artifact(self, design_id: str, name: str) -> ArtifactRecord | None:
        """One file of a design, or None."""
        with self.database.read() as session:
            row = session.get(tables.DesignArtifact, (design_id, name))
            return views.artifact_record(row) if row is not None else None

    # --- workers and queues -----------------------------------------------------------------------------------

    def workers(self) -> tuple[WorkerRecord, ...]:
        """All registered workers; ``alive`` where the last heartbeat is younger than ``worker_gone_s``."""
        with self.database.read() as session:
            now = moment(session)
            rows = session.scalars(select(tables.Worker).order_by(tables.Worker.started_at)).all()
            return tuple(views.worker_record(r, now - r.heartbeat_at < self.settings.worker_gone_s) for r in rows)

    def live_queues(self) -> frozenset[str]:
        """Queues that some living worker serves: ask for ``gpu`` to resolve ``auto``, for ``cfd`` before evaluating."""
        with self.database.read() as session:
            return self._live_queues(session)

    def queues(self) -> tuple[QueueFacts, ...]:
        """What waits and runs on each queue."""
        d = tables.Design
        with self.database.read() as session:
            now = moment(session)
            waits = and_(d.status.in_(views.LIVE), d.lease_until.is_(None))
            runs = and_(d.status == "running", d.lease_until.is_not(None))
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
            living: dict[str, int] = {}
            for name in session.scalars(
                select(tables.Worker.queue).where(tables.Worker.heartbeat_at > now - self.settings.worker_gone_s)
            ):
                living[name] = living.get(name, 0) + 1
        return tuple(
            QueueFacts(name, *counts.get(name, (0, 0, 0.0)), living.get(name, 0)) for name in ("cpu", "gpu", "cfd")
        )

    def counts(self) -> dict[str, int]:
        """Number of designs by status."""
        with self.database.read() as session:
            rows = session.execute(select(tables.Design.status, func.count()).group_by(tables.Design.status))
            return {row[0]: row[1] for row in rows}

    def _live_queues(self, session: Session) -> frozenset[str]:
        return live_queues(session, self.settings.worker_gone_s)


__all__ = [
    "ArtifactRecord",
    "DesignRecord",
    "DomainRecord",
    "EventRecord",
    "IdempotencyConflict",
    "NewDesign",
    "Page",
    "QueueFacts",
    "Records",
    "WorkerRecord",
    "add_design",
    "change",
    "end",
    "live_queues",
    "new_id",
]
