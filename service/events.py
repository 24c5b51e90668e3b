"""A design's events as a stream (server-sent events), resumable with Last-Event-ID."""

from __future__ import annotations

import json
from collections.abc import AsyncIterator

from fastapi.concurrency import run_in_threadpool
from fastapi.responses import Response
from sse_starlette import EventSourceResponse, ServerSentEvent

from service.backend import Backend
from service.designs.views import FINAL
from service.problems import Problem
from service.times import iso
from worker.views import EventRecord

BATCH = 200
LOOK_AGAIN_S = 20.0


def event_stream(backend: Backend, design_id: str, after: int) -> Response:
    """The events of a design after sequence number ``after``, until it ends.

    A client that has seen the last event of an ended design gets 204, which tells a browser not to come back.
    """
    row = backend.design(design_id)
    if row.status in FINAL and after >= row.version:
        return Response(None, 204)
    return EventSourceResponse(_events(backend, design_id, after), ping=backend.settings.sse_ping_s)


def last_event_id(header: str | None) -> int:
    """The sequence number of a Last-Event-ID header; 0 without one.

    Raises
    ------
    Problem
        ``malformed-request`` if it is not a number of ours.
    """
    if not header:
        return 0
    if not (header.isascii() and header.isdigit() and len(header) <= 12):
        raise Problem("malformed-request", "Last-Event-ID is not one of this stream.", "Send the last `id` received.")
    return int(header)


async def _events(backend: Backend, design_id: str, after: int) -> AsyncIterator[ServerSentEvent]:
    while True:
        row = await run_in_threadpool(backend.records.design, design_id)
        if row is None:
            return
        events = await run_in_threadpool(backend.records.events, design_id, after, BATCH)
        for event in events:
            after = event.sequence
            yield ServerSentEvent(_data(event), event=event.kind, id=str(event.sequence))
        if len(events) == BATCH:
            continue
        if row.status in FINAL:
            return
        await backend.watch.change(design_id, row.version, LOOK_AGAIN_S)


def _data(event: EventRecord) -> str:
    return json.dumps({**event.data, "time": iso(event.created_at)}, separators=(",", ":"))
