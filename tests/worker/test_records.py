"""The records as the service uses them."""

from __future__ import annotations

import json
import multiprocessing
import sqlite3
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from alembic import command
from alembic.autogenerate import compare_metadata
from alembic.config import Config
from alembic.migration import MigrationContext
from sqlalchemy import text

from tests.worker.conftest import small_spec
from worker import migrations
from worker.database import Database
from worker.idempotency import IdempotencyConflict
from worker.leases import Leases
from worker.migrations import NewerDatabase
from worker.records import Records
from worker.rows import NewDesign, new_id
from worker.settings import Settings
from worker.tables import Base
from worker.views import DesignRecord, DomainRecord


@pytest.mark.parametrize("first", [None, "0001"], ids=["empty", "of the first version"])
def test_any_start_leads_to_the_tables_that_the_code_uses(settings: Settings, first: str | None) -> None:
    settings.folder.mkdir()
    if first is not None:
        database = Database(settings.database)
        _upgrade(database, first)
        database.close()
    records = Records.open(settings)
    with records.database.engine.connect() as connection:
        context = MigrationContext.configure(connection)
        assert compare_metadata(context, Base.metadata) == []
        assert context.get_current_heads() == (migrations.HEAD,)
    records.close()


def test_processes_that_start_at_once_migrate_once(tmp_path: Path) -> None:
    code = f"""
from pathlib import Path
from worker.records import Records
from worker.settings import Settings
Records.open(Settings(data_dir=Path({str(tmp_path)!r}))).ping()
"""
    started = [subprocess.Popen([sys.executable, "-c", code], stderr=subprocess.PIPE) for _ in range(4)]
    assert [(p.communicate()[1], p.returncode) for p in started] == [(b"", 0)] * 4


def test_a_newer_database_is_refused(records: Records, settings: Settings) -> None:
    with records.database.engine.begin() as connection:
        connection.execute(text("UPDATE alembic_version SET version_num = '9999'"))
    with pytest.raises(NewerDatabase, match="9999"):
        Records.open(settings)


def test_an_idempotency_key_gives_one_design(records: Records, domain: DomainRecord) -> None:
    new = NewDesign(domain.id, small_spec())
    first, made = records.create_design(new, ("key", "a" * 64))
    second, made_again = records.create_design(new, ("key", "a" * 64))
    assert (made, made_again) == (True, False)
    assert first == second
    with pytest.raises(IdempotencyConflict):
        records.create_design(new, ("key", "b" * 64))
    other, made_other = records.create_design(NewDesign(domain.id, small_spec(), owner="x"), ("key", "b" * 64))
    assert made_other
    assert other.id != first.id


def test_equal_requests_at_the_same_moment_give_one_design(records: Records, domain: DomainRecord) -> None:
    new = NewDesign(domain.id, small_spec())
    with ThreadPoolExecutor(8) as pool:
        got = list(pool.map(lambda _: records.create_design(new, ("key", "a" * 64)), range(24)))
    assert [made for _, made in got].count(True) == 1
    assert len({design.id for design, _ in got}) == 1
    assert records.counts() == {"queued": 1}


def test_equal_uploads_at_the_same_moment_give_one_domain(records: Records) -> None:
    def add(_: int) -> DomainRecord:
        return records.add_domain(id="a", sha256="a", size=1, name="x", suffix=".stl", units="mm", inspection={})

    with ThreadPoolExecutor(8) as pool:
        assert len(set(map(str, pool.map(add, range(24))))) == 1


def test_pages_hold_every_design_once_newest_first(records: Records, domain: DomainRecord) -> None:
    made = [records.create_design(NewDesign(domain.id, small_spec(), labels=(f"l{i % 2}",)))[0].id for i in range(23)]
    seen: list[str] = []
    cursor = None
    while True:
        page = records.designs(limit=5, cursor=cursor)
        seen += [item.id for item in page.items]
        if (cursor := page.next) is None:
            break
    assert sorted(seen, reverse=True) == seen
    assert set(seen) == set(made)
    assert len(records.designs(limit=50, label="l1").items) == 11
    records.cancel(made[3])
    assert [d.id for d in records.designs(status="cancelled").items] == [made[3]]
    middle = records.design(made[10])
    assert middle is not None
    newer = records.designs(created_after=middle.created_at).items
    older = records.designs(created_before=middle.created_at).items
    assert len(newer) + len(older) == 23


def test_deleting_leaves_no_row(records: Records, design: DesignRecord) -> None:
    assert records.delete(design.id)
    assert not records.delete(design.id)
    assert records.design(design.id) is None
    assert records.events(design.id) == ()
    assert records.cancel(design.id) is None


def test_ids_sort_by_time(records: Records, domain: DomainRecord) -> None:
    made = [records.create_design(NewDesign(domain.id, small_spec()))[0] for _ in range(3)]
    assert [d.created_at for d in made] == sorted(d.created_at for d in made)
    assert len({d.id for d in made}) == 3


def test_times_are_the_database_clocks(design: DesignRecord) -> None:
    import time

    assert abs(design.created_at - time.time()) < 5.0


def _write(url: str, count: int) -> None:
    records = Records.open(Settings(data_dir=Path(url)))
    for i in range(count):
        records.create_design(NewDesign("0" * 64, small_spec(seed=i)))
    records.close()


def test_processes_write_at_once_without_locking_each_other_out(tmp_path: Path) -> None:
    records = Records.open(Settings(data_dir=tmp_path))
    records.add_domain(id="0" * 64, sha256="0" * 64, size=1, name="x", suffix=".stl", units="mm", inspection={})
    context = multiprocessing.get_context("spawn")
    writers = [context.Process(target=_write, args=(str(tmp_path), 25)) for _ in range(2)]
    for writer in writers:
        writer.start()
    for writer in writers:
        writer.join(60)
    assert [writer.exitcode for writer in writers] == [0, 0]
    assert records.counts() == {"queued": 50}
    records.close()


def test_records_of_the_first_version_open_with_the_newest(tmp_path: Path) -> None:
    path = tmp_path / "dualms.sqlite3"
    database = Database(f"sqlite:///{path}")
    _upgrade(database, "0001")
    database.close()
    spec = json.dumps(small_spec().model_dump(mode="json"))
    with sqlite3.connect(path) as old:
        old.execute("INSERT INTO domains VALUES (?, ?, 1, 'x', '.stl', 'mm', '{}', NULL, 1.0)", ("0" * 64, "0" * 64))
        columns = "id, domain_id, spec, labels, priority, status, step, queue, progress, note, attempt, tries, "
        columns += "created_at, timings, metrics, hints, version"
        values = (
            new_id(),
            "0" * 64,
            spec,
            "[]",
            0,
            "queued",
            "prepare",
            "cpu",
            0.0,
            "",
            0,
            0,
            1.0,
            "{}",
            "{}",
            "{}",
            1,
        )
        old.execute(f"INSERT INTO designs ({columns}) VALUES ({', '.join('?' * len(values))})", values)
    old.close()
    records = Records.open(Settings(data_dir=tmp_path))
    (found,) = records.designs().items
    assert (found.id, found.status) == (values[0], "queued")
    assert Leases(records).claim("cpu", "w") is not None
    records.close()


def _upgrade(database: Database, version: str) -> None:
    """What the migrations make of an empty database, up to a version."""
    config = Config()
    config.set_main_option("script_location", str(Path(migrations.__file__).parent))
    with database.engine.connect() as connection:
        config.attributes["connection"] = connection
        command.upgrade(config, version)
