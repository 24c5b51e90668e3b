"""Leases: one holder at a time, late writers refused, bounded tries."""

from __future__ import annotations

import random
from concurrent.futures import ThreadPoolExecutor

import pytest
from sqlalchemy import update

from dualms.steps import step_keys
from tests.worker.conftest import result_of, small_spec
from worker import tables, totals
from worker.failures import Failure
from worker.lease import Lease, StepRecord
from worker.leases import Leases
from worker.records import Records
from worker.rows import NewDesign
from worker.views import DesignRecord, DomainRecord

STEPS = ("prepare", "solve", "build")


def claim(leases: Leases, worker: str = "w") -> Lease:
    lease = leases.claim("cpu", worker)
    assert lease is not None
    return lease


def test_a_design_goes_through_its_steps_to_success(records: Records, leases: Leases, design: DesignRecord) -> None:
    for step in STEPS:
        lease = claim(leases)
        assert lease.step == step
        assert [file.step for file in lease.inputs] == list(reversed(STEPS[: STEPS.index(step)]))[::-1]
        assert leases.renew(lease, (result_stage(step), 0.5, "half"))
        assert leases.commit(lease, result_of(step)) is not None
    final = records.design(design.id)
    assert final is not None
    assert (final.status, final.progress, final.metrics) == ("succeeded", 1.0, dict.fromkeys(STEPS, 1))
    assert leases.claim("cpu", "w") is None
    kinds = [event.kind for event in records.events(design.id)]
    assert kinds == ["queued", "started", "step", "started", "step", "started", "succeeded"]


def result_stage(step: str) -> str:
    return {"prepare": "graph", "solve": "field", "build": "body"}[step]


def test_progress_never_goes_back(records: Records, leases: Leases, design: DesignRecord) -> None:
    seen = [0.0]
    for step in STEPS:
        lease = claim(leases)
        for fraction in (0.1, 0.9):
            leases.renew(lease, (result_stage(step), fraction, ""))
            seen.append(records.design(design.id).progress)  # type: ignore[union-attr]
        leases.commit(lease, result_of(step))
        seen.append(records.design(design.id).progress)  # type: ignore[union-attr]
    assert seen == sorted(seen)
    assert seen[-1] == 1.0


def test_many_workers_claim_each_design_once(records: Records, leases: Leases, domain: DomainRecord) -> None:
    made = {records.create_design(NewDesign(domain.id, small_spec(seed=i)))[0].id for i in range(24)}
    with ThreadPoolExecutor(8) as pool:
        got = list(pool.map(lambda i: leases.claim("cpu", f"w{i}"), range(40)))
    assert sorted(lease.id for lease in got if lease is not None) == sorted(made)


def test_a_late_write_is_refused(records: Records, leases: Leases, design: DesignRecord) -> None:
    late = claim(leases, "slow")
    assert leases.requeue.expire(late.design, "gone") is not None
    assert not leases.renew(late)
    current = claim(leases, "quick")
    before = records.design(design.id)
    assert not leases.renew(late, ("graph", 0.9, ""))
    assert leases.commit(late, result_of("prepare")) is None
    assert not leases.fail(late, Failure("x", "y"))
    assert leases.requeue.hand_back(late, "no") is None
    assert not leases.keep_checkpoint(late, "1" * 64, 1)
    assert records.design(design.id) == before
    assert leases.commit(current, result_of("prepare")) is not None


def test_a_step_is_committed_once(leases: Leases, design: DesignRecord) -> None:
    lease = claim(leases)
    assert leases.commit(lease, result_of("prepare")) is not None
    assert leases.commit(lease, result_of("prepare")) is None


@pytest.mark.parametrize("ending", ["succeeded", "failed", "cancelled"])
def test_a_final_status_never_changes(records: Records, leases: Leases, design: DesignRecord, ending: str) -> None:
    lease = claim(leases)
    if ending == "succeeded":
        for step in STEPS:
            leases.commit(lease, result_of(step))
            lease = leases.claim("cpu", "w") or lease
    elif ending == "failed":
        leases.fail(lease, Failure("x", "y"))
    else:
        records.cancel(design.id)
    final = records.design(design.id)
    assert final is not None
    assert final.status == ending
    records.cancel(design.id)
    leases.fail(lease, Failure("late", "late"))
    leases.commit(lease, result_of("build"))
    leases.requeue.hand_back(lease, "late")
    leases.requeue.expire(lease.design, "late")
    leases.renew(lease, ("report", 1.0, "late"))
    assert records.design(design.id) == final
    assert records.events(design.id)[-1].kind == ending


def test_random_histories_keep_the_invariants(records: Records, leases: Leases, domain: DomainRecord) -> None:
    rng = random.Random(5)
    made = [records.create_design(NewDesign(domain.id, small_spec(seed=i)))[0].id for i in range(6)]
    held: list[Lease] = []
    finals: dict[str, DesignRecord] = {}
    for _ in range(400):
        move = rng.choice(["claim", "commit", "commit", "renew", "back", "expire", "cancel", "fail"])
        lease = rng.choice(held) if held else None
        if move == "claim":
            got = leases.claim("cpu", "w")
            held += [got] if got is not None else []
        elif move == "cancel" and rng.random() < 0.05:
            records.cancel(rng.choice(made))
        elif lease is None:
            continue
        elif move == "commit":
            leases.commit(lease, result_of(lease.step))
        elif move == "renew":
            leases.renew(lease, (result_stage(lease.step), rng.random(), ""))
        elif move == "back":
            leases.requeue.hand_back(lease, "x", counts=rng.random() < 0.5)
        elif move == "expire":
            leases.requeue.expire(lease.design, "x")
        elif move == "fail" and rng.random() < 0.05:
            leases.fail(lease, Failure("x", "y"))
        for design_id in made:
            now = records.design(design_id)
            assert now is not None
            assert finals.setdefault(design_id, now) == now if design_id in finals or now.final else True
    for design_id in made:
        events = records.events(design_id, limit=10_000)
        assert [e.sequence for e in events] == sorted({e.sequence for e in events})
        done = [e.data["step"] for e in events if e.kind in ("step", "succeeded")]
        assert done == list(STEPS[: len(done)]), "a step was committed twice or out of order"
        assert events[-1].sequence == records.version(design_id)[0]  # type: ignore[index]
    assert finals


