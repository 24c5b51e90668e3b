"""Studies over HTTP: real designs, their table, their picture, their end."""

from __future__ import annotations

import csv
import io
import json
from typing import TYPE_CHECKING, Any

import pytest

from tests.service.designs import small

if TYPE_CHECKING:
    from conftest import Served


@pytest.fixture(scope="module")
def base() -> dict[str, Any]:
    """The small design of the other tests, so that its steps are shared with theirs."""
    return small()


@pytest.fixture(scope="module")
def ended(served: Served, domain_id: str, base: dict[str, Any], made: dict[str, Any]) -> dict[str, Any]:
    """A 2 × 2 study, one of whose walls leaves no room for the fluids."""
    grid = {"shell": [None, {"thickness": 1.0}], "wall.thickness": [1.0, 12.0]}
    body = {"domain": domain_id, "spec": base, "grid": grid, "name": "walls", "labels": ["b"]}
    answer = served.http.post("/v1/studies", json=body, headers={"Idempotency-Key": "walls"})
    assert answer.status_code == 202, answer.text
    again = served.http.post("/v1/studies", json=body, headers={"Idempotency-Key": "walls"})
    assert again.json()["id"] == answer.json()["id"]
    assert answer.headers["location"] == answer.json()["href"]
    return follow(served, answer.json()["href"])


def follow(served: Served, href: str) -> dict[str, Any]:
    for _ in range(18):
        study = served.http.get(href, headers={"Prefer": "wait=10"}).json()
        if study["status"] in ("succeeded", "failed", "cancelled"):
            return study
    raise AssertionError(f"the study has not ended\n{served.logs()}")


def test_every_combination_is_a_row_and_failed_points_say_why(ended: dict[str, Any]) -> None:
    assert ended["status"] == "succeeded", json.dumps(ended["rows"], indent=1)
    shell = {"thickness": 1.0}
    wanted = [(None, 1.0), (None, 12.0), (shell, 1.0), (shell, 12.0)]
    assert [tuple(row["values"].values()) for row in ended["rows"]] == wanted
    assert [row["status"] for row in ended["rows"]] == ["succeeded", "failed"] * 2
    assert ended["counts"] == {"queued": 0, "running": 0, "succeeded": 2, "failed": 2, "cancelled": 0}
    assert ended["progress"] == 1
    for row in ended["rows"]:
        assert (row["error"] is None) == (row["status"] == "succeeded")
        assert (row["figures"]["area_density_per_m"] is None) == (row["status"] == "failed")
        assert not (row["front"] and row["status"] == "failed")
    assert any(row["front"] for row in ended["rows"])


def test_points_are_ordinary_designs_that_share_steps(served: Served, ended: dict[str, Any]) -> None:
    designs = [served.http.get(row["href"]).json() for row in ended["rows"]]
    assert [d["spec"]["wall"]["thickness"] for d in designs] == [1.0, 12.0, 1.0, 12.0]
    assert all(d["labels"] == ["b", f"study={ended['id']}"] for d in designs)
    hashes = {a["sha256"] for d in designs for a in d["artifacts"] if a["name"] == "field.safetensors"}
    assert len(hashes) == 1
    events = served.http.get(designs[1]["events"]).text
    assert events.count("event: reused") == 2
    listed = served.http.get("/v1/designs", params={"label": f"study={ended['id']}"}).json()["items"]
    assert {d["id"] for d in listed} == {row["design"] for row in ended["rows"]}


