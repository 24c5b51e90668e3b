"""One trace leads from a request through the queue to the steps that it asked for, in whatever process they run."""

from __future__ import annotations

import asyncio
import subprocess
import sys
import threading
from itertools import pairwise
from pathlib import Path
from typing import Any

import httpx
import pytest
from opentelemetry.sdk.trace import ReadableSpan, TracerProvider
from opentelemetry.sdk.trace.export import SimpleSpanProcessor
from opentelemetry.sdk.trace.export.in_memory_span_exporter import InMemorySpanExporter
from opentelemetry.trace import SpanKind, StatusCode

from service.app import create_app
from service.settings import Settings
from worker.leases import Leases
from worker.otel import Traces
from worker.queue import Wakeups
from worker.records import Records
from worker.settings import Settings as WorkerSettings
from worker.stores import open_store
from worker.tasks import Station, take_one

CALLER = "00-0af7651916cd43dd8448eb211c80319c-b7ad6b7169203331-01"  # the example of W3C Trace Context


@pytest.fixture
def exporter() -> InMemorySpanExporter:
    return InMemorySpanExporter()


@pytest.fixture
def traces(exporter: InMemorySpanExporter) -> Traces:
    provider = TracerProvider()
    provider.add_span_processor(SimpleSpanProcessor(exporter))
    return Traces(provider)


@pytest.fixture
def settings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> WorkerSettings:
    monkeypatch.setenv("DUALMS_DATA_DIR", str(tmp_path))  # for the step's process
    return WorkerSettings(redis_url="")


def submitted(settings: WorkerSettings, traces: Traces, box: Path, spec: dict[str, Any]) -> None:
    """A design, asked for over HTTP with the caller's trace."""
    app = create_app(Settings(), settings, traces)

    async def submit() -> None:
        transport = httpx.ASGITransport(app)
        async with (
            app.router.lifespan_context(app),
            httpx.AsyncClient(transport=transport, base_url="http://x") as http,
        ):
            files, data = {"file": ("box.stl", box.read_bytes())}, {"units": "mm"}
            domain = (await http.post("/v1/domains", files=files, data=data)).json()["id"]
            body = {"domain": domain, "spec": spec}
            answer = await http.post("/v1/designs", json=body, headers={"traceparent": CALLER})
            assert answer.status_code == 202

    asyncio.run(submit())


def take(settings: WorkerSettings, traces: Traces) -> bool:
    """One step, carried out as a worker on another machine would."""
    records = Records.open(settings)
    try:
        leases, store, wakeups = Leases(records), open_store(settings), Wakeups(settings)
        return take_one(Station("cpu", "w", settings, leases, store, wakeups, threading.Event(), tracing=traces))
    finally:
        records.close()


def test_a_trace_leads_from_the_request_through_the_queue_to_the_stages(
    exporter: InMemorySpanExporter, traces: Traces, settings: WorkerSettings, box: Path, spec: dict[str, Any]
) -> None:
    submitted(settings, traces, box, spec)
    assert take(settings, traces)
    spans = {s.name: s for s in exporter.get_finished_spans()}
    request, step, queue = (spans[n] for n in ("POST /v1/designs", "step prepare", "queue cpu"))
    stages = [s for name, s in spans.items() if name.startswith("stage ")]
    assert {s.name for s in stages} >= {"stage domain", "stage graph", "stage partition", "stage skeletons"}
    assert {f"{s.context.trace_id:032x}" for s in (request, step, queue, *stages)} == {CALLER.split("-")[1]}
    assert f"{request.parent.span_id:016x}" == CALLER.split("-")[2]
    assert step.parent.span_id == request.context.span_id
    assert all(s.parent.span_id == step.context.span_id for s in (queue, *stages))
    assert (request.kind, step.kind) == (SpanKind.SERVER, SpanKind.CONSUMER)
    assert request.attributes["http.response.status_code"] == 202
    assert spans["POST /v1/domains"].context.trace_id != request.context.trace_id
    assert _in_order([request.start_time, queue.start_time, queue.end_time, *_times(stages), step.end_time])


def test_a_step_that_fails_is_an_error_with_its_code(
    exporter: InMemorySpanExporter, traces: Traces, settings: WorkerSettings, box: Path, spec: dict[str, Any]
) -> None:
    spec["fluids"]["hot"]["inlets"][0]["center"] = [0, 0, 0]
    submitted(settings, traces, box, spec)
    assert take(settings, traces)
    (step,) = (s for s in exporter.get_finished_spans() if s.name == "step prepare")
    assert (step.status.status_code, step.status.description) == (StatusCode.ERROR, "port-not-on-boundary")


def test_without_being_asked_nothing_of_opentelemetry_s_exporters_is_loaded() -> None:
    code = "import sys, service.app, worker.station; sys.exit('opentelemetry.exporter' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def _times(stages: list[ReadableSpan]) -> list[int]:
    times = sorted((s.start_time or 0, s.end_time or 0) for s in stages)
    return [t for pair in times for t in pair]


def _in_order(times: list[int | None]) -> bool:
    """To a millisecond: begin and end of a stage are taken by two clocks."""
    return all((a or 0) <= (b or 0) + 1_000_000 for a, b in pairwise(times))
