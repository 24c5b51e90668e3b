"""What the calls work with: records, store, queue, and who waits for what."""

from __future__ import annotations

from collections.abc import AsyncIterator, Mapping, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, cast

from fastapi import Depends, Request
from sqlalchemy import select

from service.problems import Problem
from service.settings import Settings
from service.watch import Watch
from worker import tables
from worker.artifacts import ArtifactStore, open_store
from worker.queue import Wakeups
from worker.records import DesignRecord, DomainRecord, Records
from worker.settings import Settings as WorkerSettings


@dataclass(frozen=True)
class Backend:
    """One service's connections; made at start, closed at the end."""

    settings: Settings
    worker_settings: WorkerSettings
    records: Records
    store: ArtifactStore
    wakeups: Wakeups
    watch: Watch

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
async def open_backend(settings: Settings, worker_settings: WorkerSettings) -> AsyncIterator[Backend]:
    """Connections for the life of the app."""
    records = Records.open(worker_settings)
    try:
        async with Watch(lambda ids: versions(records, ids), settings.watch_s) as watch:
            store, wakeups = open_store(worker_settings), Wakeups(worker_settings)
            yield Backend(settings, worker_settings, records, store, wakeups, watch)
    finally:
        records.close()


def versions(records: Records, ids: Sequence[str]) -> Mapping[str, int]:
    """Versions of many designs in one look; ids that are gone are missing."""
    found: dict[str, int] = {}
    d = tables.Design
    with records.database.read() as session:
        for start in range(0, len(ids), 500):
            query = select(d.id, d.version).where(d.id.in_(ids[start : start + 500]))
            found.update((row[0], row[1]) for row in session.execute(query))
    return found


@lru_cache(maxsize=4096)
def _domain_name(records: Records, domain_id: str) -> str:
    row = records.domain(domain_id)
    return row.name if row is not None else ""


def backend_of(request: Request) -> Backend:
    """The app's backend."""
    return cast("Backend", request.app.state.backend)


BackendDep = Annotated[Backend, Depends(backend_of)]
