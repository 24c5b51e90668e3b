"""Answers about one design, at once or after waiting for it."""

from __future__ import annotations

import time
from collections.abc import Callable

from fastapi.concurrency import run_in_threadpool
from fastapi.responses import Response

from service.backend import Backend, design_not_found
from service.conditional import matches
from service.designs.views import FINAL, design_view, etag, retry_after_s
from worker.records import DesignRecord


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
        await wait_for(backend, row, wait_s, lambda r: r.status in FINAL or (seen is not None and not _seen(seen, r)))
    return await run_in_threadpool(_answer, backend, design_id, seen, wait_s)


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
    headers = {**_headers(row, waited_s), "Content-Location": f"/v1/designs/{row.id}"}
    return Response(view.model_dump_json(), status, headers, "application/json")


def _answer(backend: Backend, design_id: str, seen: str | None, waited_s: float) -> Response:
    if (
        seen is not None
        and (known := backend.records.version(design_id)) is not None
        and matches(seen, f'"{known[0]}"')
    ):
        pause = {} if known[1] in FINAL else {"Retry-After": "1"}
        return Response(None, 304, {"ETag": f'"{known[0]}"', "Cache-Control": "no-cache", **pause})
    row = backend.records.design(design_id)
    if row is None:
        raise design_not_found(design_id)
    return design_answer(backend, row, waited_s=waited_s)


def _seen(seen: str, row: DesignRecord) -> bool:
    return matches(seen, etag(row))


def _headers(row: DesignRecord, waited_s: float) -> dict[str, str]:
    headers = {"ETag": etag(row), "Cache-Control": "no-cache"}
    if (pause := retry_after_s(row)) is not None:
        headers["Retry-After"] = str(pause)
    if waited_s > 0:
        headers["Preference-Applied"] = f"wait={int(waited_s)}"
    return headers
