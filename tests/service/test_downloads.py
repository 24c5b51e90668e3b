"""A design's files over HTTP: whole, in ranges, unchanged."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from tests.service.designs import artifact

if TYPE_CHECKING:
    from conftest import Served


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
