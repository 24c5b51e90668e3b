"""The process of one queue: registers itself, consumes messages, keeps its heartbeat, reaps, collects garbage.

It never imports torch: the steps run in child processes.
"""

from __future__ import annotations

import ctypes
import faulthandler
import logging
import os
import platform
import signal
import sys
import threading
import warnings
from collections.abc import Callable
from dataclasses import asdict
from typing import Any

from celery import signals
from celery.platforms import SecurityWarning

import dualms
from worker import tables
from worker.database import Now
from worker.garbage import collect
from worker.gpus import gpus
from worker.host import started_at, this_host
from worker.leases import Leases
from worker.logs import log_to_stderr
from worker.patience import AWAY
from worker.queue import Wakeups, celery_app
from worker.reaper import Reaper
from worker.records import Records
from worker.rows import new_id
from worker.scratch import sweep
from worker.settings import Settings
from worker.stores import open_store
from worker.tasks import Station, register, take_all
from worker.tracing import open_tracing
from worker.webhooks import Deliverer

HEARTBEAT_S = 5.0
WEBHOOK_S = 1.0
LINGER_S = 1.0  # what Celery gets to acknowledge its last message, once nothing runs
log = logging.getLogger(__name__)


def main() -> None:
    """Serve the queue that the arguments name until SIGTERM."""
    queue, concurrency, parent = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
    _die_with(parent)
    log_to_stderr()
    faulthandler.register(signal.SIGUSR1)  # kill -USR1: where each thread is, on stderr
    # Each message would be two lines; and the warning about root is about pickles, which are refused here.
    for name in ("celery.worker.strategy", "celery.app.trace"):
        logging.getLogger(name).setLevel(logging.WARNING)
    warnings.simplefilter("ignore", SecurityWarning)
    log.info("starting for queue %s", queue)
    settings = Settings()
    records = Records.open(settings)
    app = celery_app(settings)
    wakeups = Wakeups(settings)
    reaper = Reaper(records, wakeups)
    # Aside: it reads what all processes of this machine were started with, which may block where one of them hangs.
    threading.Thread(target=sweep, args=(settings.scratch,), name="sweep", daemon=True).start()
    drain = threading.Event()
    registration = Registration(records, queue, concurrency)
    reaper.run_once()  # what dead processes of this machine held waits again, at once
    store = open_store(settings)
    station = Station(
        queue,
        registration.id,
        settings,
        Leases(records),
        store,
        wakeups,
        drain,
        free=threading.Semaphore(concurrency),
        tracing=open_tracing(settings.tracing, "dualms-worker"),
    )
    register(app, station)

    ended, left = threading.Event(), threading.Event()

    def leave() -> None:
        """Wait until what runs has ended or was handed back, and leave; Celery may wait for a broker for ever."""
        try:
            registration.drain()
            for _ in range(concurrency):
                station.free.acquire(timeout=settings.drain_s + settings.grace_s + 5)
            ended.set()  # no heartbeat any more
            registration.end()
        except AWAY:
            log.exception("the records are away; what this worker held is taken over when its lease runs out")
        if not left.wait(LINGER_S):
            log.warning("leaving without a word to the broker")
            os._exit(0)

    # A thread, since this is called in a signal's handler.
    leaving = threading.Thread(target=leave, name="leaving", daemon=True)

    def on_stop(**_: object) -> None:
        if not drain.is_set():
            drain.set()
            leaving.start()

    signals.worker_shutting_down.connect(on_stop, weak=False)
    signals.setup_logging.connect(lambda **_: None, weak=False)
    every(HEARTBEAT_S, registration.beat, ended, "heartbeat")
    every(settings.reap_s, reaper.run_once, ended, "reaper")
    # Unasked, too: messages get lost, and a consumer may lose its place when the broker goes away and comes back.
    every(settings.reap_s, lambda: take_all(station), ended, "eyes", at_once=True)
    every(WEBHOOK_S, Deliverer(records.database, settings).run_once, ended, "webhooks")
    every(settings.collect_s, lambda: collect(records, store), ended, "collector")
    log.info("serving queue %s as worker %s", queue, registration.id)
    worker = app.Worker(
        queues=[queue],
        concurrency=concurrency,
        pool="threads",
        without_gossip=True,
        without_mingle=True,
        without_heartbeat=True,
        hostname=f"{queue}-{registration.id[-8:]}@{platform.node()}",
        quiet=True,
    )
    try:
        worker.start()
    finally:  # it raises where it is stopped while it looks for the broker
        left.set()
        on_stop()
        leaving.join()
    sys.exit(0)


class Registration:
    """This process in the table of workers, so that the service knows which queues are served."""

    def __init__(self, records: Records, queue: str, concurrency: int) -> None:
        self.id = new_id()
        self._database = records.database
        pid = os.getpid()
        self._row: dict[str, Any] = {
            "id": self.id,
            "host": this_host(),
            "name": platform.node(),
            "pid": pid,
            "pid_started": started_at(pid),
            "queue": queue,
            "concurrency": concurrency,
            "draining": False,
            "facts": {"version": dualms.__version__, "cores": os.cpu_count(), "python": platform.python_version()},
        }
        self.beat()

    def beat(self) -> None:
        """Say that this worker lives; register it (again) where it is unknown."""
        if self._row["queue"] == "gpu":
            self._row["facts"] = self._row["facts"] | {"gpus": [asdict(gpu) for gpu in gpus()]}
        with self._database.write() as session:
            row = session.get(tables.Worker, self.id)
            if row is None:
                session.add(tables.Worker(**self._row, started_at=Now(), heartbeat_at=Now()))
            else:
                row.heartbeat_at = Now()  # type: ignore[assignment]
                row.draining = bool(self._row["draining"])
                row.facts = self._row["facts"]

    def drain(self) -> None:
        """Say that this worker takes nothing new."""
        self._row["draining"] = True
        self.beat()

    def end(self) -> None:
        """Take this worker off the list."""
        with self._database.write() as session:
            row = session.get(tables.Worker, self.id)
            if row is not None:
                session.delete(row)


def every(
    seconds: float, call: Callable[[], object], ended: threading.Event, name: str, *, at_once: bool = False
) -> None:
    """Call something again and again in a thread of its own; what it raises is logged, and the next time comes."""

    def loop() -> None:
        pause = 0.0 if at_once else seconds
        while not ended.wait(pause):
            pause = seconds
            try:
                call()
            except Exception:
                log.exception("%s failed; it will be tried again", name)

    threading.Thread(target=loop, name=name, daemon=True).start()


def _die_with(parent: int) -> None:
    """End when the parent ends, even where that was before this process had come so far (Linux)."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(1, int(signal.SIGKILL))
    if os.getppid() != parent:
        os._exit(1)


if __name__ == "__main__":
    main()
