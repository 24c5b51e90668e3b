"""What a worker makes of a step's outcome."""

from __future__ import annotations

import threading
from dataclasses import replace

import pytest

from tests.worker.conftest import result_of, small_spec
from worker.child import Outcome
from worker.failures import GPU_OUT_OF_MEMORY, Failure, failure_of
from worker.lease import Lease
from worker.leases import Leases
from worker.queue import Wakeups
from worker.records import Records
from worker.rows import NewDesign
from worker.stores import open_store
from worker.tasks import Station, _record, carry_out, take_one
from worker.views import DomainRecord


@pytest.fixture
def station(records: Records, leases: Leases) -> Station:
    settings = records.settings
    return Station("cpu", "w", settings, leases, open_store(settings), Wakeups(settings), threading.Event())


def claim(leases: Leases) -> Lease:
    lease = leases.claim("cpu", "w")
    assert lease is not None
    return lease


@pytest.mark.parametrize("method", ["neural", "distilled"])
def test_a_gpu_that_is_too_small_gets_a_smaller_batch_once(
    records: Records, leases: Leases, station: Station, domain: DomainRecord, method: str
) -> None:
    made, _ = records.create_design(NewDesign(domain.id, small_spec(field={"method": method, "points": 8192})))
    leases.commit(claim(leases), result_of("prepare"))
    full = Outcome("failed", failure=Failure(GPU_OUT_OF_MEMORY, "too little"))
    following = _record(station, claim(leases), full)
    assert following is not None
    assert following.spec["field"]["points"] == 2048
    assert "again with 2048" in records.events(made.id)[-1].data["reason"]
    assert _record(station, claim(leases), full) is None
    final = records.design(made.id)
    assert final is not None
    assert final.error is not None
    assert (final.status, final.error["code"]) == ("failed", GPU_OUT_OF_MEMORY)


def test_a_cached_result_whose_file_is_gone_is_not_used(
    records: Records, leases: Leases, station: Station, domain: DomainRecord
) -> None:
    records.create_design(NewDesign(domain.id, small_spec()))
    leases.commit(claim(leases), result_of("prepare"))
    records.create_design(NewDesign(domain.id, small_spec(), priority=1))
    lease = claim(leases)
    assert leases.cache.find(lease.key) is not None
    # The domain's bytes are not in the store either, so the child cannot start: the design goes back to its beginning.
    following = carry_out(station, lease)
    assert following is not None
    assert (following.step, following.final) == ("prepare", False)
    assert leases.cache.find(lease.key) is None


def test_inputs_that_stay_lost_end_the_design(
    records: Records, leases: Leases, station: Station, domain: DomainRecord
) -> None:
    made, _ = records.create_design(NewDesign(domain.id, small_spec()))
    for _ in range(records.settings.max_tries + 1):
        _record(station, claim(leases), Outcome("missing", reason="abc is gone from the store"))
    final = records.design(made.id)
    assert final is not None
    assert final.error is not None
    assert final.error["code"] == "worker-lost"


def test_a_full_store_is_tried_again_and_then_said(
    records: Records, leases: Leases, station: Station, domain: DomainRecord
) -> None:
    made, _ = records.create_design(NewDesign(domain.id, small_spec()))
    full = Outcome("failed", failure=Failure("store-full", "The artifact store has no room left."))
    for _ in range(records.settings.max_tries - 1):
        following = _record(station, claim(leases), full)
        assert following is not None
        assert not following.final
    _record(station, claim(leases), full)
    final = records.design(made.id)
    assert final is not None
    assert final.error is not None
    assert (final.status, final.error["code"]) == ("failed", "store-full")


def test_steps_wait_while_the_disk_is_full(
    records: Records, leases: Leases, station: Station, domain: DomainRecord
) -> None:
    records.create_design(NewDesign(domain.id, small_spec()))
    full = replace(station, settings=station.settings.model_copy(update={"free_bytes": 1 << 60}))
    assert not take_one(full)
    assert records.counts() == {"queued": 1}
    assert claim(leases).design.tries == 1


def test_a_draining_worker_takes_nothing(records: Records, station: Station, domain: DomainRecord) -> None:
    records.create_design(NewDesign(domain.id, small_spec()))
    station.drain.set()
    assert not take_one(station)


def test_what_is_not_safe_to_show_is_logged_under_an_id(caplog: pytest.LogCaptureFixture) -> None:
    failure = failure_of(ValueError("/home/secret/path"))
    assert failure.code == "internal-error"
    assert failure.id is not None
    assert failure.id in failure.message
    assert "secret" not in str(failure.as_json())
    assert failure.id in caplog.text
    assert "secret" in caplog.text
