"""Starts, watches and limits the child process of one step.

One fresh process a step: the GPU and the memory are free when it ends, and whatever it does to itself, this process
goes on. It is started by ``exec`` (never forked with threads or CUDA), in a session of its own, so that it can be ended
together with all that it starts, and it dies with its parent.
"""

from __future__ import annotations

import contextlib
import json
import logging
import os
import selectors
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any, Literal, cast

import psutil

from worker.failures import Failure, memory_limit, time_limit

FOLDER_VARIABLE = "DUALMS_STEP_FOLDER"
POLL_S = 0.25
MEMORY_S = 1.0
REPORT_S = 0.5
log = logging.getLogger(__name__)

Ending = Literal["done", "failed", "missing", "stopped", "lost"]


@dataclass(frozen=True)
class Limits:
    """What a step may take: bytes of resident memory, seconds of wall time; and how it is ended (seconds)."""

    memory_bytes: int
    seconds: float
    grace_s: float
    heartbeat_s: float
    drain_s: float


@dataclass(frozen=True)
class Outcome:
    """How a child ended.

    ``done``: ``result`` holds files, timings and metrics. ``failed``: by its own fault, see ``failure``. ``missing``:
    an input is not in the store. ``stopped``: because it was asked to. ``lost``: from outside, see ``reason``.
    """

    ending: Ending
    result: dict[str, Any] = field(default_factory=dict)
    failure: Failure | None = None
    reason: str = ""


@dataclass
class Watch:
    """What the watched step's owner wants to know and to say.

    Parameters
    ----------
    beat
        Called every ``heartbeat_s``, and with a report (stage, fraction, note) where there is news; False ends the
        step.
    checkpoint
        Called with hash and size of each checkpoint that the step has stored; False ends the step.
    drain
        Set when the worker is to end: the step may go on for ``drain_s``.
    """

    beat: Callable[[tuple[str, float, str] | None], bool]
    checkpoint: Callable[[str, int], bool]
    drain: threading.Event


def run_child(job: dict[str, Any], folder: Path, limits: Limits, watch: Watch) -> Outcome:
    """Carry out a step in a child process.

    Parameters
    ----------
    job
        What :mod:`worker.step` reads.
    folder
        Empty; the child's working directory. The caller removes it.
    limits
        What it may take.
    watch
        Called from this thread.
    """
    with (folder.parent / f"{folder.name}.log").open("w+b") as errors:
        child = _Child(job, folder, errors)
        try:
            outcome = _follow(child, limits, watch)
        finally:
            child.kill()
            Path(errors.name).unlink(missing_ok=True)
        errors.seek(max(errors.tell() - 20_000, 0))
        printed = errors.read().decode(errors="replace").strip()
    if printed and outcome.ending != "done":
        log.warning("what the step printed:\n%s", printed)
    return outcome


class _Child:
    """The process, its pipes and its lines."""

    def __init__(self, job: dict[str, Any], folder: Path, errors: IO[bytes]) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-m", "worker.step"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=errors,
            cwd=folder,
            env={**os.environ, FOLDER_VARIABLE: str(folder), "TMPDIR": str(folder)},
            start_new_session=True,
        )
        self._input = cast("IO[bytes]", self.process.stdin)
        self._output = cast("IO[bytes]", self.process.stdout)
        os.set_blocking(self._output.fileno(), False)
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._output, selectors.EVENT_READ)
        self._buffer = b""
        self.closed = False
        self._say(json.dumps(job | {"parent": os.getpid()}))

    def lines(self, seconds: float) -> list[dict[str, Any]]:
        """Messages that have come within so many seconds."""
        if self.closed or not self._selector.select(seconds):
            return []
        chunk = self._output.read(1 << 20)
        if chunk == b"":
            self.closed = True
            return []
        *lines, self._buffer = (self._buffer + (chunk or b"")).split(b"\n")
        return [json.loads(line) for line in lines]

    def ask_to_stop(self) -> None:
        self._say("cancel")

    def memory_bytes(self) -> int:
        """Resident memory of the process and all that it has started."""
        total = 0
        try:
            top = psutil.Process(self.process.pid)
            family = [top, *top.children(recursive=True)]
        except psutil.NoSuchProcess:
            return 0
        for process in family:
            try:
                total += process.memory_info().rss
            except psutil.NoSuchProcess:
                continue
        return total

    def kill(self) -> None:
        """End it and its whole session, and wait for it."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()
        self._selector.close()
        self._output.close()
        with contextlib.suppress(BrokenPipeError):
            self._input.close()

    def _say(self, line: str) -> None:
        try:
            self._input.write(line.encode() + b"\n")
            self._input.flush()
        except (BrokenPipeError, ValueError):
            pass  # it has ended; the caller will see


def _follow(child: _Child, limits: Limits, watch: Watch) -> Outcome:
    began = beaten = measured = time.monotonic()
    reported = 0.0
    news: tuple[str, float, str] | None = None
    stop_at: float | None = None  # when it is killed, once it was asked to stop
    drain_until: float | None = None
    while True:
        for message in child.lines(POLL_S):
            if "outcome" in message:
                return _outcome(message["outcome"])
            if "checkpoint" in message:
                point = message["checkpoint"]
                if not watch.checkpoint(point["sha256"], point["size"]) and stop_at is None:
                    stop_at = _ask(child, limits)
            else:
                news = (message["stage"], message["fraction"], message["note"])
        now = time.monotonic()
        if child.closed:
            return Outcome("stopped" if stop_at is not None else "lost", reason=_why(child))
        if stop_at is not None:
            if now > stop_at:
                return Outcome("stopped", reason="killed after the grace time")
        elif now - beaten > limits.heartbeat_s or (news is not None and now - reported > REPORT_S):
            reported = now if news is not None else reported
            beaten = now
            if not watch.beat(news):
                stop_at = _ask(child, limits)
            news = None
        if watch.drain.is_set() and stop_at is None:
            drain_until = drain_until or now + limits.drain_s
            if now > drain_until:
                stop_at = _ask(child, limits)
        if now - began > limits.seconds:
            return Outcome("failed", failure=time_limit(limits.seconds))
        if now - measured > MEMORY_S:
            measured = now
            if (used := child.memory_bytes()) > limits.memory_bytes:
                return Outcome("failed", failure=memory_limit(limits.memory_bytes, used))


def _ask(child: _Child, limits: Limits) -> float:
    child.ask_to_stop()
    return time.monotonic() + limits.grace_s


def _outcome(message: dict[str, Any]) -> Outcome:
    if "failure" in message:
        return Outcome("failed", failure=Failure(**message["failure"]))
    if "missing" in message:
        return Outcome("missing", reason=f"{message['missing'][:12]}… is gone from the store")
    if "away" in message:
        return Outcome("lost", reason=message["away"])
    if "cancelled" in message:
        return Outcome("stopped", reason="asked to stop")
    return Outcome("done", result=message)


def _why(child: _Child) -> str:
    try:
        code = child.process.wait(5)
    except subprocess.TimeoutExpired:
        return "its process closed its output"
    if code < 0:
        return f"its process was ended by {signal.Signals(-code).name}"
    return f"its process ended with exit code {code}"
