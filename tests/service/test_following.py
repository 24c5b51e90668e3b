"""A design on its way: long polls, conditional requests, event streams."""

from __future__ import annotations

import json
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any, NamedTuple

import pytest

from dualms.steps import STAGES
from tests.service.designs import read_stream, small

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
        json={"domain": domain_id, "spec": small(seed=5)},  # of its own: what is reused shows no stage on its way
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
