"""Records of studies: a study and its designs are written together, and read, cancelled and deleted together.

The designs are ordinary ones. What a study's status is follows from theirs, so that there is nothing to keep in step.
"""

from __future__ import annotations

import secrets
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from sqlalchemy import delete, select
from sqlalchemy.orm import Session

from worker import tables, views
from worker.idempotency import made_before, once, remember
from worker.records import Records
from worker.rows import NewDesign, add_design, live_queues, moment, new_id
from worker.views import DesignRecord, Status


@dataclass(frozen=True)
class NewStudy:
    """A study to record.

    Parameters
    ----------
    domain_id
        Its domain.
    spec, grid
        As the client sent them.
    metrics
        Paths into the report.
    points
        The grid's values and the design, for each point.
    name, labels, owner
        For people and filters.
    """

    domain_id: str
    spec: dict[str, Any]
    grid: dict[str, list[Any]]
    metrics: tuple[str, ...]
    points: tuple[tuple[dict[str, Any], NewDesign], ...]
    name: str | None = None
    labels: tuple[str, ...] = ()
    owner: str | None = None


@dataclass(frozen=True)
class StudyPoint:
    """One point: the grid's values there, and the design, whose record is None once it was deleted."""

    values: dict[str, Any]
    design_id: str
    design: DesignRecord | None


@dataclass(frozen=True)
class StudyRecord:
    """A study as it stands; times in seconds since 1970."""

    id: str
    domain_id: str
    name: str | None
    labels: tuple[str, ...]
    owner: str | None
    spec: dict[str, Any]
    grid: dict[str, list[Any]]
    metrics: tuple[str, ...]
    created_at: float
    points: tuple[StudyPoint, ...]

    @property
    def version(self) -> tuple[int, ...]:
        """Changes with every visible change of a point."""
        return tuple(p.design.version if p.design is not None else 0 for p in self.points)

    @property
    def counts(self) -> dict[Status, int]:
        """Number of points by status; a deleted design counts as cancelled."""
        statuses = [status_of(p) for p in self.points]
        return {status: statuses.count(status) for status in (*views.LIVE, *views.FINAL)}

    @property
    def status(self) -> Status:
        """What the points' statuses come to.

        While one has not ended: ``queued`` or ``running``. Then ``succeeded`` if one has succeeded and none was
        cancelled, ``cancelled`` if one was cancelled, ``failed`` if all have failed.
        """
        counts = self.counts
        if counts["queued"] + counts["running"]:
            return "queued" if counts["queued"] == len(self.points) else "running"
        if counts["cancelled"]:
            return "cancelled"
        return "succeeded" if counts["succeeded"] else "failed"

    @property
    def final(self) -> bool:
        """Whether every point has ended."""
        return self.status in views.FINAL


def status_of(point: StudyPoint) -> Status:
    """Where a point stands."""
    return point.design.status if point.design is not None else "cancelled"


class Studies:
    """The studies of one cluster.

    Parameters
    ----------
    records
        Of the same cluster.
    """

    def __init__(self, records: Records) -> None:
        self._database = records.database
        self._settings = records.settings
        self._records = records

    def create(
        self, new: NewStudy, idempotency: tuple[str, str] | None = None, admit: Callable[[], object] = lambda: None
    ) -> tuple[StudyRecord, bool]:
        """Record a study and queue all of its designs, in one transaction.

        Parameters
        ----------
        new
            What to make.
        idempotency
            The client's key and a SHA-256 of the request; the same key again gives the study that it gave before.
        admit
            Called before one is made; what it raises passes, and nothing is written.

        Returns
        -------
        StudyRecord, bool
            The study, and whether it was made by this call; then send a wake-up for each of its designs.

        Raises
        ------
        IdempotencyConflict
            If the key belongs to another request.
        """
        return once(lambda: self._create(new, idempotency, admit))

    def _create(
        self, new: NewStudy, given: tuple[str, str] | None, admit: Callable[[], object]
    ) -> tuple[StudyRecord, bool]:
        with self._database.write() as session:
            study_id, ids = new_id(), _ids(len(new.points))
            if given is not None:
                known = made_before(session, tables.Study, new.owner, given, self._settings.idempotency_days)
                if known is not None:
                    return _record(session, known), False
                remember(session, new.owner, given, study_id)
            admit()
            now = moment(session)
            live = live_queues(session, self._settings.worker_gone_s)
            study = tables.Study(
                id=study_id,
                domain_id=new.domain_id,
                name=new.name,
                labels=list(new.labels),
                owner=new.owner,
                spec=new.spec,
                grid={"axes": [[path, values] for path, values in new.grid.items()]},
                metrics=list(new.metrics),
                points={"points": [[values, i] for (values, _), i in zip(new.points, ids, strict=True)]},
                created_at=now,
            )
            session.add(study)
            session.flush()
            for (_, design), design_id in zip(new.points, ids, strict=True):
                own = replace(design, study_id=study_id, labels=(*design.labels, f"study={study_id}"))
                add_design(session, own, design_id, now, live)
            return _record(session, study), True

    def study(self, study_id: str) -> StudyRecord | None:
        """The record, or None."""
        with self._database.read() as session:
            row = session.get(tables.Study, study_id)
            return _record(session, row) if row is not None else None

    def page(
        self, limit: int = 50, cursor: str | None = None, owner: str | None = None
    ) -> tuple[tuple[StudyRecord, ...], str | None]:
        """Studies, newest first, and the cursor of the next page; ``cursor`` is the id of the last one seen."""
        s = tables.Study
        query = select(s).order_by(s.id.desc()).limit(limit + 1)
        if cursor is not None:
            query = query.where(s.id < cursor)
        if owner is not None:
            query = query.where(s.owner == owner)
        with self._database.read() as session:
            rows = session.scalars(query).all()
            return tuple(_record(session, row) for row in rows[:limit]), rows[limit - 1].id if len(
                rows
            ) > limit else None

    def cancel(self, study_id: str) -> StudyRecord | None:
        """Cancel every design that has not ended; None if there is no such study."""
        study = self.study(study_id)
        if study is None:
            return None
        # The last first: what waits goes before what runs, so that no worker takes up the next.
        for point in reversed(study.points):
            if point.design is not None and not point.design.final:
                self._records.cancel(point.design_id)
        return self.study(study_id)

    def delete(self, study_id: str) -> bool:
        """Forget a study with all of its designs and what they have made; False if there is no such study."""
        study = self.cancel(study_id)
        if study is None:
            return False
        for point in study.points:
            self._records.delete(point.design_id)
        with self._database.write() as session:
            session.execute(delete(tables.IdempotencyKey).where(tables.IdempotencyKey.design_id == study_id))
            session.execute(delete(tables.Study).where(tables.Study.id == study_id))
        return True


def _ids(count: int) -> list[str]:
    """Ids of designs that sort in this order: workers take the lowest first."""
    began = f"{time.time_ns() // 1_000_000:012x}"
    return [f"{began}{k:04x}{secrets.token_hex(8)}" for k in range(count)]


def _record(session: Session, row: tables.Study) -> StudyRecord:
    designs = session.scalars(select(tables.Design).where(tables.Design.study_id == row.id)).all()
    found = {design.id: views.design_record(design) for design in designs}
    return StudyRecord(
        id=row.id,
        domain_id=row.domain_id,
        name=row.name,
        labels=tuple(row.labels),
        owner=row.owner,
        spec=row.spec,
        grid=dict(row.grid["axes"]),
        metrics=tuple(row.metrics),
        created_at=row.created_at,
        points=tuple(StudyPoint(values, i, found.get(i)) for values, i in row.points["points"]),
    )