def test_table_says_the_same_in_all_forms(served: Served, ended: dict[str, Any]) -> None:
    files = {f["name"]: served.http.get(f["href"]) for f in ended["files"]}
    assert {n: a.headers["content-type"] for n, a in files.items()} == {
        f["name"]: f["media_type"] for f in ended["files"]
    }
    lines = list(csv.DictReader(io.StringIO(files["table.csv"].text)))
    table = files["table.json"].json()
    for line, row, out in zip(lines, table["rows"], ended["rows"], strict=True):
        for metric in ended["metrics"]:
            assert (
                (json.loads(line[metric]) if line[metric] else None) == row["figures"][metric] == out["figures"][metric]
            )
        assert (line["design"], line["status"]) == (out["design"], out["status"])
    assert "walls" in files["table.html"].text
    assert files["picture.png"].content.startswith(b"\x89PNG")
    etag = {"If-None-Match": files["picture.png"].headers["etag"]}
    assert served.http.get(ended["files"][3]["href"], headers=etag).status_code == 304
    assert served.http.get(f"{ended['href']}/artifacts/table.exe").json()["code"] == "artifact-not-found"


def test_an_unchanged_study_is_not_sent_again(served: Served, ended: dict[str, Any]) -> None:
    etag = served.http.get(ended["href"]).headers["etag"]
    assert served.http.get(ended["href"], headers={"If-None-Match": etag}).status_code == 304
    assert ended["id"] in [study["id"] for study in served.http.get("/v1/studies").json()["items"]]


def test_cancelling_a_study_stops_all_its_designs(served: Served, domain_id: str, base: dict[str, Any]) -> None:
    body = {"domain": domain_id, "spec": base, "grid": {"seed": list(range(100, 112))}}
    study = served.http.post("/v1/studies", json=body).json()
    stopped = served.http.post(f"{study['href']}/cancel").json()
    assert stopped["status"] == "cancelled"
    assert stopped["counts"]["cancelled"] == len(stopped["rows"]) == 12
    assert follow(served, study["href"])["counts"] == stopped["counts"]
    assert served.http.delete(study["href"]).status_code == 204
    assert served.http.get(study["href"]).json()["code"] == "study-not-found"
    assert served.http.get(study["rows"][0]["href"]).json()["code"] == "design-not-found"


@pytest.mark.parametrize(
    ("grid", "code", "field"),
    [
        ({"graph.sties": [1, 2]}, "invalid-request", "grid.graph.sties"),
        ({"graph.sites": [32, 2]}, "invalid-request", "grid.graph.sites"),
        ({"fluids.hot.inlets.7.radius": [1]}, "invalid-request", "grid.fluids.hot.inlets.7.radius"),
        ({"seed": list(range(17)), "graph.sites": list(range(32, 48))}, "study-too-large", None),
        ({"wall": [{"thickness": 1}], "wall.thickness": [1]}, "invalid-spec", None),
        ({"seed": [1, 1]}, "invalid-spec", None),
        ({"seed": []}, "invalid-spec", None),
        ({"a..b": [1]}, "invalid-spec", None),
        ({}, "invalid-spec", None),
        ({"wall.thickness": [1, 50]}, "wall-too-thick", None),
        ({"evaluation": [None, {}]}, "evaluation-unavailable", None),
    ],
)
def test_nothing_is_queued_where_a_point_is_refused(
    served: Served, domain_id: str, base: dict[str, Any], grid: dict[str, Any], code: str, field: str | None
) -> None:
    before = served.http.get("/v1/designs?limit=1").json()["items"]
    answer = served.http.post("/v1/studies", json={"domain": domain_id, "spec": base, "grid": grid})
    assert (answer.status_code, answer.json()["code"]) == (422, code), answer.text
    assert [f["field"] for f in answer.json()["errors"][:1]] == ([field] if field else [])
    assert served.http.get("/v1/designs?limit=1").json()["items"] == before


def test_a_key_belongs_to_one_request(
    served: Served, domain_id: str, base: dict[str, Any], ended: dict[str, Any]
) -> None:
    body = {"domain": domain_id, "spec": base, "grid": {"seed": [1]}}
    answer = served.http.post("/v1/studies", json=body, headers={"Idempotency-Key": "walls"})
    assert (answer.status_code, answer.json()["code"]) == (422, "idempotency-key-reused")
    unknown = served.http.post("/v1/studies", json={**body, "domain": "0" * 64})
    assert (unknown.status_code, unknown.json()["code"]) == (404, "domain-not-found")
