"""Domain to artifacts over HTTP, against the real service: broker, store, worker and stage processes."""

from __future__ import annotations

import hashlib
import io
import json
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import httpx
import numpy as np
import pytest
import trimesh

from dualms.steps import ARTIFACTS, OPTIONAL_ARTIFACTS, STAGES, Step
from service.client import Client

if TYPE_CHECKING:
    from conftest import Served


class Trace(NamedTuple):
    """What a client saw of a design on its way: the answers of long polls, and the events of a stream."""

    polled: list[dict[str, Any]]
    etags: list[str]
    events: list[dict[str, str]]


@pytest.fixture(scope="module")
def traced(served: Served, domain_id: str) -> Trace:
    """A design followed from submission to its end, by long polls and by its event stream at once."""
    answer = served.http.post(
        "/v1/designs",
        json={"domain": domain_id, "spec": small(), "name": "made", "labels": ["a"]},
    )
    assert answer.status_code == 202, answer.text
    design, etags = answer.json(), [answer.headers["etag"]]
    polled = [design]
    with ThreadPoolExecutor(1) as pool:
        stream = pool.submit(read_stream, served, design["events"])
        while polled[-1]["status"] in ("queued", "running"):
            look = served.http.get(design["href"], headers={"If-None-Match": etags[-1], "Prefer": "wait=20"})
            if look.status_code == 200:
                polled.append(look.json())
                etags.append(look.headers["etag"])
        return Trace(polled, etags, stream.result(30))


@pytest.fixture(scope="module")
def made(served: Served, traced: Trace) -> dict[str, Any]:
    """A design that has succeeded."""
    ended = traced.polled[-1]
    assert ended["status"] == "succeeded", f"{ended['error']}\n{served.logs()}"
    return ended


def small(**changes: Any) -> dict[str, Any]:
    """A small design in the box."""

    def disk(x: float, y: float) -> dict[str, Any]:
        return {"center": [x, y, 0], "radius": 5}

    return {
        "fluids": {
            "hot": {"inlets": [disk(-20, -7)], "outlets": [disk(20, -7)]},
            "cold": {"inlets": [disk(20, 7)], "outlets": [disk(-20, 7)]},
        },
        "graph": {"sites": 32},
        "partition": {"method": "anneal", "seconds": 0.1},
        "field": {"method": "phase-field", "resolution": 40},
        "surface": {"resolution": 48},
        "pictures": {"width": 320},
        "wall": {"thickness": 1.0},
        # A seed of this file's own: what other tests have designed would be reused, and show no stage on its way.
        "seed": 2,
        **changes,
    }


def read_stream(served: Served, href: str, last: str | None = None) -> list[dict[str, str]]:
    headers = {"Last-Event-ID": last} if last else {}
    events: list[dict[str, str]] = []
    with served.http.stream("GET", href, headers=headers) as answer:
        assert answer.status_code == 200
        assert answer.headers["content-type"].startswith("text/event-stream")
        block: dict[str, str] = {}
        for line in answer.iter_lines():
            if line and not line.startswith(":"):
                name, _, value = line.partition(": ")
                block[name] = value
            elif block:
                events.append(block)
                block = {}
    return events


def closed(mesh: trimesh.Trimesh) -> bool:
    """Whether no edge is a rim: an STL merges vertices, so sheets that touch along an edge share it four times."""
    _, sides = np.unique(np.sort(mesh.edges, axis=1), axis=0, return_counts=True)
    return bool((sides % 2 == 0).all())


def artifact(made: dict[str, Any], name: str) -> dict[str, Any]:
    return next(a for a in made["artifacts"] if a["name"] == name)


# --- the main job -------------------------------------------------------------------------------------------------


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


def test_every_stage_has_its_time_and_comes_in_order(made: dict[str, Any]) -> None:
    order = [stage for step in ("prepare", "solve", "build") for stage in STAGES[step]]
    assert [s["stage"] for s in made["stages"]] == order
    assert all(s["seconds"] >= 0 for s in made["stages"])
    assert made["created_at"] <= made["started_at"] <= made["finished_at"]


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


# --- domains ------------------------------------------------------------------------------------------------------


def test_same_bytes_give_the_same_domain_named_by_their_hash(served: Served, box: Path, domain_id: str) -> None:
    answer = served.upload(box)
    assert answer.status_code == 201
    assert answer.json()["id"] == domain_id == hashlib.sha256(box.read_bytes()).hexdigest()
    assert answer.headers["location"] == f"/v1/domains/{domain_id}"
    assert served.http.get(answer.headers["location"]).json() == answer.json()


def test_domain_record_lists_size_and_facets_in_the_file_s_units(served: Served, domain_id: str) -> None:
    domain = served.http.get(f"/v1/domains/{domain_id}").json()
    assert domain["bounds"] == [[-20, -15, -10], [20, 15, 10]]
    assert domain["volume"] == pytest.approx(24000)
    assert domain["area"] == pytest.approx(5200)
    assert [f["area"] for f in domain["facets"]] == pytest.approx([1200, 1200, 800, 800, 600, 600])
    assert domain["watertight"] is True


