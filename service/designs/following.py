"""Answers about one design, at once or after waiting for it."""

from __future__ import annotations

import time
from collections.abc import Callable

from fastapi.concurrency import run_in_threadpool
from fastapi.responses import Response

from service.backend import Backend, design_not_found
from service.conditional import matches
from service.designs.views import FINAL, design_view, etag, retry_after_s
from worker.views import DesignRecord


async def follow(backend: Backend, design_id: str, wait_s: float, seen: str | None) -> Response:
    """The design as JSON, or 304.

    Parameters
    ----------
    backend
        Connections.
    design_id
        Which.
    wait_s
        How long to wait: with ``seen`` until the design changes, without until it ends.
    seen
        If-None-Match header.

    Raises
    ------
    Problem
        ``design-not-found``.
    """
    if wait_s > 0:
        row = await run_in_threadpool(backend.design, design_id)
        await wait_for(
            backend, row, wait_s, lambda r: r.status in FINAL or (seen is not None and not matches(seen, etag(r)))
        )
    state = await backend.looks.get(design_id)
    if state is None:
        raise design_not_found(design_id)
    version, status = state
    if matches(seen, f'"{version}"'):
        return Response(None, 304, _headers(version, status, wait_s))
    if (body := backend.bodies.get(design_id, version)) is not None:
        return Response(body, 200, _headers(version, status, wait_s), "application/json")
    row = await run_in_threadpool(backend.design, design_id)
    return await run_in_threadpool(design_answer, backend, row, 200, wait_s)


async def wait_for(backend: Backend, row: DesignRecord, wait_s: float, enough: Callable[[DesignRecord], bool]) -> None:
    """Return when a design is as wanted, is gone, or the time is over."""
    deadline = time.monotonic() + wait_s
    while not enough(row) and (left := deadline - time.monotonic()) > 0:
        if not await backend.watch.change(row.id, row.version, left):
            return
        now = await run_in_threadpool(backend.records.design, row.id)
        if now is None:
            return
        row = now


def design_answer(backend: Backend, row: DesignRecord, status: int = 200, waited_s: float = 0) -> Response:
    """A design in full, with the headers that go with it."""
    artifacts = backend.records.artifacts(row.id)
    view = design_view(row, backend.domain_name(row.domain_id), artifacts, time.time())
    body = view.model_dump_json().encode()
    backend.bodies.keep(row.id, row.version, body)
    headers = {**_headers(row.version, row.status, waited_s), "Content-Location": f"/v1/designs/{row.id}"}
    return Response(body, status, headers, "application/json")


def _headers(version: int, status: str, waited_s: float) -> dict[str, str]:
    headers = {"ETag": f'"{version}"', "Cache-Control": "no-cache"}
    if (pause := retry_after_s(status)) is not None:
        headers["Retry-After"] = str(pause)
    if waited_s > 0:
        headers["Preference-Applied"] = f"wait={int(waited_s)}"
    return headers
