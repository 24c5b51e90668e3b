"""Supervised children: a program or a fork of this process, started, told apart, started again and stopped alike."""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import psutil
import pytest

from worker.processes import Child

LOADED = {"by": "the parent"}


def talk() -> None:
    # Not printed: under pytest, sys.stdout is another file.
    os.write(1, f"loaded by {LOADED['by']} and told {os.environ['WORD']}".encode())
    time.sleep(60)


def stay() -> None:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    os.write(1, f"told {os.environ['WORD']}".encode())
    time.sleep(60)


PROGRAM = [sys.executable, "-c", "import os, time; print('told', os.environ['WORD'], flush=True); time.sleep(60)"]


@pytest.fixture
def started(tmp_path: Path) -> Iterator[Callable[[object], Child]]:
    children: list[Child] = []

    def start(command: object) -> Child:
        child = Child("part", command, tmp_path / "part.log", grace_s=0.5, env={"WORD": "so"})  # type: ignore[arg-type]
        children.append(child)
        child.start()
        until(lambda: "told so" in child.tail())
        return child

    yield start
    for child in children:
        child.stop()


def until(holds: Callable[[], bool], seconds: float = 20) -> None:
    deadline = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def test_a_fork_has_what_was_loaded_and_a_name_of_its_own(started: Callable[[object], Child]) -> None:
    child = started(talk)
    assert "loaded by the parent" in child.tail()
    assert child.process is not None
    assert os.getsid(child.process.pid) == child.process.pid != os.getsid(0)
    if sys.platform == "linux":
        assert psutil.Process(child.process.pid).name() == "dualms-part"


@pytest.mark.parametrize("command", [PROGRAM, talk])
def test_what_was_killed_is_started_again(started: Callable[[object], Child], command: object) -> None:
    child = started(command)
    assert child.process is not None
    first = child.process
    assert child.restart_if_dead() is None
    os.kill(first.pid, signal.SIGKILL)
    until(lambda: not child.running)
    assert "part ended (signal SIGKILL) and was started again" in (child.restart_if_dead() or "")
    assert child.running
    assert child.process.pid != first.pid


@pytest.mark.parametrize("command", [PROGRAM, talk, stay])
def test_one_that_is_stopped_has_ended(started: Callable[[object], Child], command: object) -> None:
    child = started(command)
    assert child.process is not None
    process, began = psutil.Process(child.process.pid), time.monotonic()
    child.stop()
    assert not process.is_running() or process.status() == psutil.STATUS_ZOMBIE
    assert time.monotonic() - began < 10
