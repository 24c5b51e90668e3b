"""The processes of one machine under one roof: started, watched, started again, stopped in order.

The parent is the lock's holder and nothing else; whatever it starts dies with it (``PR_SET_PDEATHSIG`` on Linux).
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import psutil

STEADY_S = 5.0  # a process that lived so long has started; its next restart is immediate
MAX_BACKOFF_S = 10.0

# Run before exec in the child: die when the parent dies, even by SIGKILL.
_WITH_PARENT = (
    "import ctypes,os,signal,sys\n"
    "parent=int(sys.argv[1])\n"
    "if sys.platform=='linux': ctypes.CDLL(None).prctl(1,int(sys.argv[2]))\n"
    "os.getppid()==parent or os._exit(0)\n"
    "os.execv(sys.argv[3],sys.argv[3:])\n"
)


@dataclass
class Child:
    """One supervised process.

    Parameters
    ----------
    name
        For logs and messages.
    command
        Program (absolute path) and arguments.
    log
        File that gets its output.
    grace_s
        Time between SIGTERM and SIGKILL when it is stopped.
    pass_fds
        Descriptors that it inherits.
    stop_signal
        What asks it to end.
    """

    name: str
    command: Sequence[str]
    log: Path
    grace_s: float = 10.0
    pass_fds: tuple[int, ...] = ()
    stop_signal: signal.Signals = signal.SIGTERM
    env: Mapping[str, str] = field(default_factory=dict)
    process: subprocess.Popen[bytes] | None = None
    started: float = 0.0
    failures: int = 0

    def start(self) -> None:
        """Start it, in a session of its own so that a terminal's Ctrl-C reaches only the parent."""
        with self.log.open("ab") as out:
            self.process = subprocess.Popen(
                with_parent(self.command, self.stop_signal),
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=subprocess.STDOUT,
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
        code = self.process.returncode
        how = f"signal {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"
        self.failures += 1
        self.start()
        return f"{self.name} ended ({how}) and was started again; its output is in {self.log}"

    def stop(self) -> None:
        """End it and everything below it: politely, then for sure."""
        if self.process is None:
            return
        family = _family(self.process.pid)
        if self.running:
            self.process.send_signal(self.stop_signal)
            try:
                self.process.wait(self.grace_s)
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
        self.process = None

    def tail(self, lines: int = 5) -> str:
        """The last lines of its log."""
        try:
            return "\n".join(self.log.read_text(errors="replace").splitlines()[-lines:])
        except OSError:
            return ""


def with_parent(command: Sequence[str], number: signal.Signals = signal.SIGTERM) -> list[str]:
    """The command, wrapped so that it gets a signal when the thread that starts it ends (Linux)."""
    return [sys.executable, "-S", "-E", "-c", _WITH_PARENT, str(os.getpid()), str(int(number)), *command]


def _family(pid: int) -> list[psutil.Process]:
    try:
        return psutil.Process(pid).children(recursive=True)
    except psutil.NoSuchProcess:
        return []
