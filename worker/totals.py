"""Running totals for the metrics: what ended how, failures by code, seconds by stage; kept by the writes they count."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from sqlalchemy import select
from sqlalchemy.orm import Session

from worker import tables
from worker.database import Database

Kind = Literal["ended", "failure", "stage", "reused"]


@dataclass(frozen=True)
class Total:
    """How often something happened, and the seconds that it took together (0 where time has no meaning)."""

    kind: Kind
    name: str
    count: int
    seconds: float


def add(session: Session, kind: Kind, seconds_by_name: Mapping[str, float]) -> None:
    """Count something once for each name; part of the caller's transaction."""
    t = tables.Total
    insert: Any
    if session.get_bind().dialect.name == "sqlite":
        from sqlalchemy.dialects.sqlite import insert
    else:  # asked for by name only where it is used: it brings all its drivers along
        from sqlalchemy.dialects.postgresql import insert
    for name, seconds in sorted(seconds_by_name.items()):  # in one order, so that two writers cannot deadlock
        session.execute(
            insert(t)
            .values(kind=kind, name=name, count=1, seconds=seconds)
            .on_conflict_do_update(
                index_elements=[t.kind, t.name], set_={"count": t.count + 1, "seconds": t.seconds + seconds}
            )
        )


def read(database: Database) -> tuple[Total, ...]:
    """All totals of the cluster since its first day."""
    t = tables.Total
    with database.read() as session:
        rows = session.scalars(select(t).order_by(t.kind, t.name))
        return tuple(Total(row.kind, row.name, row.count, row.seconds) for row in rows)  # type: ignore[arg-type]
