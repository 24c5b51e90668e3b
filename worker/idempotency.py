"""Idempotency keys: a client's promise that two requests are one, kept also where both come at the same moment."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from worker import tables
from worker.rows import moment

T = TypeVar("T")
Row = TypeVar("Row", tables.Design, tables.Study)
DAY_S = 86400


class IdempotencyConflict(Exception):
    """The idempotency key was used before with another request."""


def made_before(
    session: Session, kind: type[Row], owner: str | None, given: tuple[str, str], days: float
) -> Row | None:
    """What the same key and request gave before.

    Parameters
    ----------
    session
        One that writes: a key that is too old, or whose thing was deleted since, is forgotten.
    kind
        Table of the thing.
    owner, given
        Whose key; the key and a SHA-256 of the request.
    days
        How long a key is remembered.

    Raises
    ------
    IdempotencyConflict
        If the key belongs to another request.
    """
    key, digest = given
    known = session.get(tables.IdempotencyKey, (owner or "", key), with_for_update=True)
    if known is None:
        return None
    if known.created_at >= moment(session) - days * DAY_S:
        if known.request_sha256 != digest:
            raise IdempotencyConflict(key)
        row = session.get(kind, known.design_id)
        if row is not None:
            return row
    session.delete(known)
    session.flush()
    return None


def remember(session: Session, owner: str | None, given: tuple[str, str], thing_id: str) -> None:
    """Keep a key with what it gave; refused (``IntegrityError``) where another request has just kept it."""
    key, digest = given
    session.add(
        tables.IdempotencyKey(
            owner=owner or "", key=key, request_sha256=digest, design_id=thing_id, created_at=moment(session)
        )
    )
    session.flush()


def once(create: Callable[[], T]) -> T:
    """Create something, or find what an equal request has created at the same moment.

    On SQLite one transaction waits for the other; on PostgreSQL both may find no key, and the second to keep it is
    refused. Then the first one's row is there.
    """
    try:
        return create()
    except IntegrityError:
        return create()
