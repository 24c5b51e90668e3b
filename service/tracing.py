"""A span for each request, where traces are asked for; goes on with the caller's trace (W3C Trace Context)."""

from __future__ import annotations

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from worker.tracing import Tracing


class RequestSpans:
    """Puts a span around each request, named after its route."""

    def __init__(self, app: ASGIApp, tracing: Tracing) -> None:
        self.app, self.tracing = app, tracing

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        method, status = scope["method"], 500
        parent = dict(scope["headers"]).get(b"traceparent")

        async def noting(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
            await send(message)

        with self.tracing.span(method, "server", parent.decode("latin-1") if parent else None):
            try:
                await self.app(scope, receive, noting)
            finally:
                route = getattr(scope.get("route"), "path", None)
                if route is not None:
                    self.tracing.rename(f"{method} {route}")
                    self.tracing.note({"http.route": route})
                self.tracing.note({"http.request.method": method, "http.response.status_code": status})
                if status >= 500:
                    self.tracing.fail(f"status {status}")
