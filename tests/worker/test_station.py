"""A real worker on a real broker: killed, repeated, cancelled, stopped; the designs end as they should."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import psutil

from tests.worker.conftest import Cluster, wait_for


def kinds(cluster: Cluster, design_id: str, kind: str) -> list[str]:
    return [e.data.get("step", "") for e in cluster.records.events(design_id, limit=10_000) if e.kind == kind]


def test_the_worker_process_imports_no_torch() -> None:
    code = "import sys, worker.station; sys.exit(any(m in sys.modules for m in ('torch', 'numba', 'trimesh')))"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_a_design_outlives_kills_of_its_step_and_of_its_worker(cluster: Cluster) -> None:
    made = cluster.submit()
    step = wait_for(cluster.steps)[0]
    step.kill()
    again = wait_for(lambda: [p for p in cluster.steps() if p.pid != step.pid])[0]
    assert kinds(cluster, made.id, "retrying") == ["prepare"]
    wait_for(lambda: cluster.design(made.id).step != "prepare")
    running = wait_for(cluster.steps)[0]
    assert running.pid != again.pid
    cluster.kill_worker()
    psutil.wait_procs([running], timeout=30)  # at the latest when it has started, which takes long on a busy machine
    assert not running.is_running(), "a step dies with its worker"
    assert not cluster.design(made.id).final
    cluster.start_worker()
    final = wait_for(lambda: (d := cluster.design(made.id)).final and d)
    assert final.status == "succeeded", final.error
    done = [e.data["step"] for e in cluster.records.events(made.id, limit=10_000) if e.kind in ("step", "succeeded")]
    assert done == ["prepare", "solve", "build"]
    names = {a.name for a in cluster.records.artifacts(made.id)}
    assert {"surface.stl", "solid.stl", "report.json", "preview.png"} <= names
    assert all(cluster.store.size(a.sha256) == a.size for a in cluster.records.artifacts(made.id, internal=True))
    assert list(cluster.settings.scratch.iterdir()) == []


def test_repeated_messages_and_equal_requests_do_no_work_twice(cluster: Cluster) -> None:
    made = cluster.submit()  # the same request as before: all steps are in the cache
    for _ in range(5):
        for step in ("build", "prepare", "solve"):
            cluster.wakeups.send_to("cpu", made.id, step)
    final = wait_for(lambda: (d := cluster.design(made.id)).final and d)
    assert final.status == "succeeded"
    events = cluster.records.events(made.id, limit=10_000)
    assert [e.data["step"] for e in events if e.kind == "started"] == ["prepare", "solve", "build"]
    assert all(e.data["reused"] for e in events if e.kind in ("reused", "succeeded"))
    wait_for(lambda: cluster.wakeups.length("cpu") == 0)
    assert len(cluster.records.events(made.id, limit=10_000)) == len(events)


def test_cancelling_frees_the_worker_within_ten_seconds(cluster: Cluster) -> None:
    made = cluster.submit(seed=1)
    running = wait_for(cluster.steps)[0]
    began = time.monotonic()
    record = cluster.records.cancel(made.id)
    assert record is not None
    assert record.status == "cancelled"
    wait_for(lambda: not running.is_running() or running.status() == psutil.STATUS_ZOMBIE, 10)
    assert time.monotonic() - began < 10
    assert cluster.design(made.id).status == "cancelled"


def test_a_design_that_cannot_be_made_fails_with_advice(cluster: Cluster) -> None:
    off = {"inlets": [{"center": [500, 0, 0], "radius": 1}], "outlets": [{"facet": 5}]}
    made = cluster.submit(fluids={"hot": off, "cold": off})
    final = wait_for(lambda: (d := cluster.design(made.id)).final and d)
    assert final.error is not None
    assert (final.status, final.error["code"]) == ("failed", "port-not-on-boundary")
    assert final.error["advice"]


def test_a_stopped_worker_hands_back_what_runs(cluster: Cluster) -> None:
    made = cluster.submit(seed=2, field={"method": "neural", "steps": 50_000})
    wait_for(lambda: cluster.design(made.id).step == "solve" and cluster.steps())
    took = cluster.stop_worker()
    # It drains for 2 s, a step that does not stop is killed after 5 s, and 5 s more are for a busy machine.
    assert took < 2 + 5 + 5 + 3
    record = cluster.design(made.id)
    assert (record.status, record.step, record.tries) == ("running", "solve", 0)
    assert cluster.steps() == []
    assert cluster.records.workers() == ()
    assert list(cluster.settings.scratch.iterdir()) == []
    cluster.records.cancel(made.id)


def test_a_worker_that_is_stopped_while_the_broker_is_away_hands_back(tmp_path: Path) -> None:
    cluster = Cluster(tmp_path, DUALMS_DRAIN_S="1")
    try:
        cluster.start_worker()
        made = cluster.submit(partition={"seconds": 600})
        wait_for(lambda: cluster.design(made.id).stage == "partition")
        cluster.broker.kill()
        wait_for(lambda: "Cannot connect" in (tmp_path / "worker.log").read_text())
        took = cluster.stop_worker()
        assert took < 1 + 5 + 5, "it ends by itself, before its parent would kill it"
        record = cluster.design(made.id)
        assert (record.status, record.step, record.tries) == ("running", "prepare", 0)
        assert cluster.steps() == []
        assert cluster.records.workers() == ()
    finally:
        cluster.close()


def test_limits_end_a_step_and_say_so(tmp_path: Path) -> None:
    cluster = Cluster(tmp_path, DUALMS_STEP_MEMORY_BYTES=str(60 << 20))
    try:
        cluster.start_worker()
        made = cluster.submit()
        final = wait_for(lambda: (d := cluster.design(made.id)).final and d)
        assert final.error is not None
        assert final.error["code"] == "memory-limit"
        assert final.error["measured"]["used_bytes"] > 60 << 20
    finally:
        cluster.close()
