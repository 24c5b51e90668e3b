"""API keys: once there is one, nobody gets in without; owners see nothing of each other; quotas hold."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import httpx
import pytest

if TYPE_CHECKING:
    from conftest import Served


def keys(data: Path, *words: str) -> str:
    """Run `dualms keys`; gives its output."""
    command = [sys.executable, "-m", "service.cli", "keys", "--data", str(data), *words]
    env = {**os.environ, "COLUMNS": "200"}
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=True, env=env).stdout


class Team:
    """A service with keys, and clients of several owners."""

    def __init__(self, service: Served) -> None:
        self.service = service
        self.clients: list[httpx.Client] = []

    def client(self, owner: str, *options: str) -> httpx.Client:
        secret = keys(self.service.data, "create", owner, *options).strip()
        assert secret.startswith("dms_")
        headers = {"Authorization": f"Bearer {secret}"}
        self.clients.append(httpx.Client(base_url=self.service.url, headers=headers, timeout=60))
        return self.clients[-1]


@pytest.fixture(scope="module")
def team(tmp_path_factory: pytest.TempPathFactory, served: Served) -> Iterator[Team]:
    service = type(served)(tmp_path_factory.mktemp("team") / "data", "--queues", "cpu")
    assert service.http.get("/v1/designs").status_code == 200, "open as long as there is no key"
    keys(service.data, "create", "first")
    time.sleep(1.2)  # whether there are keys is looked at once a second
    made = Team(service)
    yield made
    for client in made.clients:
        client.close()
    service.stop()


def upload(client: httpx.Client, box: Path) -> httpx.Response:
    with box.open("rb") as file:
        return client.post("/v1/domains", files={"file": ("box.stl", file)}, data={"units": "mm"})


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


def test_an_owner_sees_nothing_of_another_s(team: Team, box: Path, spec: dict[str, Any]) -> None:
    ann, bob, admin = team.client("ann"), team.client("bob"), team.client("root", "--scopes", "admin")
    domain = upload(ann, box).json()
    design = ann.post("/v1/designs", json={"domain": domain["id"], "spec": spec}).json()
    study = ann.post("/v1/studies", json={"domain": domain["id"], "spec": spec, "grid": {"seed": [1, 2]}}).json()
    for method, path, code in (
        ("GET", domain["href"], "domain-not-found"),
        ("GET", domain["file"], "domain-not-found"),
        ("GET", design["href"], "design-not-found"),
        ("GET", design["events"], "design-not-found"),
        ("GET", design["href"] + "/artifacts/solid.stl", "design-not-found"),
        ("POST", design["href"] + "/cancel", "design-not-found"),
        ("DELETE", design["href"], "design-not-found"),
        ("GET", f"/v1/studies/{study['id']}", "study-not-found"),
        ("POST", f"/v1/studies/{study['id']}/cancel", "study-not-found"),
        ("DELETE", f"/v1/studies/{study['id']}", "study-not-found"),
    ):
        problem(bob.request(method, path), 404, code)
    problem(bob.post("/v1/designs", json={"domain": domain["id"], "spec": spec}), 404, "domain-not-found")
    assert bob.get("/v1/designs").json()["items"] == []
    assert bob.get("/v1/studies").json()["items"] == []
    assert design["id"] in {d["id"] for d in ann.get("/v1/designs").json()["items"]}
    assert admin.get(design["href"]).status_code == 200
    assert design["id"] not in httpx.get(team.service.url).text
    ann.delete(f"/v1/studies/{study['id']}")
    assert ann.delete(design["href"]).status_code == 204


def test_the_same_bytes_of_two_owners_are_two_domains(team: Team, box: Path) -> None:
    ann, bob = (upload(team.client(owner), box).json() for owner in ("ann", "bob"))
    assert ann["id"] != bob["id"]
    assert ann["sha256"] == bob["sha256"]


def test_the_same_idempotency_key_of_two_owners_is_two_keys(team: Team, box: Path, spec: dict[str, Any]) -> None:
    made = []
    for owner in ("ann", "bob"):
        client = team.client(owner)
        body = {"domain": upload(client, box).json()["id"], "spec": spec}
        made.append(client.post("/v1/designs", json=body, headers={"Idempotency-Key": "k"}).json()["id"])
        client.post(f"/v1/designs/{made[-1]}/cancel")
    assert made[0] != made[1]


def test_a_key_that_may_only_read_cannot_write(team: Team, box: Path) -> None:
    reader = team.client("ann", "--scopes", "read")
    assert reader.get("/v1/designs").status_code == 200
    problem(upload(reader, box), 403, "scope-missing")


def test_a_revoked_key_works_no_longer(team: Team) -> None:
    client = team.client("carl")
    assert client.get("/v1/designs").status_code == 200
    key_id = client.headers["authorization"].split("_")[1]
    keys(team.service.data, "revoke", key_id)
    deadline = time.monotonic() + 8
    while client.get("/v1/designs").status_code == 200 and time.monotonic() < deadline:
        time.sleep(0.5)
    problem(client.get("/v1/designs"), 401, "key-invalid")
    assert "revoked" in keys(team.service.data, "list")


def test_an_expired_key_does_not_work(team: Team) -> None:
    problem(team.client("dora", "--days", "0").get("/v1/designs"), 401, "key-invalid")


def test_quotas_are_answered_by_429(team: Team, box: Path, spec: dict[str, Any]) -> None:
    one = team.client("emil", "--max-live-designs", "1", "--max-uploads-a-day", "1")
    domain = upload(one, box).json()["id"]
    design = one.post("/v1/designs", json={"domain": domain, "spec": spec})
    assert design.status_code == 202
    full = one.post("/v1/designs", json={"domain": domain, "spec": spec})
    problem(full, 429, "quota-exceeded")
    assert int(full.headers["retry-after"]) > 0
    assert upload(one, box).status_code == 201, "the same bytes are no new upload"
    other = one.post("/v1/domains", files={"file": ("box.stl", box.read_bytes())}, data={"units": "in"})
    problem(other, 429, "quota-exceeded")
    one.delete(design.json()["href"])


def test_the_audit_log_says_who_did_what(team: Team, box: Path, spec: dict[str, Any]) -> None:
    client = team.client("frida")
    design = client.post("/v1/designs", json={"domain": upload(client, box).json()["id"], "spec": spec}).json()
    client.delete(design["href"])
    log = keys(team.service.data, "audit")
    for action in ("domain.upload", "design.create", "design.delete"):
        assert any("frida" in line and action in line for line in log.splitlines()), log


def test_pages_of_other_sites_cannot_write(served: Served) -> None:
    answer = served.http.post("/v1/designs", json={}, headers={"Sec-Fetch-Site": "cross-site"})
    problem(answer, 403, "cross-site")


@pytest.mark.parametrize("url", ["http://127.0.0.1:1/x", "http://169.254.169.254/latest", "ftp://example.org"])
def test_webhooks_to_addresses_that_are_not_public_are_refused(
    served: Served, domain_id: str, spec: dict[str, Any], url: str
) -> None:
    answer = served.http.post("/v1/designs", json={"domain": domain_id, "spec": spec, "webhook": url})
    assert answer.status_code == 422
    assert answer.json()["code"] in ("webhook-refused", "invalid-request")


def test_other_addresses_than_loopback_are_served_once_there_is_a_key(served: Served, tmp_path: Path) -> None:
    keys(tmp_path / "data", "create", "gina")
    service = type(served)(tmp_path / "data", "--queues", "cpu", "--host", "0.0.0.0")
    try:
        problem(service.http.get("/v1/designs"), 401, "key-required")
    finally:
        service.stop()
