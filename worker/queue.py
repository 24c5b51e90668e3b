"""The Celery app: a message only says that something waits; the SQL record says what.

Why each setting is as it is stands beside it. Job state is never read from Celery. Celery is imported where it is
needed first: the API answers half a second sooner without it.
"""

from __future__ import annotations

import logging
from functools import cached_property
from typing import TYPE_CHECKING

from redis import Redis
from redis.backoff import NoBackoff
from redis.exceptions import RedisError
from redis.retry import Retry

from worker.routing import QUEUES, queue_of
from worker.settings import Settings
from worker.views import DesignRecord

if TYPE_CHECKING:
    from celery import Celery

TASK = "dualms.step"
log = logging.getLogger(__name__)

__all__ = ["QUEUES", "TASK", "Wakeups", "broker_url", "celery_app", "queue_of"]


def broker_url(url: str) -> str:
    """The broker's address in Celery's spelling: ``unix:///x.sock`` becomes ``redis+socket:///x.sock``."""
    return "redis+socket://" + url.removeprefix("unix://") if url.startswith("unix://") else url


def celery_app(settings: Settings) -> Celery:
    """A Celery app that knows the queues; :mod:`worker.tasks` adds the task on the workers' side."""
    from celery import Celery
    from kombu import Queue

    app = Celery("dualms", broker=broker_url(settings.redis_url), set_as_current=False)
    app.conf.update(
        task_queues=[Queue(name) for name in QUEUES],
        task_default_queue="cpu",
        task_create_missing_queues=False,
        # JSON only: a message must not be able to run code.
        task_serializer="json",
        accept_content=["json"],
        result_backend=None,
        task_ignore_result=True,
        # One message a process at a time, acknowledged at the end: what a killed worker had goes back to the queue.
        worker_prefetch_multiplier=1,
        task_acks_late=True,
        task_reject_on_worker_lost=True,
        # Above the longest step, else Redis hands a running step's message out again. The reaper does not wait for it.
        broker_transport_options={
            "visibility_timeout": int(settings.step_seconds + 3600),
            "socket_connect_timeout": 5,
            # A network that drops everything closes no connection: without these a send would wait for ever.
            "socket_timeout": 15,
            "health_check_interval": 10,
            "socket_keepalive": True,
            "retry_on_timeout": True,
        },
        broker_connection_retry_on_startup=True,
        broker_connection_max_retries=None,
        worker_cancel_long_running_tasks_on_connection_loss=False,
        # Matters for process pools only: a child that imports torch needs longer than the default 4 s.
        worker_proc_alive_timeout=120,
        worker_soft_shutdown_timeout=settings.drain_s,
        worker_hijack_root_logger=False,
        worker_send_task_events=False,
        worker_enable_remote_control=False,
        broker_heartbeat=0,
        enable_utc=True,
    )
    return app


class Wakeups:
    """Sends messages; a broker that is away costs a moment, never a job.

    Parameters
    ----------
    settings
        For the broker's address; with none, nothing is sent and the reaper's looking must do.
    """

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._client: Redis | None = None
        if settings.redis_url:
            url = settings.redis_url.replace("redis+socket://", "unix://", 1)
            # Celery would try a broker that is away for seconds; a client of its own asks first, and once.
            self._client = Redis.from_url(url, socket_connect_timeout=2, socket_timeout=5, retry=Retry(NoBackoff(), 1))

    def send(self, design: DesignRecord) -> bool:
        """Say that the design's next step waits in its queue."""
        return self.send_to(design.queue, design.id, design.step)

    def send_to(self, queue: str, job_id: str, step: str) -> bool:
        """Say that a step waits. Returns whether the broker took the message; the reaper repeats it if not."""
        if not self.ping():
            return False
        from kombu.exceptions import OperationalError

        try:
            self._app.send_task(TASK, kwargs={"job_id": job_id, "step": step}, queue=queue, retry=False)
        except (OperationalError, RedisError, OSError) as error:
            log.warning("broker away, the reaper will send again: %s", error, extra={"job_id": job_id})
            return False
        return True

    def length(self, queue: str) -> int | None:
        """Messages that wait in a queue; None where the broker is away."""
        if self._client is None:
            return None
        try:
            return int(self._client.llen(queue))
        except (RedisError, OSError) as error:
            log.warning("broker away: %s", error)
            return None

    def ping(self) -> bool:
        """Whether the broker answers."""
        return self.length("cpu") is not None

    @cached_property
    def _app(self) -> Celery:
        return celery_app(self._settings)