def test_same_bytes_in_other_units_are_another_domain(served: Served, box: Path, domain_id: str) -> None:
    other = served.upload(box, "in").json()
    assert other["id"] != domain_id
    assert other["units"] == "in"
    assert served.upload(box, "in").json() == other
    assert served.http.get(f"/v1/domains/{domain_id}").json()["units"] == "mm"


def test_bytes_that_are_here_need_not_be_sent_again(served: Served, domain_id: str) -> None:
    again = served.http.post("/v1/domains", data={"sha256": domain_id, "units": "mm"})
    assert (again.status_code, again.json()["id"]) == (201, domain_id)
    other = served.http.post("/v1/domains", data={"sha256": domain_id, "units": "cm"}).json()
    assert (other["sha256"], other["units"]) == (domain_id, "cm")
    without = served.http.post("/v1/domains", data={"sha256": domain_id})
    assert (without.status_code, without.json()["code"]) == (422, "missing-units"), "as for the file itself"


def test_the_client_sends_bytes_once(served: Served, tmp_path: Path) -> None:
    path = tmp_path / "cylinder.stl"
    trimesh.creation.cylinder(10, 30, sections=20).export(path)
    with Client(served.url) as client:
        first, second = (client.upload_domain(path, "mm") for _ in range(2))
    assert first == second
    assert first["sha256"] == hashlib.sha256(path.read_bytes()).hexdigest()


def test_domains_are_listed_newest_first_in_pages(served: Served, domain_id: str) -> None:
    served.http.post("/v1/domains", data={"sha256": domain_id, "units": "m"})
    whole = served.http.get("/v1/domains?limit=200").json()
    paged, address = [], "/v1/domains?limit=1"
    while address:
        page = served.http.get(address).json()
        paged += page["items"]
        address = page["next"]
    assert paged == whole["items"]
    assert whole["next"] is None
    assert [d["created_at"] for d in paged] == sorted((d["created_at"] for d in paged), reverse=True)


def test_domain_file_comes_back_as_it_was(served: Served, box: Path, domain_id: str) -> None:
    answer = served.http.get(f"/v1/domains/{domain_id}/file")
    assert answer.content == box.read_bytes()
    assert "box.stl" in answer.headers["content-disposition"]


# --- conditional requests -----------------------------------------------------------------------------------------


def test_an_unchanged_design_is_answered_by_304(served: Served, made: dict[str, Any]) -> None:
    etag = served.http.get(made["href"]).headers["etag"]
    answer = served.http.get(made["href"], headers={"If-None-Match": etag})
    assert (answer.status_code, answer.content, answer.headers["etag"]) == (304, b"", etag)
    assert served.http.get(made["href"], headers={"If-None-Match": '"0"'}).status_code == 200


def test_an_ended_design_says_nothing_of_another_look(served: Served, made: dict[str, Any]) -> None:
    assert "retry-after" not in served.http.get(made["href"]).headers


def test_artifacts_come_in_ranges(served: Served, made: dict[str, Any]) -> None:
    entry = artifact(made, "solid.stl")
    whole = served.http.get(entry["href"]).content
    answer = served.http.get(entry["href"], headers={"Range": "bytes=80-83"})
    assert (answer.status_code, answer.content) == (206, whole[80:84])
    assert answer.headers["content-range"] == f"bytes 80-83/{len(whole)}"
    tail = served.http.get(entry["href"], headers={"Range": "bytes=-50"})
    assert tail.content == whole[-50:]
    stale = served.http.get(entry["href"], headers={"Range": "bytes=0-3", "If-Range": '"other"'})
    assert (stale.status_code, len(stale.content)) == (200, len(whole))


def test_a_range_outside_the_artifact_is_a_416_problem(served: Served, made: dict[str, Any]) -> None:
    entry = artifact(made, "report.json")
    answer = served.http.get(entry["href"], headers={"Range": f"bytes={entry['size']}-"})
    assert answer.status_code == 416
    assert answer.json()["code"] == "range-not-satisfiable"
    assert answer.headers["content-range"] == f"bytes */{entry['size']}"


def test_head_of_an_artifact_is_get_without_the_bytes(served: Served, made: dict[str, Any]) -> None:
    entry = artifact(made, "preview.png")
    head, whole = served.http.head(entry["href"]), served.http.get(entry["href"])
    assert (head.status_code, head.content) == (200, b"")
    for name in ("etag", "content-length", "content-type", "accept-ranges"):
        assert head.headers[name] == whole.headers[name]


