"""A data folder that the first version wrote, and that was killed in the middle of its work, opens with the newest."""

from __future__ import annotations

import hashlib
import tarfile
from pathlib import Path

import pytest

from dualms.spec import Spec
from tests.worker.conftest import Cluster, wait_for
from worker.leases import Leases
from worker.queue import Wakeups
from worker.reaper import Reaper
from worker.records import Records
from worker.settings import Settings
from worker.stores import open_store

FOLDER = Path(__file__).parent / "data" / "first_version.tar.xz"


@pytest.fixture
def old(tmp_path: Path) -> Path:
    with tarfile.open(FOLDER) as archive:
        archive.extractall(tmp_path, filter="data")
    return tmp_path / "first_version"


def test_what_the_first_version_recorded_is_still_there(old: Path) -> None:
    settings = Settings(data_dir=old, database_url="", store_url="", redis_url="")
    records, store = Records.open(settings), open_store(settings)
    designs = {design.name: design for design in records.designs().items}
    assert {name: design.status for name, design in designs.items()} == {
        "finished": "succeeded",
        "cancelled": "cancelled",
        "half": "running",
        "waiting": "queued",
    }
    for design in designs.values():
        assert Spec.model_validate(design.spec).graph.sites == 24
        assert records.domain(design.domain_id) is not None
        events = [event.sequence for event in records.events(design.id)]
        assert events == sorted(events)
    (report,) = [a for a in records.artifacts(designs["finished"].id) if a.name == "report.json"]
    assert hashlib.sha256(b"".join(store.get(report.sha256))).hexdigest() == report.sha256
    assert [d.name for d in records.designs(label="old").items] == ["finished"]
    records.close()


def test_what_the_first_version_had_begun_starts_over_with_this_code(old: Path) -> None:
    records = Records.open(Settings(data_dir=old, database_url="", store_url="", redis_url=""))
    leases = Leases(records)
    assert Reaper(records, Wakeups(records.settings)).run_once().taken_away == 1, "its worker is gone"
    half = leases.claim("cpu", "w")
    assert half is not None
    assert (half.design.name, half.step, half.of_other_code) == ("half", "solve", True)
    again = leases.requeue.start_over(half, "updated")
    assert again is not None
    assert (again.step, again.final) == ("prepare", False)
    claimed = [leases.claim("cpu", "w") for _ in range(2)]
    (once_more,) = [lease for lease in claimed if lease is not None and lease.id == half.id]
    assert once_more.inputs == (), "what it made the first time may be gone"
    records.close()


@pytest.mark.slow
def test_what_the_first_version_left_is_finished_by_this_one(old: Path) -> None:
    cluster = Cluster(old)
    try:
        cluster.start_worker()
        live = [design.id for design in cluster.records.designs().items if not design.final]
        assert len(live) == 2
        for design in live:
            final = wait_for(lambda d=design: (now := cluster.design(d)).final and now)
            assert final.status == "succeeded", final.error
    finally:
        cluster.close()
