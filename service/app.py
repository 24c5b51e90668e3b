"""The HTTP face: ``create_app`` makes what uvicorn serves."""

from __future__ import annotations

import tempfile
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

from fastapi import Depends, FastAPI
from fastapi.telemetry import TelemetryConfig
from prometheus_client import CollectorRegistry

from dualms import __version__
from service import problems, system
from service.access import Access, guard
from service.artifacts.endpoints import router as artifacts
from service.backend import open_backend
from service.designs.endpoints import router as designs
from service.documentation import describe
from service.domains.endpoints import router as domains
from service.gauges import RecordsCollector
from service.key_first import KeyFirst
from service.limits import BodyLimit
from service.lingering import Lingering
from service.metrics import Meter
from service.observing import Observing
from service.settings import Settings
from service.studies.endpoints import router as studies
from worker.settings import Settings as WorkerSettings
from worker.tracing import Tracing, open_tracing

FORM_OVERHEAD = 1024**2  # what a form adds to the file in it


def create_app(
    settings: Settings | None = None, worker_settings: WorkerSettings | None = None, tracing: Tracing | None = None
) -> FastAPI:
    """The app; connections are opened when it starts.

    Parameters
    ----------
    settings, worker_settings
        Default: what the environment says.
    tracing
        Where traces go. Default: as the settings say.
    """
    ours, theirs = settings or Settings(), worker_settings or WorkerSettings()
    traces = tracing or open_tracing(theirs.tracing, "dualms-api")
    registry = CollectorRegistry()

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        spool = theirs.scratch / "spool"
        spool.mkdir(parents=True, exist_ok=True)
        before, tempfile.tempdir = tempfile.tempdir, str(spool)  # uploads spool beside the store, not in a RAM disk
        try:
            async with open_backend(ours, theirs, traces) as backend:
                app.state.backend = backend
                app.state.access = Access(backend.records, ours.require_keys, ours.loopback_only)
                collector: Any = RecordsCollector(backend)
                registry.register(collector)
                yield
        finally:
            tempfile.tempdir = before

    app = FastAPI(
        title="DualMS",
        version=__version__,
        summary="Two-fluid heat exchangers whose separating surface belongs to the envelope.",
        license_info={"name": "MIT", "identifier": "MIT"},
        lifespan=lifespan,
        telemetry=_telemetry(traces),
        docs_url=None,  # FastAPI's pages load scripts from elsewhere
        redoc_url=None,
    )
    app.state.registry = registry
    problems.install(app)
    refusals = problems.answers(401, 403, 429)
    for router in (designs, artifacts, domains, studies):
        app.include_router(router, dependencies=[Depends(guard)], responses=refusals)
    app.include_router(system.router)
    describe(app)
    app.add_middleware(KeyFirst)
    app.add_middleware(BodyLimit, upload_bytes=theirs.upload_bytes + FORM_OVERHEAD)
    app.add_middleware(Lingering)
    app.add_middleware(Observing, meter=Meter(registry))
    return app


def _telemetry(traces: Tracing) -> TelemetryConfig:
    """Spans of requests where traces are asked for; figures are Prometheus's, and the log is ours."""
    off: TelemetryConfig = {"metrics": False, "logs": False, "operation_spans": False}
    return {**off, "tracing": traces.on, **({"tracer_provider": traces.provider} if traces.on else {})}
