"""API keys: hashed, with an owner, scopes, quotas and an expiry; and the log of what was done with them.

A key's secret is shown once, when it is made. It holds 256 random bits, so that a plain SHA-256 of it is safe to keep.
"""

from __future__ import annotations

import hashlib
import secrets
from dataclasses import dataclass, fields
from typing import Any, Literal, cast

from sqlalchemy import func, select, update

from worker import tables, views
from worker.database import Database, Now

Scope = Literal["read", "write", "admin"]
SCOPES: tuple[Scope, ...] = ("read", "write", "admin")
PREFIX = "dms_"
_USED_S = 60.0  # the last use is noted at most so often


@dataclass(frozen=True)
class Quotas:
    """What an owner may have at once; None: no limit."""

    max_live_designs: int | None = None
    max_stored_bytes: int | None = None
    max_uploads_a_day: int | None = None


@dataclass(frozen=True)
class Usage:
    """What an owner has: designs that have not ended, bytes of domains and artifacts, uploads of the last 24 hours."""

    live_designs: int
    stored_bytes: int
    uploads_a_day: int


@dataclass(frozen=True)
class KeyRecord:
    """A key, without its secret; times in seconds since 1970."""

    id: str
    owner: str
    name: str
    scopes: tuple[Scope, ...]
    quotas: Quotas
    created_at: float
    expires_at: float | None
    revoked_at: float | None
    last_used_at: float | None

    def allows(self, scope: Scope) -> bool:
        """Whether it may do what needs this scope; ``admin`` may do all."""
        return scope in self.scopes or "admin" in self.scopes


@dataclass(frozen=True)
class AuditRecord:
    """Who did what to what."""

    id: int
    at: float
    owner: str | None
    key_id: str | None
    action: str
    subject: str
    detail: dict[str, Any]


