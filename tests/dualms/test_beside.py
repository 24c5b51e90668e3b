"""A second process does what it is given, ends when it should, and says so when it is killed."""

from __future__ import annotations

import os
import signal
import time
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import active_children

import pytest

from dualms import beside
from dualms.beside import second_process
from dualms.errors import WallTooThick

LARGE = 10**9


@pytest.fixture(autouse=True)
def two_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(beside, "get_num_threads", lambda: 2)


def refuse() -> None:
    raise WallTooThick("too thick", advice="thinner", measured={"wall": 2.0})


def test_what_is_submitted_runs_in_another_process() -> None:
    with second_process(LARGE) as other:
        assert other.submit(os.getpid).result() != os.getpid()
    assert not active_children()


def test_it_does_not_pay_on_a_small_grid_nor_on_one_core(monkeypatch: pytest.MonkeyPatch) -> None:
    with second_process(1000) as other:
        assert other.submit(os.getpid).result() == os.getpid()
    monkeypatch.setattr(beside, "get_num_threads", lambda: 1)
    with second_process(LARGE) as other:
        assert other.submit(os.getpid).result() == os.getpid()


def test_an_error_comes_over_whole() -> None:
    with second_process(LARGE) as other, pytest.raises(WallTooThick) as refused:
        other.submit(refuse).result()
    assert (refused.value.message, refused.value.advice, refused.value.measured) == (
        "too thick",
        "thinner",
        {"wall": 2.0},
    )


def test_an_exception_ends_it_at_once() -> None:
    began = time.monotonic()
    with pytest.raises(WallTooThick), second_process(LARGE) as other:
        other.submit(time.sleep, 60).add_done_callback(refuse())
    assert time.monotonic() - began < 30
    assert not active_children()


def test_a_killed_one_is_told_from_an_error() -> None:
    with pytest.raises(BrokenProcessPool), second_process(LARGE) as other:
        other.submit(os.kill, other.submit(os.getpid).result(), signal.SIGKILL).result()
