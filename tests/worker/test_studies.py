"""Studies in the records: made whole, read, cancelled and deleted as one."""

from __future__ import annotations

from typing import Any

import pytest

from tests.worker.conftest import result_of, small_spec
from worker.garbage import collect
from worker.idempotency import IdempotencyConflict
from worker.leases import Leases
from worker.records import Records
from worker.rows import NewDesign
from worker.stores import open_store
from worker.studies import NewStudy, Studies, StudyRecord
from worker.views import FINAL, DomainRecord


def new_study(domain: DomainRecord, seeds: int = 4, **changes: Any) -> NewStudy:
    points = tuple(({"seed": k}, NewDesign(domain.id, small_spec(seed=k), labels=("x",))) for k in range(seeds))
    return NewStudy(domain.id, {}, {"seed": list(range(seeds)), "a": [1]}, ("area_m2",), points, **changes)


@pytest.fixture
def studies(records: Records) -> Studies:
    return Studies(records)


@pytest.fixture
def study(studies: Studies, domain: DomainRecord) -> StudyRecord:
    return studies.create(new_study(domain))[0]


def end_next(leases: Leases, failed: bool = False) -> str:
    """End the first design that waits."""
    while True:
        lease = leases.claim("cpu", "w")
        assert lease is not None
        if failed:
            from worker.failures import deadline_exceeded

            assert leases.fail(lease, deadline_exceeded(1))
            return lease.id
        after = leases.commit(lease, result_of(lease.step))
        assert after is not None
        if after.final:
            return lease.id


def test_a_study_is_recorded_with_its_designs_in_the_grids_order(records: Records, study: StudyRecord) -> None:
    assert [p.values["seed"] for p in study.points] == [0, 1, 2, 3]
    assert [p.design_id for p in study.points] == sorted(p.design_id for p in study.points)
    assert [p.design.spec["seed"] for p in study.points if p.design] == [0, 1, 2, 3]
    assert list(study.grid) == ["seed", "a"]
    labelled = records.designs(label=f"study={study.id}").items
    assert {d.id for d in labelled} == {p.design_id for p in study.points}
    assert all(d.study_id == study.id and "x" in d.labels for d in labelled)
    assert Studies(records).study(study.id) == study


def test_designs_are_taken_up_in_the_grids_order(leases: Leases, study: StudyRecord) -> None:
    assert [end_next(leases) for _ in study.points] == [p.design_id for p in study.points]


def test_a_key_gives_one_study(studies: Studies, records: Records, domain: DomainRecord) -> None:
    first, made = studies.create(new_study(domain), ("key", "a" * 64))
    again, made_again = studies.create(new_study(domain), ("key", "a" * 64))
    assert (first, made, made_again) == (again, True, False)
    assert len(records.designs().items) == 4
    with pytest.raises(IdempotencyConflict):
        studies.create(new_study(domain), ("key", "b" * 64))
    with pytest.raises(IdempotencyConflict):
        records.create_design(NewDesign(domain.id, small_spec()), ("key", "c" * 64))
    assert studies.delete(first.id)
    assert studies.create(new_study(domain), ("key", "a" * 64))[1]


def test_a_study_that_cannot_be_recorded_leaves_no_designs(
    studies: Studies, records: Records, domain: DomainRecord
) -> None:
    new = new_study(domain)
    broken = (*new.points, ({"seed": object()}, new.points[0][1]))
    with pytest.raises(Exception, match="serializable"):
        studies.create(NewStudy(domain.id, {}, {"seed": [1]}, (), broken))
    assert records.designs().items == ()
    assert studies.page() == ((), None)


def test_status_follows_from_the_points(studies: Studies, leases: Leases, study: StudyRecord) -> None:
    def now() -> StudyRecord:
        found = studies.study(study.id)
        assert found is not None
        return found

    assert now().status == "queued"
    end_next(leases)
    assert (now().status, now().counts["succeeded"], now().final) == ("running", 1, False)
    end_next(leases, failed=True)
    end_next(leases, failed=True)
    assert now().version != study.version
    end_next(leases)
    assert (now().status, now().final) == ("succeeded", True)


def test_a_study_fails_only_if_all_points_do(studies: Studies, leases: Leases, domain: DomainRecord) -> None:
    study = studies.create(new_study(domain, 2))[0]
    for _ in study.points:
        end_next(leases, failed=True)
    found = studies.study(study.id)
    assert found is not None
    assert found.status == "failed"


def test_cancelling_stops_what_has_not_ended_and_nothing_else(
    studies: Studies, records: Records, leases: Leases, domain: DomainRecord, study: StudyRecord
) -> None:
    other = records.create_design(NewDesign(domain.id, small_spec(seed=9)))[0]
    done = end_next(leases)
    running = leases.claim("cpu", "w")
    stopped = studies.cancel(study.id)
    assert stopped is not None
    assert stopped.status == "cancelled"
    assert [p.design.status for p in stopped.points if p.design] == ["succeeded", "cancelled", "cancelled", "cancelled"]
    assert stopped.points[0].design_id == done
    assert running is not None
    assert not leases.renew(running)
    following = leases.claim("cpu", "w")
    assert following is not None
    assert following.id == other.id
    assert studies.cancel("0" * 32) is None


def test_deleting_leaves_nothing(studies: Studies, records: Records, leases: Leases, study: StudyRecord) -> None:
    end_next(leases)
    assert studies.delete(study.id)
    assert not studies.delete(study.id)
    assert studies.study(study.id) is None
    assert records.designs().items == ()


def test_a_study_without_designs_is_collected(
    studies: Studies, records: Records, domain: DomainRecord, study: StudyRecord
) -> None:
    kept = studies.create(new_study(domain, 1))[0]
    for point in study.points:
        records.delete(point.design_id)
    gone = studies.study(study.id)
    assert gone is not None
    assert gone.status in FINAL
    collect(records, open_store(records.settings))
    assert studies.study(study.id) is None
    assert studies.study(kept.id) == kept


def test_pages_hold_every_study_once_newest_first(studies: Studies, domain: DomainRecord) -> None:
    made = [studies.create(new_study(domain, 1))[0].id for _ in range(5)]
    seen, cursor = [], None
    while True:
        page, cursor = studies.page(2, cursor)
        seen += [s.id for s in page]
        if cursor is None:
            break
    assert seen == sorted(made, reverse=True)
