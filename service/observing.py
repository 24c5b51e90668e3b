"""One look at each request, from its start to its last byte, for the log and the metrics."""

from __future__ import annotations

import time

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service import access_log
from service.metrics import Meter


class Observing:
    """Notes status, duration and what was made, and tells :mod:`service.access_log` and the meter.

    Parameters
    ----------
    app
        What is observed.
    meter
        Counts the requests.
    """

    def __init__(self, app: ASGIApp, meter: Meter) -> None:
        self.app, self.meter = app, meter

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        began, status, place = time.perf_counter(), 500, ""

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
            seconds = time.perf_counter() - began
            self.meter.count(scope, status, seconds)
            access_log.write(scope, status, seconds, place)
