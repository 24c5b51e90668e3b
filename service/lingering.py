"""A refusal that arrives: what is left of a request's body is taken in and dropped before the connection is closed.

Closed with bytes unread, a connection is reset, and the client may lose the answer that lies in its own buffer.
"""

from __future__ import annotations

import asyncio

from starlette.types import ASGIApp, Message, Receive, Scope, Send

LINGER_S = 5.0
LINGER_BYTES = 64 * 1024**2


class Lingering:
    """Holds back the end of an answer that closes the connection, until the request has ended or enough was dropped."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        unread, closing = True, False

        async def noted() -> Message:
            nonlocal unread
            message = await receive()
            unread = unread and message["type"] == "http.request" and bool(message.get("more_body"))
            return message

        async def last(message: Message) -> None:
            nonlocal closing
            if message["type"] == "http.response.start":
                headers = dict(message.get("headers", ()))
                closing = headers.get(b"connection", b"").lower() == b"close"
            elif message["type"] == "http.response.body" and closing and unread and not message.get("more_body"):
                await send({**message, "more_body": True})
                await drop()
                message = {"type": "http.response.body", "body": b""}
            await send(message)

        async def drop() -> None:
            dropped = 0
            try:
                async with asyncio.timeout(LINGER_S):
                    while unread and dropped < LINGER_BYTES:
                        dropped += len((await noted()).get("body", b""))
            except TimeoutError:
                return

        await self.app(scope, noted, last)
