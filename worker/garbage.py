"""Removes what nothing points to any more: old step results, forgotten keys, and bytes without a record.

Bytes younger than ``blob_grace_s`` stay: a step may have stored them and not committed them yet. Storing bytes that are
there already makes them young again.
"""

from __future__ import annotations

import logging
import time
from dataclasses import dataclass

from sqlalchemy import delete, select, union

from worker import tables, views
from worker.artifacts import ArtifactStore
from worker.database import Now
from worker.records import Records

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Collected:
    """What was removed."""

    designs: int
    results: int
    blobs: int
    bytes: int


def collect(records: Records, store: ArtifactStore) -> Collected:
    """One collection; safe while everything runs, and by several processes at once."""
    designs = _old_designs(records)
    _empty_studies(records)
    _unused_domains(records)
    results = _old_results(records)
    return _blobs(records, store, designs, results)


def _old_designs(records: Records) -> int:
    days = records.settings.retention_days
    if days is None:
        return 0
    d = tables.Design
    with records.database.read() as session:
        ids = session.scalars(select(d.id).where(d.status.in_(views.FINAL), d.finished_at < Now() - days * 86400)).all()
    return sum(records.delete(design_id) for design_id in ids)


def _empty_studies(records: Records) -> None:
    """Forget studies all of whose designs were deleted."""
    d, s = tables.Design, tables.Study
    with records.database.write() as session:
        used = select(d.study_id).where(d.study_id.is_not(None))
        session.execute(delete(s).where(s.id.not_in(used)))


def _unused_domains(records: Records) -> None:
    """Forget envelopes past their retention that no design and no study uses."""
    days = records.settings.retention_days
    if days is None:
        return
    u = tables.Domain
    used = union(select(tables.Design.domain_id), select(tables.Study.domain_id))
    with records.database.write() as session:
        session.execute(delete(u).where(u.created_at < Now() - days * 86400, u.id.not_in(used)))


def _old_results(records: Records) -> int:
    s, k, v = tables.StepResult, tables.IdempotencyKey, tables.Delivery
    with records.database.write() as session:
        old = session.scalars(select(s.key).where(s.used_at < Now() - records.settings.cache_days * 86400)).all()
        session.execute(delete(tables.StepFile).where(tables.StepFile.key.in_(old)))
        session.execute(delete(s).where(s.key.in_(old)))
        session.execute(delete(v).where(v.done_at < Now() - records.settings.cache_days * 86400))
        session.execute(delete(k).where(k.created_at < Now() - records.settings.idempotency_days * 86400))
    return len(old)


def _blobs(records: Records, store: ArtifactStore, designs: int, results: int) -> Collected:
    oldest = time.time() - records.settings.blob_grace_s
    stored = [blob for blob in store.list() if blob.written_at < oldest]
    # Read the references after the list: a blob that became referenced meanwhile is then seen.
    with records.database.read() as session:
        needed = set(
            session.scalars(
                union(
                    select(tables.Domain.sha256),
                    select(tables.DesignArtifact.sha256),
                    select(tables.StepFile.sha256),
                )
            )
        )
        points = session.scalars(select(tables.Design.checkpoint).where(tables.Design.status.in_(views.LIVE)))
        needed |= {point["sha256"] for point in points if point is not None}
    count = size = 0
    for blob in stored:
        if blob.sha256 not in needed:
            store.delete(blob.sha256)
            count, size = count + 1, size + blob.size
    if count:
        log.info("removed %d unreferenced blobs, %d bytes", count, size)
    return Collected(designs, results, count, size)