def test_a_step_is_started_a_bounded_number_of_times(records: Records, leases: Leases, design: DesignRecord) -> None:
    for _ in range(records.settings.max_tries):
        leases.requeue.hand_back(claim(leases), "its process was ended by SIGKILL")
    final = records.design(design.id)
    assert final is not None
    assert final.status == "failed"
    assert final.error is not None
    assert final.error["code"] == "worker-lost"
    assert "SIGKILL" in final.error["message"]


def test_being_stopped_does_not_count_as_a_try(records: Records, leases: Leases, design: DesignRecord) -> None:
    for _ in range(2 * records.settings.max_tries):
        leases.requeue.hand_back(claim(leases), "its worker was stopped", counts=False)
    record = records.design(design.id)
    assert record is not None
    assert (record.status, record.tries) == ("running", 0)


def test_a_checkpoint_outlives_its_process_and_not_its_step(leases: Leases, design: DesignRecord) -> None:
    first = claim(leases)
    assert leases.keep_checkpoint(first, "c" * 64, 9)
    leases.requeue.hand_back(first, "killed")
    second = claim(leases)
    assert second.checkpoint == {"sha256": "c" * 64, "size": 9}
    leases.commit(second, result_of("prepare"))
    assert claim(leases).checkpoint is None


def test_owners_take_turns_and_each_owners_urgent_designs_go_first(
    records: Records, leases: Leases, domain: DomainRecord
) -> None:
    def add(owner: str, priority: int = 0) -> str:
        return records.create_design(NewDesign(domain.id, small_spec(), owner=owner, priority=priority))[0].id

    late, first, second = add("many", priority=-1), add("many"), add("many")
    other, polite = add("few"), add("few", priority=-3)
    urgent = add("many", priority=5)
    assert [claim(leases).id for _ in range(6)] == [urgent, other, first, polite, second, late]


def test_a_changed_wall_reuses_the_field(records: Records, leases: Leases, design: DesignRecord) -> None:
    for step in STEPS:
        leases.commit(claim(leases), result_of(step))
    records.create_design(NewDesign(design.domain_id, small_spec(wall={"thickness": 2.0})))
    assert leases.cache.find(claim(leases).key) is not None
    keys = [step_keys("0" * 64, small_spec(wall={"thickness": t})) for t in (1.5, 2.0)]
    assert [keys[0][s] == keys[1][s] for s in STEPS] == [True, True, False]


def test_a_smaller_batch_is_kept_with_the_design(records: Records, leases: Leases, domain: DomainRecord) -> None:
    spec = small_spec(field={"method": "neural", "points": 4096})
    made, _ = records.create_design(NewDesign(domain.id, spec))
    with records.database.write() as session:
        session.execute(update(tables.Design).values(step="solve"))
    lease = claim(leases)
    smaller = spec.model_copy(update={"field": spec.field.model_copy(update={"points": 1024})})
    leases.requeue.hand_back(lease, "too small", spec=smaller, points=1024)
    again = claim(leases)
    assert again.design.spec["field"]["points"] == 1024
    assert again.hints == {"points": 1024}
    assert again.key != lease.key
    assert records.events(made.id)[-2].data["reason"] == "too small"


def test_an_update_of_the_code_starts_a_design_over(
    leases: Leases, design: DesignRecord, monkeypatch: pytest.MonkeyPatch
) -> None:
    leases.commit(claim(leases), result_of("prepare"))
    same = claim(leases)
    key = same.key
    assert not same.of_other_code
    leases.requeue.hand_back(same, "x", counts=False)
    monkeypatch.setattr("worker.lease.code_id", lambda: "99")
    lease = claim(leases)
    assert lease.of_other_code
    assert lease.key != key
    assert leases.requeue.start_over(lease, "updated") is not None
    again = claim(leases)
    assert (again.step, again.of_other_code) == ("prepare", False)


def test_totals_count_what_happened(records: Records, leases: Leases, design: DesignRecord) -> None:
    for step in STEPS:
        leases.commit(claim(leases), result_of(step))
    records.create_design(NewDesign(design.domain_id, small_spec()))
    leases.commit(claim(leases), StepRecord((), {}, {}), reused=True)
    leases.fail(claim(leases), Failure("worker-lost", "x"))
    found = {(t.kind, t.name): (t.count, t.seconds) for t in totals.read(records.database)}
    assert found == {
        ("ended", "failed"): (1, 0.0),
        ("ended", "succeeded"): (1, 0.0),
        ("failure", "worker-lost"): (1, 0.0),
        ("reused", "prepare"): (1, 0.0),
        ("stage", "build"): (1, 0.5),
        ("stage", "prepare"): (1, 0.5),
        ("stage", "solve"): (1, 0.5),
    }
