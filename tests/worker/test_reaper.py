"""The reaper: what dead workers held goes on, what is late ends, lost messages are repeated."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from sqlalchemy import update

from tests.broker import Broker
from tests.worker.conftest import result_of, small_spec
from worker import tables
from worker.database import Now
from worker.host import started_at, this_host
from worker.leases import Leases
from worker.queue import Wakeups
from worker.reaper import Reaper
from worker.records import Records
from worker.rows import NewDesign
from worker.settings import Settings
from worker.views import DesignRecord, DomainRecord


@pytest.fixture(scope="module")
def broker() -> Iterator[Broker]:
    broker = Broker()
    broker.start()
    yield broker
    broker.close()


@pytest.fixture
def reaper(records: Records) -> Reaper:
    return Reaper(records, Wakeups(records.settings))


def register(records: Records, worker_id: str, queue: str = "cpu", pid: int | None = None, host: str = "") -> None:
    pid = pid or os.getpid()
    with records.database.write() as session:
        session.add(
            tables.Worker(
                id=worker_id,
                host=host or this_host(),
                name="test",
                pid=pid,
                pid_started=started_at(os.getpid()),
                queue=queue,
                concurrency=1,
                draining=False,
                facts={},
                started_at=Now(),
                heartbeat_at=Now(),
            )
        )


def test_a_running_lease_is_left_alone(records: Records, leases: Leases, design: DesignRecord, reaper: Reaper) -> None:
    register(records, "w")
    lease = leases.claim("cpu", "w")
    assert lease is not None
    assert reaper.run_once().taken_away == 0
    assert leases.commit(lease, result_of("prepare")) is not None


def test_an_expired_lease_is_taken_away_once(
    records: Records, leases: Leases, design: DesignRecord, reaper: Reaper
) -> None:
    register(records, "w", host="elsewhere")
    lease = leases.claim("cpu", "w")
    assert lease is not None
    with records.database.write() as session:
        session.execute(update(tables.Design).values(lease_until=Now() - 1))
    assert reaper.run_once().taken_away == 1
    assert reaper.run_once().taken_away == 0
    assert not leases.renew(lease)


def test_what_a_dead_process_of_this_machine_held_waits_at_once(
    records: Records, leases: Leases, design: DesignRecord, reaper: Reaper
) -> None:
    dead = subprocess.Popen([sys.executable, "-c", ""])
    dead.wait()
    register(records, "w", pid=dead.pid)
    assert leases.claim("cpu", "w") is not None
    assert reaper.run_once().taken_away == 1
    assert leases.claim("cpu", "w2") is not None


def test_a_clock_set_back_does_not_hold_a_design_for_hours(
    records: Records, leases: Leases, design: DesignRecord, reaper: Reaper
) -> None:
    register(records, "w", host="elsewhere")
    leases.claim("cpu", "w")
    with records.database.write() as session:
        session.execute(update(tables.Design).values(lease_until=Now() + 7200))
    assert reaper.run_once().taken_away == 1


@pytest.mark.parametrize("claimed", [False, True])
def test_a_design_past_its_deadline_fails(
    records: Records, leases: Leases, domain: DomainRecord, reaper: Reaper, claimed: bool
) -> None:
    made, _ = records.create_design(NewDesign(domain.id, small_spec(), deadline_s=0.2))
    lease = leases.claim("cpu", "w") if claimed else None
    time.sleep(0.25)
    assert claimed or leases.claim("cpu", "w") is None
    assert reaper.run_once().overdue == 1
    record = records.design(made.id)
    assert record is not None
    assert record.error is not None
    assert (record.status, record.error["code"]) == ("failed", "deadline-exceeded")
    assert lease is None or not leases.renew(lease)


def test_a_neural_field_goes_to_the_cpu_when_the_gpu_is_gone(
    records: Records, leases: Leases, domain: DomainRecord, reaper: Reaper
) -> None:
    register(records, "c")
    register(records, "g", queue="gpu", host="elsewhere")
    made, _ = records.create_design(NewDesign(domain.id, small_spec(field={"method": "neural"})))
    lease = leases.claim("cpu", "c")
    assert lease is not None
    following = leases.commit(lease, result_of("prepare"))
    assert following is not None
    assert following.queue == "gpu"
    assert reaper.run_once().rerouted == 0
    with records.database.write() as session:
        session.execute(update(tables.Worker).where(tables.Worker.id == "g").values(heartbeat_at=Now() - 60))
    assert reaper.run_once().rerouted == 1
    moved = records.design(made.id)
    assert moved is not None
    assert moved.queue == "cpu"


def test_lost_messages_are_repeated_and_waiting_ones_are_not(tmp_path: Path, broker: Broker) -> None:
    settings = Settings(data_dir=tmp_path, redis_url=broker.url)
    records = Records.open(settings)
    records.add_domain(id="0" * 64, sha256="0" * 64, size=1, name="x", suffix=".stl", units="mm", inspection={})
    wakeups = Wakeups(settings)
    for i in range(5):
        made, _ = records.create_design(NewDesign("0" * 64, small_spec(seed=i)))
        assert wakeups.send(made)
    reaper = Reaper(records, wakeups)
    assert reaper.run_once().resent == 0
    broker.wipe()
    began = time.monotonic()
    assert not wakeups.ping()
    assert not wakeups.send(made)
    assert time.monotonic() - began < 3.0, "a broker that is away must not hold up a request"
    broker.start()
    assert wakeups.length("cpu") == 0
    with records.database.write() as session:
        session.execute(update(tables.Design).values(dispatched_at=Now() - 10))
    assert reaper.run_once().resent == 5
    assert reaper.run_once().resent == 0
    assert wakeups.length("cpu") == 5
    records.close()
