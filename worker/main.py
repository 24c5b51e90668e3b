"""``dualms worker``: one process a queue, each with a Celery consumer, a heartbeat and a reaper; this one watches them.

Celery's pool is ``threads``: the work is in child processes, so a thread only waits for one; and unlike ``solo`` the
consumer stays alive meanwhile, to acknowledge, to reconnect to the broker and to hear that it is to end.
"""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

from worker.logs import log_to_stderr
from worker.processes import Child, StopSignals, stop_all
from worker.routing import QUEUES
from worker.settings import Settings

POLL_S = 0.3
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
    watched = [queue_process(q, settings, concurrency=(concurrency or {}).get(q, 1)) for q in dict.fromkeys(queues)]
    stop = StopSignals()
    for queue in watched:
        queue.start()
    while not stop.asked:
        for queue in watched:
            if (news := queue.restart_if_dead()) is not None:
                log.error(news)
        stop.wait(POLL_S)
    log.info("stopping: running steps get %g s", settings.drain_s)
    stop_all(watched)
    return 0


def queue_process(
    queue: str,
    settings: Settings,
    *,
    concurrency: int = 1,
    log: Path | None = None,
    env: Mapping[str, str] = MappingProxyType({}),
) -> Child:
    """The process of one queue, to be started by this one; stopped, it has time to finish or hand back its steps."""
    command = [sys.executable, "-m", "worker.station", queue, str(concurrency), str(os.getpid())]
    patience_s = settings.drain_s + settings.grace_s + 5
    return Child(f"worker ({queue})", command, log, grace_s=patience_s, env=env)


if __name__ == "__main__":
    sys.exit(run(sys.argv[1].split(",")))
