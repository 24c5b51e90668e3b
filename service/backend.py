"""What the calls work with: records, store, queue, and who waits for what."""

from __future__ import annotations

import sqlite3
from collections.abc import AsyncIterator, Callable, Iterator, Sequence
from contextlib import asynccontextmanager, contextmanager
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, Any, cast

from fastapi import Depends, Request
from sqlalchemy import select

from service.batches import Batches, Busy
from service.problems import Problem
from service.settings import Settings
from service.turns import Turns
from service.watch import Watch
from worker import tables
from worker.artifacts import ArtifactStore
from worker.queue import Wakeups
from worker.records import Records
from worker.settings import Settings as WorkerSettings
from worker.stores import open_store
from worker.tracing import Tracing
from worker.views import DesignRecord, DomainRecord, Status


class Bodies:
    """The JSON of designs as it was last sent, by version; what is asked for again and again is made once."""

    def __init__(self, most: int = 2048) -> None:
        self._most = most
        self._bodies: dict[str, tuple[int, bytes]] = {}

    def get(self, design_id: str, version: int) -> bytes | None:
        """The body, if it is of this version."""
        kept = self._bodies.get(design_id)
        return kept[1] if kept is not None and kept[0] == version else None

    def keep(self, design_id: str, version: int, body: bytes) -> None:
        """Keep a body; the oldest goes where there are too many."""
        self._bodies.pop(design_id, None)
        while len(self._bodies) >= self._most:
            self._bodies.pop(next(iter(self._bodies)), None)
        self._bodies[design_id] = (version, body)


@dataclass(frozen=True)
class Backend:
    """One service's connections; made at start, closed at the end."""

    settings: Settings
    worker_settings: WorkerSettings
    records: Records
    store: ArtifactStore
    wakeups: Wakeups
    watch: Watch
    looks: Batches[tuple[int, Status]]
    bodies: Bodies
    tracing: Tracing
    turns: Turns

    def domain(self, domain_id: str) -> DomainRecord:
        """The domain.

        Raises
        ------
        Problem
            ``domain-not-found``.
        """
        row = self.records.domain(domain_id)
        if row is None:
            raise Problem("domain-not-found", f"There is no domain {domain_id}.", "Upload it: POST /v1/domains.")
        return row

    def design(self, design_id: str) -> DesignRecord:
        """The design.

        Raises
        ------
        Problem
            ``design-not-found``.
        """
        row = self.records.design(design_id)
        if row is None:
            raise design_not_found(design_id)
        return row

    def domain_name(self, domain_id: str) -> str:
        """File name of a domain; kept, since domains never change."""
        return _domain_name(self.records, domain_id)


def design_not_found(design_id: str) -> Problem:
    """The refusal for an id that names no design."""
    advice = "It may have been deleted; GET /v1/designs lists those that are."
    return Problem("design-not-found", f"There is no design {design_id}.", advice)


@asynccontextmanager
async def open_backend(settings: Settings, worker_settings: WorkerSettings, tracing: Tracing) -> AsyncIterator[Backend]:
    """Connections for the life of the app."""
    records = Records.open(worker_settings)
    try:
        async with Watch(lambda ids: {k: v for k, (v, _) in states(records, ids).items()}, settings.watch_s) as watch:
            store, wakeups = open_store(worker_settings), Wakeups(worker_settings)
            with quick_state(records) as quick:
                looks: Batches[tuple[int, Status]] = Batches(lambda ids: states(records, ids), quick)
                yield Backend(
                    settings,
                    worker_settings,
                    records,
                    store,
                    wakeups,
                    watch,
                    looks,
                    Bodies(),
                    tracing,
                    Turns(settings.uploads_at_once),
                )
    finally:
        records.close()


def states(records: Records, ids: Sequence[str]) -> dict[str, tuple[int, Status]]:
    """Versions and statuses of many designs in one look; ids that are gone are missing."""
    found: dict[str, tuple[int, Status]] = {}
    d = tables.Design.__table__.c
    with records.database.engine.connect() as connection:
        for start in range(0, len(ids), 500):
            query = select(d.id, d.version, d.status).where(d.id.in_(ids[start : start + 500]))
            found.update((row[0], (row[1], row[2])) for row in connection.execute(query))
    return found


@contextmanager
def quick_state(records: Records) -> Iterator[Callable[[str], tuple[int, Status] | None] | None]:
    """A look at one design that takes some microseconds and never waits; None where the records are not in SQLite.

    Raises ``Busy`` where it would have to wait.
    """
    if records.database.engine.dialect.name != "sqlite":
        yield None
        return
    connection: Any = records.database.engine.raw_connection()
    connection.execute("PRAGMA busy_timeout=0")

    def look(design_id: str) -> tuple[int, Status] | None:
        try:
            row = connection.execute("SELECT version, status FROM designs WHERE id = ?", (design_id,)).fetchone()
        except sqlite3.OperationalError as error:
            raise Busy from error
        return (row[0], row[1]) if row is not None else None

    try:
        yield look
    finally:
        connection.invalidate()


@lru_cache(maxsize=4096)
def _domain_name(records: Records, domain_id: str) -> str:
    row = records.domain(domain_id)
    return row.name if row is not None else ""


async def backend_of(request: Request) -> Backend:
    """The app's backend; async, since FastAPI would call anything else in a thread."""
    return cast("Backend", request.app.state.backend)


BackendDep = Annotated[Backend, Depends(backend_of)]
