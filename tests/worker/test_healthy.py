"""A worker is well as long as it beats, and only on its own machine."""

from __future__ import annotations

import os
import subprocess
import sys

from sqlalchemy import update

from worker import tables
from worker.healthy import healthy
from worker.records import Records
from worker.station import Registration


def test_a_worker_is_well_while_it_beats(records: Records) -> None:
    assert not healthy(records.database, 30)
    registration = Registration(records, "cpu", 1)
    assert healthy(records.database, 30)
    assert not healthy(records.database, 0)
    registration.end()
    assert not healthy(records.database, 30)


def test_another_machine_s_worker_does_not_count(records: Records) -> None:
    Registration(records, "cpu", 1)
    with records.database.write() as session:
        session.execute(update(tables.Worker).values(host="elsewhere"))
    assert not healthy(records.database, 30)


def test_the_exit_code_says_it(records: Records) -> None:
    def look() -> int:
        settings = records.settings
        env = {**os.environ, "DUALMS_DATA_DIR": str(settings.data_dir), "DUALMS_DATABASE_URL": settings.database_url}
        return subprocess.run([sys.executable, "-m", "worker.healthy"], env=env, check=False).returncode

    assert look() == 1
    Registration(records, "cpu", 1)
    assert look() == 0