class Keys:
    """The keys of one cluster."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def create(
        self, owner: str, name: str, scopes: tuple[Scope, ...], quotas: Quotas | None = None, days: float | None = None
    ) -> tuple[KeyRecord, str]:
        """Make a key.

        Parameters
        ----------
        owner
            Whose designs it reaches; several keys may have the same owner.
        name
            For people.
        scopes
            What it may do.
        quotas
            Limits of the owner, as far as this key is concerned.
        days
            Until it expires; None: never.

        Returns
        -------
        KeyRecord, str
            The key, and its secret, which is not kept.

        Raises
        ------
        ValueError
            If a scope is unknown, or there is none.
        """
        if not scopes or any(scope not in SCOPES for scope in scopes):
            raise ValueError(f"scopes are one or more of {', '.join(SCOPES)}")
        key_id = secrets.token_hex(8)
        secret = f"{PREFIX}{key_id}_{secrets.token_urlsafe(32)}"
        quotas = quotas or Quotas()
        with self._database.write() as session:
            now = session.execute(select(Now())).scalar_one()
            row = tables.ApiKey(
                id=key_id,
                sha256=_hash(secret),
                owner=owner,
                name=name,
                scopes=list(scopes),
                max_live_designs=quotas.max_live_designs,
                max_stored_bytes=quotas.max_stored_bytes,
                max_uploads_a_day=quotas.max_uploads_a_day,
                created_at=now,
                expires_at=now + days * 86400 if days is not None else None,
                revoked_at=None,
                last_used_at=None,
            )
            session.add(row)
            session.flush()
            return _record(row), secret

    def check(self, secret: str) -> KeyRecord | None:
        """The key with this secret, if it is valid now."""
        k = tables.ApiKey
        with self._database.read() as session:
            now = session.execute(select(Now())).scalar_one()
            row = session.scalars(select(k).where(k.sha256 == _hash(secret))).first()
        if row is None or row.revoked_at is not None or (row.expires_at is not None and row.expires_at <= now):
            return None
        if row.last_used_at is None or now - row.last_used_at > _USED_S:
            with self._database.write() as session:
                session.execute(update(k).where(k.id == row.id).values(last_used_at=now))
        return _record(row)

    def revoke(self, key_id: str) -> bool:
        """Make a key invalid, for ever; False if there is no such valid key."""
        k = tables.ApiKey
        with self._database.write() as session:
            found = session.execute(
                update(k).where(k.id == key_id, k.revoked_at.is_(None)).values(revoked_at=Now()).returning(k.id)
            )
            return found.scalar_one_or_none() is not None

    def all(self) -> tuple[KeyRecord, ...]:
        """All keys, oldest first."""
        with self._database.read() as session:
            return tuple(_record(r) for r in session.scalars(select(tables.ApiKey).order_by(tables.ApiKey.created_at)))

    def any_valid(self) -> bool:
        """Whether there is a key that could be used now."""
        k = tables.ApiKey
        valid = select(func.count()).where(k.revoked_at.is_(None), func.coalesce(k.expires_at, Now() + 1) > Now())
        with self._database.read() as session:
            return session.execute(valid).scalar_one() > 0

    def usage(self, owner: str) -> Usage:
        """What an owner has now; bytes that several designs share count for each."""
        d, a, u = tables.Design, tables.DesignArtifact, tables.Domain
        artifacts = select(func.coalesce(func.sum(a.size), 0)).join(d, d.id == a.design_id).where(d.owner == owner)
        domains = select(func.coalesce(func.sum(u.size), 0)).where(u.owner == owner)
        with self._database.read() as session:
            count = select(func.count()).select_from(d).where(d.owner == owner, d.status.in_(views.LIVE))
            recent = select(func.count()).where(u.owner == owner, u.created_at > Now() - 86400)
            return Usage(
                session.execute(count).scalar_one(),
                int(session.execute(artifacts).scalar_one()) + int(session.execute(domains).scalar_one()),
                session.execute(recent).scalar_one(),
            )

    def note(self, action: str, subject: str, *, owner: str | None, key_id: str | None, **detail: Any) -> None:
        """Write a line of the audit log."""
        with self._database.write() as session:
            session.add(
                tables.AuditEntry(at=Now(), owner=owner, key_id=key_id, action=action, subject=subject, detail=detail)
            )

    def audit(self, limit: int = 100, before: int | None = None) -> tuple[AuditRecord, ...]:
        """The audit log, newest first; ``before`` is the id of the last line seen."""
        e = tables.AuditEntry
        query = select(e).order_by(e.id.desc()).limit(limit)
        if before is not None:
            query = query.where(e.id < before)
        names = [f.name for f in fields(AuditRecord)]
        with self._database.read() as session:
            return tuple(AuditRecord(**{n: getattr(row, n) for n in names}) for row in session.scalars(query))


def exceeded(quotas: Quotas, usage: Usage, *, designs: int = 0, stored: int = 0, uploads: int = 0) -> str | None:
    """Which quota one would exceed by adding so much, in words; None if none."""
    for what, limit, value in (
        ("designs that have not ended", quotas.max_live_designs, usage.live_designs + designs),
        ("bytes stored", quotas.max_stored_bytes, usage.stored_bytes + stored),
        ("uploads in 24 hours", quotas.max_uploads_a_day, usage.uploads_a_day + uploads),
    ):
        if limit is not None and value > limit:
            return f"{value} {what}; the key allows {limit}"
    return None


def _hash(secret: str) -> str:
    return hashlib.sha256(secret.encode()).hexdigest()


def _record(row: tables.ApiKey) -> KeyRecord:
    return KeyRecord(
        id=row.id,
        owner=row.owner,
        name=row.name,
        scopes=cast("tuple[Scope, ...]", tuple(row.scopes)),
        quotas=Quotas(row.max_live_designs, row.max_stored_bytes, row.max_uploads_a_day),
        created_at=row.created_at,
        expires_at=row.expires_at,
        revoked_at=row.revoked_at,
        last_used_at=row.last_used_at,
    )
