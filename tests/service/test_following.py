"""A design on its way: long polls, conditional requests, event streams."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from dualms.steps import STAGES
from tests.service.designs import read_stream, small

if TYPE_CHECKING:
    from conftest import Served, Trace


def test_every_stage_has_its_time_and_comes_in_order(traced: Trace) -> None:
    order = [stage for step in ("prepare", "solve", "build") for stage in STAGES[step]]
    assert [s["stage"] for s in traced.polled[-1]["stages"]] == order
    assert all(s["seconds"] >= 0 for s in traced.polled[-1]["stages"])
    assert traced.polled[-1]["created_at"] <= traced.polled[-1]["started_at"] <= traced.polled[-1]["finished_at"]


def test_an_unchanged_design_is_answered_by_304(served: Served, made: dict[str, Any]) -> None:
    etag = served.http.get(made["href"]).headers["etag"]
    answer = served.http.get(made["href"], headers={"If-None-Match": etag})
    assert (answer.status_code, answer.content, answer.headers["etag"]) == (304, b"", etag)
    assert served.http.get(made["href"], headers={"If-None-Match": '"0"'}).status_code == 200


def test_an_ended_design_says_nothing_of_another_look(served: Served, made: dict[str, Any]) -> None:
    assert "retry-after" not in served.http.get(made["href"]).headers


def test_long_polls_return_on_change_with_moving_progress(traced: Trace) -> None:
    progress = [record["progress"] for record in traced.polled]
    assert progress == sorted(progress)
    assert len(set(progress)) >= 4
    assert len(set(traced.etags)) == len(traced.etags)
    assert {record["stage"] for record in traced.polled} >= {"body", "report"} or len(traced.polled) > 8


def test_prefer_wait_at_submission_answers_when_the_design_has_ended(
    served: Served, domain_id: str, made: dict[str, Any]
) -> None:
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
