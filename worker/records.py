"""The records as clients of the service use them: domains, designs, events, artifacts, workers.

What the holder of a lease may write is in :mod:`worker.leases`. Methods block for one short transaction; call them from
threads. Every visible change of a design gives it a new version and one event of that number.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, cast

from sqlalchemy import delete, func, select

from worker import fleet, listing, tables, views
from worker.database import Database
from worker.idempotency import made_before, once, remember
from worker.migrations import migrate
from worker.rows import NewDesign, add_design, end, live_queues, moment, new_id
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

        def add() -> DomainRecord:
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

        return once(add)

    def domain(self, domain_id: str) -> DomainRecord | None:
        """The record, or None."""
        with self.database.read() as session:
            row = session.get(tables.Domain, domain_id)
            return views.domain_record(row) if row is not None else None

    # --- designs ----------------------------------------------------------------------------------------------

    def create_design(
        self,
        new: NewDesign,
        idempotency: tuple[str, str] | None = None,
        design_id: str | None = None,
        admit: Callable[[], object] = lambda: None,
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
        admit
            Called before one is made; what it raises passes, and nothing is written.

        Returns
        -------
        DesignRecord, bool
            The design, and whether it was made by this call.

        Raises
        ------
        IdempotencyConflict
            If the key belongs to another request.
        """
        return once(lambda: self._create(new, idempotency, design_id or new_id(), admit))

    def _create(
        self, new: NewDesign, given: tuple[str, str] | None, design_id: str, admit: Callable[[], object]
    ) -> tuple[DesignRecord, bool]:
        with self.database.write() as session:
            if given is not None:
                known = made_before(session, tables.Design, new.owner, given, self.settings.idempotency_days)
                if known is not None:
                    return views.design_record(known), False
                remember(session, new.owner, given, design_id)
            admit()
            live = live_queues(session, self.settings.worker_gone_s)
            return views.design_record(add_design(session, new, design_id, moment(session), live)), True

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
        query = listing.newest_first(
            cursor=cursor,
            status=status,
            label=label,
            created_after=created_after,
            created_before=created_before,
            owner=owner,
            study_id=study_id,
        )
        with self.database.read() as session:
            rows = session.scalars(query.limit(limit + 1)).all()
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
        return fleet.workers(self.database, self.settings.worker_gone_s)

    def live_queues(self) -> frozenset[str]:
        """Queues that some living worker serves: ask for ``gpu`` to resolve ``auto``, for ``cfd`` before evaluating."""
        with self.database.read() as session:
            return live_queues(session, self.settings.worker_gone_s)

    def queues(self) -> tuple[QueueFacts, ...]:
        """What waits and runs on each queue."""
        return fleet.queues(self.database, self.settings.worker_gone_s)

    def counts(self) -> dict[str, int]:
        """Number of designs by status."""
        with self.database.read() as session:
            rows = session.execute(select(tables.Design.status, func.count()).group_by(tables.Design.status))
            return {row[0]: row[1] for row in rows}
