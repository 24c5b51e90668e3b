"""The envelopes of one cluster: found by their bytes, listed, forgotten."""

from __future__ import annotations

from typing import Literal

from sqlalchemy import ColumnElement, delete, select, tuple_
from sqlalchemy.exc import IntegrityError

from worker import tables, views
from worker.records import Records
from worker.views import DomainRecord

Deletion = Literal["deleted", "unknown", "in use"]


class Domains:
    """What is done with envelopes beside adding them.

    Parameters
    ----------
    records
        Of the same cluster.
    """

    def __init__(self, records: Records) -> None:
        self._database = records.database

    def of_bytes(self, sha256: str, owner: str | None) -> tuple[DomainRecord, ...]:
        """An owner's domains with these bytes (several where they were read in several units), oldest first."""
        u = tables.Domain
        query = select(u).where(u.sha256 == sha256, _owned(owner)).order_by(u.created_at)
        with self._database.read() as session:
            return tuple(views.domain_record(row) for row in session.scalars(query))

    def page(
        self, limit: int, cursor: str | None = None, owner: str | None = None
    ) -> tuple[tuple[DomainRecord, ...], str | None]:
        """Domains, newest first, and the cursor of the next page; of one owner if one is given."""
        u = tables.Domain
        query = select(u).order_by(u.created_at.desc(), u.id.desc()).limit(limit + 1)
        if cursor is not None:
            last = select(u.created_at, u.id).where(u.id == cursor).subquery()
            query = query.join(last, tuple_(u.created_at, u.id) < tuple_(last.c.created_at, last.c.id))
        if owner is not None:
            query = query.where(u.owner == owner)
        with self._database.read() as session:
            rows = session.scalars(query).all()
        items = tuple(views.domain_record(row) for row in rows[:limit])
        return items, items[-1].id if len(rows) > limit else None

    def delete(self, domain_id: str) -> Deletion:
        """Forget a domain that no design and no study names; the garbage collector then removes its bytes."""
        u, d, s = tables.Domain, tables.Design, tables.Study
        try:
            with self._database.write() as session:
                used = select(d.id).where(d.domain_id == domain_id).union(select(s.id).where(s.domain_id == domain_id))
                if session.execute(used.limit(1)).first() is not None:
                    return "in use"
                found = session.execute(delete(u).where(u.id == domain_id).returning(u.id)).scalar_one_or_none()
        except IntegrityError:  # named by somebody in this very moment (PostgreSQL)
            return "in use"
        return "deleted" if found is not None else "unknown"


def _owned(owner: str | None) -> ColumnElement[bool]:
    return tables.Domain.owner == owner if owner is not None else tables.Domain.owner.is_(None)
