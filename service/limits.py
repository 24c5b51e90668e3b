"""Bounds on what a request may send, counted while it arrives."""

from __future__ import annotations

from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.problems import Problem

SMALL_BODY = 1024**2  # a JSON request; the largest sensible specification is far below
UPLOAD_PATHS = frozenset({"/v1/domains", "/v1/designs"})


class BodyLimit:
    """Refuse bodies over a limit: by Content-Length before reading, otherwise as soon as the count passes it.

    Parameters
    ----------
    app
        What is limited.
    upload_bytes
        Limit for multipart bodies sent to ``UPLOAD_PATHS``; all others may send ``SMALL_BODY``.
    """

    def __init__(self, app: ASGIApp, upload_bytes: int) -> None:
        self.app, self.upload_bytes = app, upload_bytes

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http" or scope["method"] in ("GET", "HEAD"):
            await self.app(scope, receive, send)
            return
        headers = dict(scope["headers"])
        form = headers.get(b"content-type", b"").lower().startswith(b"multipart/form-data")
        limit = self.upload_bytes if form and scope["path"] in UPLOAD_PATHS else SMALL_BODY
        length = headers.get(b"content-length", b"0")
        if length.isdigit() and int(length) > limit:
            await _too_large(limit).response()(scope, receive, send)
            return
        received = 0

        async def counted() -> Message:
            nonlocal received
            message = await receive()
            received += len(message.get("body", b""))
            if received > limit:
                raise _too_large(limit)
            return message

        await self.app(scope, counted, send)


def _too_large(limit: int) -> Problem:
    return Problem(
        "too-large",
        f"The body exceeds the limit of {limit:,} bytes.",
        "Send a coarser tessellation, or a compact format such as binary STL or GLB.",
        measured={"limit_bytes": limit},
        headers={"Connection": "close"},
    )
