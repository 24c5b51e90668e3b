"""The processes of one machine under one roof: started, watched, started again, stopped in order.

The parent does nothing else; whatever it starts dies with it (``PR_SET_PDEATHSIG`` on Linux).
"""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field
from multiprocessing import get_context
from pathlib import Path
from typing import IO, Protocol, cast

import psutil

STEADY_S = 5.0  # a process that lived so long has started; its next restart is immediate
MAX_BACKOFF_S = 10.0
_PDEATHSIG, _NAME = 1, 15  # of prctl

# Run before exec in the child: die when the parent dies, even by SIGKILL.
_WITH_PARENT = (
    "import ctypes,os,signal,sys\n"
    "parent=int(sys.argv[1])\n"
    "if sys.platform=='linux': ctypes.CDLL(None).prctl(1,int(sys.argv[2]))\n"
    "os.getppid()==parent or os._exit(0)\n"
    "os.execv(sys.argv[3],sys.argv[3:])\n"
)


class Process(Protocol):
    """As much of ``subprocess.Popen`` as it takes to watch a process."""

    pid: int

    @property
    def returncode(self) -> int | None:
        """How it ended; negative by a signal."""

    def poll(self) -> int | None:
        """How it ended, None while it lives."""

    def wait(self, timeout: float | None = None) -> int:
        """How it ended; raises ``subprocess.TimeoutExpired`` if it has not in time."""

    def send_signal(self, sig: int) -> None:
        """Send it a signal, unless it has ended."""

    def kill(self) -> None:
        """End it at once."""


@dataclass
class Child:
    """One supervised process.

    Parameters
    ----------
    name
        For logs and messages.
    command
        Program (absolute path) and arguments; or a function, which a fork of this process runs with all that has been
        loaded here. It must close what it does not want to share.
    log
        File that gets its output; None: it shares the parent's.
    grace_s
        Time between being asked to end and SIGKILL.
    pass_fds
        Descriptors that it inherits.
    stop_signal
        What asks it to end.
    """

    name: str
    command: Sequence[str] | Callable[[], None]
    log: Path | None = None
    grace_s: float = 10.0
    pass_fds: tuple[int, ...] = ()
    stop_signal: signal.Signals = signal.SIGTERM
    env: Mapping[str, str] = field(default_factory=dict)
    process: Process | None = None
    started: float = 0.0
    failures: int = 0
    _end_by: float | None = None

    def start(self) -> None:
        """Start it, in a session of its own so that a terminal's Ctrl-C reaches only the parent."""
        with nullcontext() if self.log is None else self.log.open("ab") as out:
            if callable(self.command):
                self.process = Fork(self.name, self.command, self.stop_signal, out, self.env)
            else:
                self.process = subprocess.Popen(
                    with_parent(self.command, self.stop_signal),
                    stdin=subprocess.DEVNULL,
                    stdout=out,
                    stderr=out if out is None else subprocess.STDOUT,
                    env={**os.environ, **self.env},
                    pass_fds=self.pass_fds,
                    start_new_session=True,
                )
        self.started = time.monotonic()

    @property
    def running(self) -> bool:
        """Whether it lives."""
        return self.process is not None and self.process.poll() is None

    def restart_if_dead(self) -> str | None:
        """Start it again where it ended; waits longer after each early death. Returns what happened, if anything."""
        if self.process is None or self.running:
            return None
        lived = time.monotonic() - self.started
        if lived > STEADY_S:
            self.failures = 0
        if self.failures and lived < min(0.5 * 2**self.failures, MAX_BACKOFF_S):
            return None
        code = self.process.wait()  # it has ended
        how = f"signal {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"
        self.failures += 1
        self.start()
        where = "" if self.log is None else f"; its output is in {self.log}"
        return f"{self.name} ended ({how}) and was started again{where}"

    def ask_to_stop(self) -> None:
        """Ask it to end, once; :meth:`stop` waits for it."""
        if self.process is not None and self._end_by is None:
            self._end_by = time.monotonic() + self.grace_s
            self.process.send_signal(self.stop_signal)

    def stop(self) -> None:
        """End it and everything below it: politely, then for sure."""
        if self.process is None:
            return
        family = _family(self.process.pid)
        if self.running:
            self.ask_to_stop()
            try:
                self.process.wait(max((self._end_by or 0.0) - time.monotonic(), 0.1))
            except subprocess.TimeoutExpired:
                family += [p for p in _family(self.process.pid) if p not in family]
                self.process.kill()
                self.process.wait()
        for process in family:
            try:
                process.kill()
            except psutil.NoSuchProcess:
                continue
        psutil.wait_procs(family, timeout=5)
        self.process = self._end_by = None

    def tail(self, lines: int = 5) -> str:
        """The last lines of its log."""
        try:
            return "" if self.log is None else "\n".join(self.log.read_text(errors="replace").splitlines()[-lines:])
        except OSError:
            return ""


