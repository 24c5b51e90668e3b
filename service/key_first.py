"""Whoever has no key is refused before the body is read: FastAPI reads a form whole before it asks who sent it."""

from __future__ import annotations

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send

from service.access import READING, Access, bearer
from service.problems import Problem


class KeyFirst:
    """Asks for the key of every call under /v1 that has a body; the call itself asks again, for what it needs."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "http" and scope["method"] not in READING and scope["path"].startswith("/v1/"):
            access: Access = scope["app"].state.access
            try:
                await access.caller(bearer(Headers(scope=scope).get("authorization")), "write")
            except Problem as problem:
                problem.headers = {**(problem.headers or {}), "Connection": "close"}
                await problem.response()(scope, receive, send)
                return
        await self.app(scope, receive, send)
