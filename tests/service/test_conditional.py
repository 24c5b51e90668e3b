"""Headers mean what the RFCs say."""

from __future__ import annotations

import pytest

from service.conditional import byte_range, matches, wait_s
from service.problems import Problem


@pytest.mark.parametrize(
    ("header", "expected"),
    [
        ("bytes=0-9", (0, 10)),
        ("bytes=90-", (90, 100)),
        ("bytes=-5", (95, 100)),
        ("bytes=-500", (0, 100)),
        ("bytes=95-500", (95, 100)),
        ("bytes=0-0", (0, 1)),
        (None, None),
        ("bytes=5-2", None),
        ("bytes=-", None),
        ("bytes=0-1,5-6", None),
        ("items=0-1", None),
        ("bytes=a-b", None),
    ],
)
def test_one_byte_range_is_read_and_anything_odd_means_the_whole_file(
    header: str | None, expected: tuple[int, int] | None
) -> None:
    found = byte_range(header, None, '"x"', 100)
    assert (found and (found.start, found.stop)) == expected


@pytest.mark.parametrize("header", ["bytes=100-", "bytes=100-200", "bytes=-0"])
def test_a_range_outside_the_file_is_refused_with_the_size(header: str) -> None:
    with pytest.raises(Problem) as refusal:
        byte_range(header, None, '"x"', 100)
    assert refusal.value.document().status == 416
    assert refusal.value.headers["Content-Range"] == "bytes */100"


def test_if_range_with_another_etag_means_the_whole_file() -> None:
    assert byte_range("bytes=0-9", '"old"', '"new"', 100) is None
    assert byte_range("bytes=0-9", '"new"', '"new"', 100) is not None


@pytest.mark.parametrize(
    ("header", "expected"),
    [('"a"', True), ('W/"a"', True), ('"b", "a"', True), ("*", True), ('"b"', False), (None, False), ("a", False)],
)
def test_if_none_match_compares_weakly(header: str | None, expected: bool) -> None:
    assert matches(header, '"a"') is expected


@pytest.mark.parametrize(
    ("header", "expected"),
    [("wait=10", 10), ("respond-async, wait=5", 5), ("WAIT = 7", 7), ("wait=99999", 60), ("wait=x", 0), (None, 0)],
)
def test_prefer_wait_is_read_and_bounded(header: str | None, expected: float) -> None:
    assert wait_s(header) == expected
