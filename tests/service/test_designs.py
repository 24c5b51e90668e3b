"""Domain to artifacts over HTTP, against the real service: broker, store, worker and stage processes."""

from __future__ import annotations

import hashlib
import io
import json
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import trimesh

from dualms.steps import ARTIFACTS, OPTIONAL_ARTIFACTS, Step
from tests.service.designs import artifact, small

if TYPE_CHECKING:
    from conftest import Served


def closed(mesh: trimesh.Trimesh) -> bool:
    """Whether no edge is a rim: an STL merges vertices, so sheets that touch along an edge share it four times."""
    _, sides = np.unique(np.sort(mesh.edges, axis=1), axis=0, return_counts=True)
    return bool((sides % 2 == 0).all())


def test_a_design_has_every_promised_artifact_and_only_those(made: dict[str, Any]) -> None:
    steps: tuple[Step, ...] = ("prepare", "solve", "build")
    promised = {name for step in steps for name in ARTIFACTS[step]}
    possible = {name for step in steps for name in OPTIONAL_ARTIFACTS[step]}
    assert promised <= {a["name"] for a in made["artifacts"]} <= promised | possible
    assert made["progress"] == 1
    assert made["error"] is None


def test_every_artifact_s_bytes_have_the_size_and_hash_that_the_record_says(
    served: Served, made: dict[str, Any]
) -> None:
    for entry in made["artifacts"]:
        answer = served.http.get(entry["href"])
        assert answer.status_code == 200, entry["name"]
        assert len(answer.content) == entry["size"], entry["name"]
        assert hashlib.sha256(answer.content).hexdigest() == entry["sha256"], entry["name"]
        assert answer.headers["etag"] == f'"{entry["sha256"]}"'
        assert answer.headers["content-type"] == entry["media_type"]
        assert answer.headers["x-content-type-options"] == "nosniff"


def test_meshes_are_closed_and_the_volumes_add_up(served: Served, made: dict[str, Any]) -> None:
    volumes = {}
    for name in ("solid.stl", "fluid_hot.stl", "fluid_cold.stl"):
        mesh = trimesh.load(io.BytesIO(served.http.get(artifact(made, name)["href"]).content), file_type="stl")
        assert closed(mesh), name
        volumes[name] = mesh.volume
    assert sum(volumes.values()) == pytest.approx(24000, rel=0.005)


def test_record_keeps_the_resolved_specification(served: Served, domain_id: str) -> None:
    spec = small(field={"method": "auto"})
    made = served.http.post("/v1/designs", json={"domain": domain_id, "spec": spec}).json()
    served.http.delete(made["href"])
    assert made["spec"]["units"] == "mm"
    assert made["spec"]["field"]["method"] == "phase-field"


def test_one_form_can_carry_domain_and_specification(served: Served, box: Path, domain_id: str) -> None:
    form = {"spec": json.dumps(small(units="mm")), "name": "from a form", "labels": "x,y"}
    with box.open("rb") as file:
        answer = served.http.post("/v1/designs", files={"domain": ("box.stl", file)}, data=form)
    assert answer.status_code == 202, answer.text
    design = answer.json()
    assert answer.headers["location"] == design["href"]
    assert int(answer.headers["retry-after"]) >= 1
    assert (design["domain"]["id"], design["name"], design["labels"]) == (domain_id, "from a form", ["x", "y"])
    assert served.ended(design["id"])["status"] == "succeeded"


def test_same_request_gives_the_same_bytes(served: Served, made: dict[str, Any], domain_id: str) -> None:
    again = served.http.post("/v1/designs", json={"domain": domain_id, "spec": small()}).json()
    ended = served.ended(again["id"])
    assert {a["name"]: a["sha256"] for a in ended["artifacts"]} == {a["name"]: a["sha256"] for a in made["artifacts"]}


def test_same_idempotency_key_and_body_give_the_same_design(served: Served, domain_id: str) -> None:
    body = {"domain": domain_id, "spec": small(seed=13)}
    first, second = (
        served.http.post("/v1/designs", json=body, headers={"Idempotency-Key": "once"}).json() for _ in range(2)
    )
    assert first["id"] == second["id"]
    other = served.http.post("/v1/designs", json={**body, "spec": small(seed=14)}, headers={"Idempotency-Key": "once"})
    assert (other.status_code, other.json()["code"]) == (422, "idempotency-key-reused")
    served.http.post(f"/v1/designs/{first['id']}/cancel")


def test_a_cancelled_design_is_final_and_its_process_ends(served: Served, domain_id: str) -> None:
    long = small(field={"method": "neural", "steps": 100_000, "points": 1024})
    design = served.http.post("/v1/designs", json={"domain": domain_id, "spec": long}).json()
    running = _until(served, design["href"], lambda d: d["stage"] == "field" and d["status"] == "running")
    assert running["progress"] < 1
    answer = served.http.post(f"{design['href']}/cancel")
    assert (answer.status_code, answer.json()["status"]) == (200, "cancelled")
    deadline = time.monotonic() + 20
    while any(q["running"] for q in served.http.get("/readyz").json()["queues"]) and time.monotonic() < deadline:
        time.sleep(0.2)
    assert served.http.get(design["href"]).json()["status"] == "cancelled"
    after = served.http.post("/v1/designs", json={"domain": domain_id, "spec": small()}).json()
    assert served.ended(after["id"], 30)["status"] == "succeeded"


def test_cancelling_an_ended_design_changes_nothing(served: Served, made: dict[str, Any]) -> None:
    assert served.http.post(f"{made['href']}/cancel").json() == served.http.get(made["href"]).json()


def test_a_deleted_design_is_gone_with_its_artifacts(served: Served, domain_id: str) -> None:
    design = served.http.post("/v1/designs", json={"domain": domain_id, "spec": small()}).json()
    ended = served.ended(design["id"])
    assert served.http.delete(design["href"]).status_code == 204
    for href in (design["href"], design["events"], ended["artifacts"][0]["href"]):
        answer = served.http.get(href)
        assert (answer.status_code, answer.json()["code"]) == (404, "design-not-found")
    assert served.http.delete(design["href"]).status_code == 404


def _until(served: Served, href: str, wanted: Any, patience_s: float = 60) -> dict[str, Any]:
    deadline = time.monotonic() + patience_s
    while time.monotonic() < deadline:
        record: dict[str, Any] = served.http.get(href).json()
        if wanted(record):
            return record
        assert record["status"] in ("queued", "running"), record["error"]
        time.sleep(0.05)
    raise AssertionError(f"{record}\n{served.logs()}")


def test_pages_list_every_design_once_newest_first(served: Served, made: dict[str, Any]) -> None:
    seen: list[str] = []
    href: str | None = "/v1/designs?limit=2"
    while href:
        page = served.http.get(href).json()
        assert len(page["items"]) <= 2
        seen += [d["id"] for d in page["items"]]
        href = page["next"]
    assert len(seen) == len(set(seen))
    assert seen == sorted(seen, reverse=True)
    assert made["id"] in seen


def test_lists_are_filtered_by_status_label_and_time(served: Served, made: dict[str, Any]) -> None:
    def ids(**query: str) -> set[str]:
        return {d["id"] for d in served.http.get("/v1/designs", params={"limit": "200", **query}).json()["items"]}

    assert made["id"] in ids(status="succeeded")
    assert made["id"] not in ids(status="failed")
    assert made["id"] in ids(label="a")
    assert made["id"] not in ids(label="b")
    assert made["id"] in ids(created_after=made["created_at"])
    assert made["id"] not in ids(created_before="2020-01-01T00:00:00Z")
