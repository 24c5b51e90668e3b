"""Liveness, readiness, metrics, and the pages for people."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Any, Literal

from fastapi import APIRouter, Request
from fastapi.responses import HTMLResponse, JSONResponse, Response
from prometheus_client import CONTENT_TYPE_LATEST, CollectorRegistry, generate_latest
from sqlalchemy.exc import SQLAlchemyError

from dualms import __version__
from service.access import OpenDep
from service.backend import Backend, BackendDep
from service.designs.views import artifact_view, design_summary
from service.domains.schemas import Output
from worker.views import DesignRecord

router = APIRouter(tags=["service"])

NEWEST = 12
# The pages bring all that they need along: nothing is loaded from elsewhere, and nobody may frame them.
PAGE = {
    "Content-Security-Policy": "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; "
    "img-src 'self' data:; frame-ancestors 'none'; base-uri 'none'; form-action 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
}
LINKED = ("report.html", "solid.3mf", "solid.stl", "scene.glb", "report.json")


class Health(Output):
    """The process answers."""

    status: Literal["ok"]
    version: str


class QueueOut(Output):
    """What waits and runs on one queue."""

    queue: Literal["cpu", "gpu", "cfd"]
    waiting: int
    running: int
    oldest_waiting_s: float
    workers: int


class WorkerOut(Output):
    """A worker that has given signs of life lately."""

    name: str
    queue: Literal["cpu", "gpu", "cfd"]
    concurrency: int
    draining: bool
    facts: dict[str, Any]


class Readiness(Output):
    """Whether designs can be taken and made."""

    ready: bool
    store: bool
    broker: bool
    queues: list[QueueOut]
    workers: list[WorkerOut]
    notes: list[str]


@router.get("/healthz")
async def healthz() -> Health:
    """Liveness: the process answers, however many threads are busy."""
    return Health(status="ok", version=__version__)


@router.get("/readyz", response_model=Readiness, responses={503: {"model": Readiness, "description": "Not ready."}})
def readyz(backend: BackendDep) -> Response:
    """Readiness: the store answers, so designs can be taken; says too what the broker and the workers do."""
    facts = readiness(backend)
    return JSONResponse(facts.model_dump(), 200 if facts.ready else 503, {"Cache-Control": "no-store"})


@router.get("/metrics", response_class=Response, responses={200: {"content": {"text/plain": {}}}})
def metrics(request: Request) -> Response:
    """Prometheus metrics."""
    registry: CollectorRegistry = request.app.state.registry
    return Response(generate_latest(registry), media_type=CONTENT_TYPE_LATEST)


@router.get("/", response_class=HTMLResponse, include_in_schema=False)
def landing(request: Request, backend: BackendDep, everybody: OpenDep) -> Response:
    """A page for people; shows no designs where keys keep owners apart. It looks again while something is made."""
    shown = backend.records.designs(limit=NEWEST).items if everybody else ()
    queues = ", ".join(f"{q.queue} {q.workers}" for q in backend.records.queues() if q.workers) or "none yet"
    cards = [_card(backend, row) for row in shown]
    base = str(request.base_url).rstrip("/")
    live = any(not row.final for row in shown)
    page = _page().render(designs=cards, base=base, version=__version__, workers=queues, live=live)
    return HTMLResponse(page, headers=PAGE)


@router.get("/docs", response_class=HTMLResponse, include_in_schema=False)
def docs(request: Request) -> Response:
    """The calls and the values that they take and give, for people."""
    from service.reference import reference_page  # with its template engine only where somebody looks

    return HTMLResponse(reference_page(json.dumps(request.app.openapi(), sort_keys=False)), headers=PAGE)


def readiness(backend: Backend) -> Readiness:
    """Look at store, broker and workers."""
    broker = backend.wakeups.ping()
    try:
        queues = [QueueOut.model_validate(q, from_attributes=True) for q in backend.records.queues()]
        rows = [row for row in backend.records.workers() if row.alive]
    except SQLAlchemyError:
        return Readiness(ready=False, store=False, broker=broker, queues=[], workers=[], notes=["the store is away"])
    workers = [
        WorkerOut.model_validate(
            {"name": w.name, "queue": w.queue, "concurrency": w.concurrency, "draining": w.draining, "facts": w.facts}
        )
        for w in rows
    ]
    notes = [] if broker else ["the broker is away: designs are taken, and wait until it is back"]
    if not any(w.queue == "cpu" for w in workers):
        notes.append("no cpu worker is registered: designs are taken, and wait for one")
    return Readiness(ready=True, store=True, broker=broker, queues=queues, workers=workers, notes=notes)


@cache
def _page() -> Any:
    from jinja2 import Environment

    text = (Path(__file__).parent / "web" / "landing.html").read_text(encoding="utf-8")
    return Environment(autoescape=True).from_string(text)


def _card(backend: Backend, row: DesignRecord) -> dict[str, Any]:
    summary = design_summary(row, backend.domain_name(row.domain_id))
    files = {a.name: artifact_view(row.id, a) for a in backend.records.artifacts(row.id)}
    return {
        **summary.model_dump(mode="json"),
        "created_at": datetime.fromtimestamp(row.created_at, UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "preview": files["preview.png"].href if "preview.png" in files else None,
        "report": files["report.html"].href if "report.html" in files else None,
        "files": [files[name] for name in LINKED if name in files],
    }
