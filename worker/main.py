"""``dualms worker``: one process a queue, each with a Celery consumer, a heartbeat and a reaper; this one watches them.

Celery's pool is ``threads``: the work is in child processes, so a thread only waits for one; and unlike ``solo`` the
consumer stays alive meanwhile, to acknowledge, to reconnect to the broker and to hear that it is to end.
"""

from __future__ import annotations

import contextlib
import logging
import os
import signal
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence

from worker.logs import log_to_stderr
from worker.routing import QUEUES
from worker.settings import Settings

POLL_S = 0.3
MAX_BACKOFF_S = 10.0
log = logging.getLogger(__name__)


class CannotWork(Exception):
    """The worker cannot start; the message says why."""


def run(queues: Sequence[str], settings: Settings | None = None, concurrency: Mapping[str, int] | None = None) -> int:
    """Serve queues until SIGTERM or SIGINT, then finish or hand back what runs, and return.

    Parameters
    ----------
    queues
        Any of ``cpu gpu cfd``.
    settings
        By default from the environment; the processes of the queues read the environment, so other values than its
        must be written there by the caller.
    concurrency
        Steps at once for each queue; by default 1, since a step uses all cores itself.

    Raises
    ------
    CannotWork
        If a queue is unknown or no broker is given.
    """
    settings = settings or Settings()
    unknown = [queue for queue in queues if queue not in QUEUES]
    if unknown or not queues:
        raise CannotWork(f"Unknown queues {unknown}; there are {', '.join(QUEUES)}.")
    if not settings.redis_url:
        raise CannotWork("No broker: set DUALMS_REDIS_URL, or use `dualms serve`, which brings one.")
    log_to_stderr()
    watched = [_Queue(queue, (concurrency or {}).get(queue, 1)) for queue in dict.fromkeys(queues)]
    stop = _Stop()
    for queue in watched:
        queue.start()
    while not stop.asked:
        for queue in watched:
            queue.start_again_if_dead()
        time.sleep(POLL_S)
    log.info("stopping: running steps get %g s", settings.drain_s)
    for queue in watched:
        queue.ask_to_stop()
    deadline = time.monotonic() + settings.drain_s + settings.grace_s + 5
    for queue in watched:
        queue.end(deadline)
    return 0


class _Queue:
    """The process of one queue."""

    def __init__(self, queue: str, concurrency: int) -> None:
        self._command = [sys.executable, "-m", "worker.station", queue, str(concurrency), str(os.getpid())]
        self._queue = queue
        self._process: subprocess.Popen[bytes] | None = None
        self._started = 0.0
        self._failures = 0

    def start(self) -> None:
        self._process = subprocess.Popen(self._command, stdin=subprocess.DEVNULL, start_new_session=True)
        self._started = time.monotonic()

    def start_again_if_dead(self) -> None:
        if self._process is None or self._process.poll() is None:
            return
        lived = time.monotonic() - self._started
        self._failures = 0 if lived > 10 else self._failures
        if lived < min(0.5 * (2**self._failures - 1), MAX_BACKOFF_S):
            return
        log.error(
            "the process of queue %s ended with code %s; starting it again", self._queue, self._process.returncode
        )
        self._failures += 1
        self.start()

    def ask_to_stop(self) -> None:
        if self._process is not None:
            with contextlib.suppress(ProcessLookupError):
                self._process.send_signal(signal.SIGTERM)

    def end(self, deadline: float) -> None:
        if self._process is None:
            return
        try:
            self._process.wait(max(deadline - time.monotonic(), 0.1))
        except subprocess.TimeoutExpired:
            log.error("the process of queue %s did not stop in time", self._queue)
            self._process.kill()
            self._process.wait()


class _Stop:
    """SIGTERM and SIGINT as a flag."""

    def __init__(self) -> None:
        self.asked = False
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, self._ask)

    def _ask(self, number: int, frame: object) -> None:
        self.asked = True


if __name__ == "__main__":
    sys.exit(run(sys.argv[1].split(",")))
