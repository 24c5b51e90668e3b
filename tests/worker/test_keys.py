"""API keys: only the hash is kept, and expiry, scopes and quotas hold."""

from __future__ import annotations

import time

import pytest
from sqlalchemy import text

from tests.worker.conftest import result_of, small_spec
from worker.keys import Keys, Quotas, Usage, exceeded
from worker.leases import Leases
from worker.records import Records
from worker.rows import NewDesign


@pytest.fixture
def keys(records: Records) -> Keys:
    return Keys(records.database)


def test_a_key_opens_and_its_secret_is_not_kept(records: Records, keys: Keys) -> None:
    assert not keys.any_valid()
    made, secret = keys.create("team", "ci", ("write",), Quotas(max_live_designs=3))
    assert keys.any_valid()
    found = keys.check(secret)
    assert found is not None
    assert (found.id, found.owner, found.quotas.max_live_designs) == (made.id, "team", 3)
    assert found.allows("write")
    assert not found.allows("admin")
    assert keys.check(secret + "x") is None
    with records.database.read() as session:
        rows = session.execute(text("SELECT * FROM api_keys")).all()
    assert secret not in str(rows)
    assert secret.split("_", 2)[2] not in str(rows)


def test_revoked_and_expired_keys_are_refused(keys: Keys) -> None:
    made, secret = keys.create("team", "a", ("read",))
    assert keys.revoke(made.id)
    assert not keys.revoke(made.id)
    assert keys.check(secret) is None
    _, brief = keys.create("team", "b", ("read",), days=0.05 / 86400)
    time.sleep(0.1)
    assert keys.check(brief) is None
    assert not keys.any_valid()


def test_admin_may_do_all_and_unknown_scopes_are_refused(keys: Keys) -> None:
    admin, _ = keys.create("team", "a", ("admin",))
    assert admin.allows("write")
    with pytest.raises(ValueError, match="scopes"):
        keys.create("team", "a", ("root",))  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="scopes"):
        keys.create("team", "a", ())


def test_usage_counts_what_an_owner_has(records: Records, leases: Leases, keys: Keys) -> None:
    for owner, digit in (("a", "1"), ("b", "2")):
        digest = digit * 64
        records.add_domain(
            id=digest, sha256=digest, size=100, name="x", suffix=".stl", units="mm", inspection={}, owner=owner
        )
        records.create_design(NewDesign(digest, small_spec(), owner=owner))
    lease = leases.claim("cpu", "w")
    assert lease is not None
    leases.commit(lease, result_of("prepare"))
    assert lease.design.owner == "a"
    assert keys.usage("a") == Usage(live_designs=1, stored_bytes=107, uploads_a_day=1)
    records.cancel(lease.id)
    assert keys.usage("a").live_designs == 0
    assert keys.usage("nobody") == Usage(0, 0, 0)


def test_a_quota_says_what_it_is_about() -> None:
    usage = Usage(2, 1000, 5)
    assert exceeded(Quotas(), usage, designs=100) is None
    assert exceeded(Quotas(max_live_designs=3), usage, designs=1) is None
    assert exceeded(Quotas(max_live_designs=2), usage, designs=1) == ("3 designs that have not ended; the key allows 2")
    assert "bytes" in (exceeded(Quotas(max_stored_bytes=1100), usage, stored=101) or "")


def test_the_audit_log_is_newest_first(keys: Keys) -> None:
    for i in range(5):
        keys.note("design.cancel", f"d{i}", owner="team", key_id="k", reason="test")
    first = keys.audit(limit=3)
    assert [entry.subject for entry in first] == ["d4", "d3", "d2"]
    assert [entry.subject for entry in keys.audit(before=first[-1].id)] == ["d1", "d0"]
    assert first[0].detail == {"reason": "test"}
