"""Files and figures of carried-out steps: those of a design, and the cache that lets equal steps be reused."""

from __future__ import annotations

import contextlib
from pathlib import PurePath

from sqlalchemy import delete, select
from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from dualms.steps import INTERNAL, MEDIA_TYPES
from worker import tables
from worker.database import Database
from worker.lease import FileRecord, Lease, StepRecord
from worker.rows import moment


class StepCache:
    """What steps with the same inputs, parameters and code have produced."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def find(self, key: str) -> StepRecord | None:
        """The result of an earlier run; that it was used is noted."""
        with self._database.write() as session:
            row = session.get(tables.StepResult, key)
            if row is None:
                return None
            row.used_at = moment(session)
            files = session.scalars(select(tables.StepFile).where(tables.StepFile.key == key)).all()
            return StepRecord(
                tuple(FileRecord(f.name, f.sha256, f.size) for f in files), dict(row.metrics), dict(row.timings)
            )

    def forget(self, key: str) -> None:
        """Forget a result whose files are gone."""
        with self._database.write() as session:
            session.execute(delete(tables.StepFile).where(tables.StepFile.key == key))
            session.execute(delete(tables.StepResult).where(tables.StepResult.key == key))


def add_result(session: Session, lease: Lease, result: StepRecord) -> None:
    """Give a design the files of its step, and put the result into the cache; part of the caller's transaction."""
    now = moment(session)
    a = tables.DesignArtifact
    names = [file.name for file in result.files]
    session.execute(delete(a).where(a.design_id == lease.id, a.name.in_(names)))
    session.add_all(
        a(
            design_id=lease.id,
            name=file.name,
            step=lease.step,
            sha256=file.sha256,
            size=file.size,
            media_type=MEDIA_TYPES.get(PurePath(file.name).suffix, "application/octet-stream"),
            internal=file.name in INTERNAL[lease.step],
            created_at=now,
        )
        for file in result.files
    )
    with contextlib.suppress(IntegrityError), session.begin_nested():  # another design may have been as fast
        session.add(
            tables.StepResult(
                key=lease.key,
                step=lease.step,
                metrics=result.metrics,
                timings=result.timings,
                created_at=now,
                used_at=now,
            )
        )
        session.flush()
        session.add_all(tables.StepFile(key=lease.key, name=f.name, sha256=f.sha256, size=f.size) for f in result.files)