def test_a_known_artifact_is_answered_by_304(served: Served, made: dict[str, Any]) -> None:
    entry = artifact(made, "report.html")
    answer = served.http.get(entry["href"], headers={"If-None-Match": f'"{entry["sha256"]}"'})
    assert (answer.status_code, answer.content) == (304, b"")


# --- following ----------------------------------------------------------------------------------------------------


def test_long_polls_return_on_change_with_moving_progress(traced: Trace) -> None:
    progress = [record["progress"] for record in traced.polled]
    assert progress == sorted(progress)
    assert len(set(progress)) >= 4
    assert len(set(traced.etags)) == len(traced.etags)
    assert {record["stage"] for record in traced.polled} >= {"body", "report"} or len(traced.polled) > 8


def test_prefer_wait_at_submission_answers_when_the_design_has_ended(served: Served, domain_id: str) -> None:
    body = {"domain": domain_id, "spec": small()}
    answer = served.http.post("/v1/designs", json=body, headers={"Prefer": "wait=60"})
    assert answer.json()["status"] == "succeeded"
    assert answer.headers["preference-applied"] == "wait=60"


def test_event_stream_follows_a_design_to_its_end(traced: Trace) -> None:
    numbers = [int(e["id"]) for e in traced.events]
    assert numbers == sorted(set(numbers))
    assert traced.events[0]["event"] == "queued"
    assert traced.events[-1]["event"] == "succeeded"
    assert any(e["event"] == "progress" for e in traced.events)
    assert all("time" in json.loads(e["data"]) for e in traced.events)


def test_event_stream_resumes_after_the_last_event_seen(served: Served, made: dict[str, Any]) -> None:
    events = read_stream(served, made["events"])
    middle = len(events) // 2
    assert read_stream(served, made["events"], events[middle]["id"]) == events[middle + 1 :]


def test_a_browser_that_has_seen_the_end_is_told_not_to_come_back(served: Served, made: dict[str, Any]) -> None:
    last = read_stream(served, made["events"])[-1]["id"]
    assert served.http.get(made["events"], headers={"Last-Event-ID": last}).status_code == 204


def test_nonsense_as_last_event_id_is_refused(served: Served, made: dict[str, Any]) -> None:
    answer = served.http.get(made["events"], headers={"Last-Event-ID": "x"})
    assert (answer.status_code, answer.json()["code"]) == (400, "malformed-request")


# --- once only ----------------------------------------------------------------------------------------------------


def test_same_idempotency_key_and_body_give_the_same_design(served: Served, domain_id: str) -> None:
    body = {"domain": domain_id, "spec": small(seed=13)}
    first, second = (
        served.http.post("/v1/designs", json=body, headers={"Idempotency-Key": "once"}).json() for _ in range(2)
    )
    assert first["id"] == second["id"]
    other = served.http.post("/v1/designs", json={**body, "spec": small(seed=14)}, headers={"Idempotency-Key": "once"})
    assert (other.status_code, other.json()["code"]) == (422, "idempotency-key-reused")
    served.http.post(f"/v1/designs/{first['id']}/cancel")


# --- cancel and delete --------------------------------------------------------------------------------------------


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


# --- lists, facts, pages ------------------------------------------------------------------------------------------


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


def test_readiness_tells_of_store_broker_and_workers(served: Served) -> None:
    facts = served.http.get("/readyz").json()
    assert (facts["ready"], facts["store"], facts["broker"]) == (True, True, True)
    assert "cpu" in {w["queue"] for w in facts["workers"]}


def test_metrics_count_requests_and_designs(served: Served, made: dict[str, Any]) -> None:
    text = served.http.get("/metrics").text
    assert 'dualms_designs{status="succeeded"}' in text
    assert 'dualms_workers{queue="cpu"} 1.0' in text
    assert 'route="/v1/designs/{design_id}"' in text


def test_landing_page_shows_the_design_and_needs_no_other_host(served: Served, domain_id: str) -> None:
    body = {"domain": domain_id, "spec": small(), "name": "<script>alert(1)</script>"}
    design = served.http.post("/v1/designs", json=body).json()
    ended = served.ended(design["id"])
    page = served.http.get("/").text
    assert "&lt;script&gt;alert(1)" in page
    assert "<script>" not in page
    assert artifact(ended, "preview.png")["href"] in page
    assert "//cdn" not in page
    assert 'src="http' not in page


def test_reference_page_shows_every_call_and_needs_no_other_host(served: Served) -> None:
    page = served.http.get("/docs").text
    for path in served.http.get("/openapi.json").json()["paths"]:
        assert f"<code>{path}</code>" in page
    assert 'src="' not in page
    assert "transverse_weight" in page


def test_answers_are_the_ones_that_the_document_promises(served: Served, made: dict[str, Any]) -> None:
    assert set(made) == set(
        httpx.get(f"{served.url}/openapi.json").json()["components"]["schemas"]["DesignOut"]["properties"]
    )
