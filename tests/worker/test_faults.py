"""Faults that are not a clean death: frozen workers, locked records, a wiped broker, random kills."""

from __future__ import annotations

import signal
import sqlite3
import threading
import time
from pathlib import Path

import psutil
import pytest
from sqlalchemy.exc import OperationalError

from benchmarks.fault_campaign import Plan, run
from benchmarks.fault_figures import MUST_BE_ZERO
from tests.proxy import Mode
from tests.worker.conftest import Cluster, result_of, wait_for
from worker.leases import Leases
from worker.patience import patiently
from worker.views import DesignRecord


def test_a_write_waits_for_locked_records(tmp_path: Path, leases: Leases, design: DesignRecord) -> None:
    if leases.settings.database_url:
        pytest.skip("PostgreSQL locks rows, not the whole")
    lease = leases.claim("cpu", "w")
    assert lease is not None
    path = leases.settings.folder / "dualms.sqlite3"
    locked = sqlite3.connect(path, isolation_level=None, check_same_thread=False)
    locked.execute("BEGIN EXCLUSIVE")
    threading.Timer(1.0, lambda: locked.execute("ROLLBACK")).start()
    began = time.monotonic()
    assert leases.commit(lease, result_of("prepare")) is not None
    assert time.monotonic() - began > 0.8
    locked.close()


class _Clock:
    """Time that passes by sleeping alone, however busy the machine is."""

    def __init__(self) -> None:
        self.now = 0.0

    def monotonic(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds


def test_patience_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = _Clock()
    monkeypatch.setattr("worker.patience.time", clock)
    calls = []

    def away() -> None:
        calls.append(clock.now)
        raise OperationalError("select", {}, Exception("away"))

    with pytest.raises(OperationalError):
        patiently(away, 1.0)
    assert calls == pytest.approx([0.0, 0.2, 0.6])  # the next would be at 1.4
    assert clock.now <= 1.0


@pytest.mark.slow
def test_a_frozen_worker_loses_its_step_and_its_late_write_is_refused(tmp_path: Path) -> None:
    cluster = Cluster(tmp_path, DUALMS_LEASE_S="3", DUALMS_HEARTBEAT_S="0.5", DUALMS_REAP_S="1")
    frozen: list[psutil.Process] = []
    try:
        cluster.start_worker()
        made = cluster.submit()
        step = wait_for(cluster.steps)[0]
        station = step.parent()
        frozen = [station, step]
        for process in frozen:
            process.send_signal(signal.SIGSTOP)
        first, cluster._worker = cluster._worker, None
        cluster.start_worker()
        wait_for(lambda: [e for e in cluster.records.events(made.id) if e.kind == "retrying"])
        wait_for(lambda: [p for p in cluster.steps() if p.pid != step.pid])
        for process in reversed(frozen):
            process.send_signal(signal.SIGCONT)
        final = wait_for(lambda: (d := cluster.design(made.id)).final and d)
        assert final.status == "succeeded"
        events = cluster.records.events(made.id, limit=10_000)
        done = [e.data["step"] for e in events if e.kind in ("step", "reused", "succeeded")]
        assert done == ["prepare", "solve", "build"]
        assert first is not None
        first.terminate()
        first.wait(30)
    finally:
        for process in frozen:
            if process.is_running():
                process.send_signal(signal.SIGCONT)
        cluster.close()


@pytest.mark.slow
def test_a_wiped_broker_loses_nothing(tmp_path: Path) -> None:
    cluster = Cluster(tmp_path, DUALMS_REAP_S="1")
    try:
        made = [cluster.submit(seed=i) for i in range(2)]
        cluster.broker.wipe()
        cluster.broker.start()
        cluster.start_worker()
        for design in made:
            wait_for(lambda d=design: cluster.design(d.id).status == "succeeded")
    finally:
        cluster.close()


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["hold", "cut"])
def test_a_network_that_fails_between_worker_and_broker_loses_nothing(tmp_path: Path, mode: Mode) -> None:
    cluster = Cluster(tmp_path, behind_proxy=True, DUALMS_REAP_S="2")
    assert cluster.proxy is not None
    try:
        cluster.start_worker()
        first = cluster.submit()
        wait_for(cluster.steps)
        cluster.proxy.set(mode)
        second = cluster.submit(seed=1)  # the service still reaches the broker
        wait_for(lambda: cluster.design(first.id).step != "prepare")
        time.sleep(5)
        cluster.proxy.set("pass")
        for design in (first, second):
            wait_for(lambda d=design: cluster.design(d.id).status == "succeeded")
            events = cluster.records.events(design.id, limit=10_000)
            done = [e.data["step"] for e in events if e.kind in ("step", "reused", "succeeded")]
            assert done == ["prepare", "solve", "build"]
    finally:
        cluster.close()


@pytest.mark.slow
def test_a_short_fault_campaign_loses_nothing(tmp_path: Path) -> None:
    figures = run(Plan(jobs=4, kills=6, seed=3, pause_s=3.0, folder=tmp_path, cancel_every=3, patience_s=400))
    assert {name: figures[name] for name in MUST_BE_ZERO} == dict.fromkeys(MUST_BE_ZERO, 0)
    assert figures["failures"] == []