class Fork:
    """A fork of this process that runs a function; it is called ``dualms-NAME`` (Linux)."""

    def __init__(
        self, name: str, run: Callable[[], None], number: signal.Signals, out: IO[bytes] | None, env: Mapping[str, str]
    ) -> None:
        self._process = get_context("fork").Process(target=_forked, args=(name, run, os.getpid(), number, out, env))
        self._process.start()
        self.pid = cast("int", self._process.pid)

    @property
    def returncode(self) -> int | None:
        """How it ended; negative by a signal."""
        return self._process.exitcode

    def poll(self) -> int | None:
        """How it ended, None while it lives."""
        return self._process.exitcode

    def wait(self, timeout: float | None = None) -> int:
        """How it ended; raises ``subprocess.TimeoutExpired`` if it has not in time."""
        self._process.join(timeout)
        if self._process.exitcode is None:
            raise subprocess.TimeoutExpired(self._process.name, timeout or 0.0)
        return self._process.exitcode

    def send_signal(self, sig: int) -> None:
        """Send it a signal, unless it has ended."""
        if self._process.exitcode is None:
            os.kill(self.pid, sig)

    def kill(self) -> None:
        """End it at once."""
        self._process.kill()


def _forked(
    name: str,
    run: Callable[[], None],
    parent: int,
    number: signal.Signals,
    out: IO[bytes] | None,
    env: Mapping[str, str],
) -> None:
    os.setsid()
    for asked in (signal.SIGINT, signal.SIGTERM):
        signal.signal(asked, signal.SIG_DFL)
    if sys.platform == "linux":
        prctl = ctypes.CDLL(None).prctl
        prctl(_PDEATHSIG, int(number))
        prctl(_NAME, f"dualms-{name}".encode())
    if os.getppid() != parent:
        os._exit(0)
    if out is not None:
        os.dup2(out.fileno(), 1)
        os.dup2(out.fileno(), 2)
    os.environ.update(env)
    run()


def stop_all(children: Sequence[Child]) -> None:
    """End several at the same time."""
    for child in children:
        child.ask_to_stop()
    for child in children:
        child.stop()


class StopSignals:
    """SIGINT and SIGTERM as a flag; a second one ends this process at once, and the kernel ends its children."""

    def __init__(self) -> None:
        self.asked = False
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._ask)

    def _ask(self, number: int, frame: object) -> None:
        self.asked = True
        signal.signal(number, signal.SIG_DFL)

    def wait(self, seconds: float) -> None:
        """Sleep, unless it was asked."""
        if not self.asked:
            time.sleep(seconds)


def with_parent(command: Sequence[str], number: signal.Signals = signal.SIGTERM) -> list[str]:
    """The command, wrapped so that it gets a signal when the thread that starts it ends (Linux)."""
    return [sys.executable, "-S", "-E", "-c", _WITH_PARENT, str(os.getpid()), str(int(number)), *command]


def _family(pid: int) -> list[psutil.Process]:
    try:
        return psutil.Process(pid).children(recursive=True)
    except psutil.NoSuchProcess:
        return []
