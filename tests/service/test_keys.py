"""API keys: once there is one, nobody gets in without; owners see nothing of each other; quotas hold."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any

import httpx
import pytest

if TYPE_CHECKING:
    from conftest import Served, Team


@pytest.fixture
def endless(spec: dict[str, Any]) -> dict[str, Any]:
    """A design that no other test makes, so none finds it ended in the cache, and that searches for minutes."""
    return {**spec, "partition": {"method": "anneal", "seconds": 600}}


def problem(answer: httpx.Response, status: int, code: str) -> None:
    assert (answer.status_code, answer.json()["code"]) == (status, code), answer.text
    assert answer.json()["advice"]


@pytest.mark.parametrize(
    ("headers", "code"),
    [
        ({}, "key-required"),
        ({"Authorization": "Bearer dms_x_y"}, "key-invalid"),
        ({"Authorization": "x"}, "key-required"),
    ],
)
def test_without_a_valid_key_nothing_under_v1_answers(team: Team, headers: dict[str, str], code: str) -> None:
    for method, path in (("GET", "/v1/designs"), ("POST", "/v1/designs"), ("GET", "/v1/domains/" + "0" * 64)):
        answer = httpx.request(method, team.service.url + path, headers=headers)
        problem(answer, 401, code)
        assert answer.headers["www-authenticate"] == "Bearer"
    assert httpx.get(f"{team.service.url}/healthz").status_code == 200


def test_without_a_key_no_body_is_read(team: Team) -> None:
    host, port = team.service.url.removeprefix("http://").split(":")
    form = "Content-Type: multipart/form-data; boundary=b\r\nContent-Length: 400000000"
    with socket.create_connection((host, int(port)), timeout=20) as line:
        line.sendall(f"POST /v1/domains HTTP/1.1\r\nHost: x\r\n{form}\r\n\r\n--b\r\n".encode())
        answer = line.makefile("rb").read()  # to the end: the service hangs up
    assert answer.startswith(b"HTTP/1.1 401 ")
    assert b"key-required" in answer


def test_the_same_bytes_of_two_owners_are_two_domains_and_neither_learns_of_the_other(team: Team, box: Path) -> None:
    ann, bob, carl = (team.upload(team.client(owner), box).json() for owner in ("ann", "bob", "carl"))
    assert len({ann["id"], bob["id"], carl["id"]}) == 3
    assert ann["sha256"] == bob["sha256"] == carl["sha256"]
    assert ann["sha256"] not in (ann["id"], bob["id"]), "an id would tell who came first"


def test_bytes_of_another_are_not_found_by_their_hash(team: Team, box: Path) -> None:
    known = team.upload(team.client("ann"), box).json()["sha256"]
    dan = team.client("dan")
    for sha256 in (known, "0" * 64):
        problem(dan.post("/v1/domains", data={"sha256": sha256, "units": "mm"}), 404, "domain-not-found")


def test_the_same_idempotency_key_of_two_owners_is_two_keys(team: Team, box: Path, spec: dict[str, Any]) -> None:
    made = []
    for owner in ("ann", "bob"):
        client = team.client(owner)
        body = {"domain": team.upload(client, box).json()["id"], "spec": spec}
        made.append(client.post("/v1/designs", json=body, headers={"Idempotency-Key": "k"}).json()["id"])
        client.post(f"/v1/designs/{made[-1]}/cancel")
    assert made[0] != made[1]


def test_a_key_that_may_only_read_cannot_write(team: Team, box: Path) -> None:
    reader = team.client("ann", "--scopes", "read")
    assert reader.get("/v1/designs").status_code == 200
    problem(team.upload(reader, box), 403, "scope-missing")


def test_a_revoked_key_works_no_longer(team: Team) -> None:
    client = team.client("carl")
    assert client.get("/v1/designs").status_code == 200
    key_id = client.headers["authorization"].split("_")[1]
    team.keys("revoke", key_id)
    deadline = time.monotonic() + 8
    while client.get("/v1/designs").status_code == 200 and time.monotonic() < deadline:
        time.sleep(0.5)
    problem(client.get("/v1/designs"), 401, "key-invalid")
    assert "revoked" in team.keys("list")


def test_an_expired_key_does_not_work(team: Team) -> None:
    problem(team.client("dora", "--days", "0").get("/v1/designs"), 401, "key-invalid")


def test_quotas_are_answered_by_429(team: Team, box: Path, endless: dict[str, Any]) -> None:
    one = team.client("emil", "--max-live-designs", "1", "--max-uploads-a-day", "1")
    domain = team.upload(one, box).json()["id"]
    design = one.post("/v1/designs", json={"domain": domain, "spec": endless})
    assert design.status_code == 202
    full = one.post("/v1/designs", json={"domain": domain, "spec": endless})
    problem(full, 429, "quota-exceeded")
    assert int(full.headers["retry-after"]) > 0
    assert team.upload(one, box).status_code == 201, "the same bytes are no new upload"
    other = one.post("/v1/domains", files={"file": ("box.stl", box.read_bytes())}, data={"units": "in"})
    problem(other, 429, "quota-exceeded")
    one.delete(design.json()["href"])


def test_the_last_free_place_is_given_once_and_a_repeated_request_needs_none(
    team: Team, box: Path, endless: dict[str, Any]
) -> None:
    one = team.client("gus", "--max-live-designs", "1")
    body = {"domain": team.upload(one, box).json()["id"], "spec": endless}
    with ThreadPoolExecutor(12) as pool:
        ask = [pool.submit(one.post, "/v1/designs", json=body, headers={"Idempotency-Key": f"k{i}"}) for i in range(12)]
        answers = {a.result().status_code: a.result() for a in ask}
        assert sorted(a.result().status_code for a in ask) == [202] + 11 * [429]
    made = answers[202]
    again = one.post("/v1/designs", json=body, headers={"Idempotency-Key": made.request.headers["idempotency-key"]})
    assert (again.status_code, again.json()["id"]) == (202, made.json()["id"])
    one.delete(made.json()["href"])


def test_a_domain_can_be_deleted_once_nothing_uses_it(team: Team, box: Path, spec: dict[str, Any]) -> None:
    client = team.client("hal", "--max-stored-bytes", str(box.stat().st_size))
    domain = team.upload(client, box).json()
    other = client.post("/v1/domains", data={"sha256": domain["sha256"], "units": "in"})
    problem(other, 429, "quota-exceeded")
    design = client.post("/v1/designs", json={"domain": domain["id"], "spec": spec}).json()
    problem(client.delete(domain["href"]), 409, "domain-in-use")
    client.delete(design["href"])
    assert client.delete(domain["href"]).status_code == 204
    problem(client.get(domain["href"]), 404, "domain-not-found")
    assert client.get("/v1/domains").json()["items"] == []
    assert team.upload(client, box).json()["id"] == domain["id"]


def test_the_audit_log_says_who_did_what(team: Team, box: Path, spec: dict[str, Any]) -> None:
    client = team.client("frida")
    design = client.post("/v1/designs", json={"domain": team.upload(client, box).json()["id"], "spec": spec}).json()
    client.delete(design["href"])
    study = {"domain": design["domain"]["id"], "spec": spec, "grid": {"seed": [1]}}
    href = client.post("/v1/studies", json=study).json()["href"]
    client.post(f"{href}/cancel")
    client.delete(href)
    log = team.keys("audit")
    actions = ("key.create", "domain.upload", "design.create", "design.delete", "study.create", "study.cancel")
    for action in (*actions, "study.delete"):
        assert any("frida" in line and action in line for line in log.splitlines()), log


@pytest.mark.parametrize("headers", [{"Sec-Fetch-Site": "cross-site"}, {"Origin": "https://evil.example"}])
def test_pages_of_other_sites_cannot_write(served: Served, headers: dict[str, str]) -> None:
    problem(served.http.post("/v1/designs", json={}, headers=headers), 403, "cross-site")


def test_a_name_that_was_turned_to_this_machine_opens_nothing(served: Served, domain_id: str) -> None:
    for path in ("/v1/designs", f"/v1/domains/{domain_id}"):
        problem(served.http.get(path, headers={"Host": "evil.example:8000"}), 403, "cross-site")
        assert served.http.get(path, headers={"Host": "localhost:8000"}).status_code == 200
    assert "/v1/designs/" not in served.http.get("/", headers={"Host": "evil.example"}).text


def test_with_keys_any_name_will_do(team: Team) -> None:
    assert team.client("ida").get("/v1/designs", headers={"Host": "dualms.example"}).status_code == 200


@pytest.mark.parametrize("url", ["http://127.0.0.1:1/x", "http://169.254.169.254/latest", "ftp://example.org"])
def test_webhooks_to_addresses_that_are_not_public_are_refused(
    served: Served, domain_id: str, spec: dict[str, Any], url: str
) -> None:
    answer = served.http.post("/v1/designs", json={"domain": domain_id, "spec": spec, "webhook": url})
    assert answer.status_code == 422
    assert answer.json()["code"] in ("webhook-refused", "invalid-request")


def test_other_addresses_than_loopback_are_served_once_there_is_a_key(
    served: Served, keys: Callable[..., str], tmp_path: Path
) -> None:
    keys(tmp_path / "data", "create", "gina")
    service = type(served)(tmp_path / "data", "--queues", "cpu", "--host", "0.0.0.0")
    try:
        problem(service.http.get("/v1/designs"), 401, "key-required")
    finally:
        service.stop()
