"""What the records tell Prometheus at each scrape: queues, workers, GPUs, designs, failures by code, stage times."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator

from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric, SummaryMetricFamily
from sqlalchemy.exc import SQLAlchemyError

from service.backend import Backend
from worker import totals
from worker.records import Records

log = logging.getLogger("dualms.service")


class RecordsCollector:
    """Reads the records when it is asked; where they are away it says so, and nothing else."""

    def __init__(self, backend: Backend) -> None:
        self._backend = backend

    def collect(self) -> Iterator[Metric]:
        """The figures now."""
        records = self._backend.records
        try:
            found = [*_queues(records), *_gpus(records), *_designs(records), *_totals(records)]
        except SQLAlchemyError as error:
            log.error("no metrics of the records: %s", error)
            found = []
        yield GaugeMetricFamily("dualms_records_up", "Whether the records answer", float(bool(found)))
        waiters = float(self._backend.watch.waiters)
        yield GaugeMetricFamily("dualms_waiting_clients", "Long polls and event streams", waiters)
        yield from found


def _queues(records: Records) -> Iterator[Metric]:
    queues = records.queues()
    yield _gauge("dualms_queue_waiting", "Steps that wait", ["queue"], ((q.queue, q.waiting) for q in queues))
    yield _gauge("dualms_queue_running", "Steps that run", ["queue"], ((q.queue, q.running) for q in queues))
    ages = ((q.queue, q.oldest_waiting_s) for q in queues)
    yield _gauge("dualms_queue_oldest_seconds", "Age of the oldest that waits", ["queue"], ages)
    yield _gauge("dualms_workers", "Workers alive", ["queue"], ((q.queue, q.workers) for q in queues))


def _gpus(records: Records) -> Iterator[Metric]:
    labels = ["worker", "gpu", "name"]
    devices = [
        ((worker.name, str(gpu["index"]), gpu["name"]), gpu)
        for worker in records.workers()
        if worker.alive
        for gpu in worker.facts.get("gpus", [])
    ]
    for kind, text in (("used", "Memory taken on the device"), ("total", "Memory of the device")):
        rows = ((*label, gpu[f"{kind}_bytes"]) for label, gpu in devices)
        yield _gauge(f"dualms_gpu_memory_{kind}_bytes", text, labels, rows)


def _designs(records: Records) -> Iterator[Metric]:
    yield _gauge("dualms_designs", "Designs kept, by status", ["status"], records.counts().items())


def _totals(records: Records) -> Iterator[Metric]:
    ended = CounterMetricFamily("dualms_designs_ended", "Designs that have ended", labels=["status"])
    failures = CounterMetricFamily("dualms_failures", "Designs that have failed, by code", labels=["code"])
    reused = CounterMetricFamily("dualms_steps_reused", "Steps whose result was known", labels=["step"])
    stages = SummaryMetricFamily("dualms_stage_seconds", "Seconds that stages took", labels=["stage"])
    counters = {"ended": ended, "failure": failures, "reused": reused}
    for total in totals.read(records.database):
        if total.kind == "stage":
            stages.add_metric([total.name], count_value=total.count, sum_value=total.seconds)
        else:
            counters[total.kind].add_metric([total.name], total.count)
    yield from (ended, failures, reused, stages)


def _gauge(name: str, text: str, labels: list[str], rows: Iterable[tuple[object, ...]]) -> Metric:
    """A gauge from rows of label values, each with the value at its end."""
    family = GaugeMetricFamily(name, text, labels=labels)
    for *values, value in rows:
        family.add_metric([str(v) for v in values], float(str(value)))
    return family
