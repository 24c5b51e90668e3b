"""One line in the log for each request that changes something, is refused for who asked it, or breaks the service.

Reads that go well are not logged: status polls are most of what the API does, and the metrics count them.
"""

from __future__ import annotations

import logging
import time
from typing import Any

from starlette.types import ASGIApp, Message, Receive, Scope, Send

log = logging.getLogger("dualms.access")

READING = frozenset({"GET", "HEAD", "OPTIONS"})
REFUSED = frozenset({401, 403, 429})


class AccessLog:
    """Logs method, path, status, duration, key and job of what is worth a line."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        began, status = time.perf_counter(), 500
        place = ""

        async def noting(message: Message) -> None:
            nonlocal status, place
            if message["type"] == "http.response.start":
                status = message["status"]
                if scope["method"] == "POST":
                    place = dict(message["headers"]).get(b"location", b"").decode("latin-1")
            await send(message)

        try:
            await self.app(scope, receive, noting)
        finally:
            if scope["method"] not in READING or status in REFUSED or status >= 500:
                _write(scope, status, time.perf_counter() - began, place)


def _write(scope: Scope, status: int, seconds: float, place: str) -> None:
    caller = scope.get("state", {}).get("caller")
    key = getattr(caller, "key", None)
    detail: dict[str, Any] = {"status": status, "ms": round(1e3 * seconds, 1)}
    if key is not None:
        detail |= {"owner": key.owner, "key_id": key.id}
    job_id = scope.get("path_params", {}).get("design_id")
    if job_id is None and place.startswith("/v1/designs/"):
        job_id = place.rpartition("/")[2]  # one that this request has made
    log.info("%s %s", scope["method"], scope["path"], extra={"job_id": job_id, "detail": detail})
