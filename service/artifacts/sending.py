"""Bytes of the store as an answer: whole, in part, not at all (304), or by a redirect to S3."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any
from urllib.parse import quote

from fastapi import Depends, Header, Request
from fastapi.responses import RedirectResponse, Response, StreamingResponse

from service.backend import Backend
from service.conditional import byte_range, matches

# The bytes are made from what clients send: a browser must neither guess their type nor run them as ours.
SAFE = {"X-Content-Type-Options": "nosniff", "Content-Security-Policy": "sandbox allow-scripts"}


@dataclass(frozen=True)
class Asked:
    """The headers that decide how much is sent."""

    method: str
    range: str | None
    if_range: str | None
    if_none_match: str | None


def asked(
    request: Request,
    range_: Annotated[str | None, Header(alias="Range", description="One range of bytes.")] = None,
    if_range: Annotated[str | None, Header(description="Send the range only if the ETag is this one.")] = None,
    if_none_match: Annotated[str | None, Header(description="Send nothing if the ETag is this one.")] = None,
) -> Asked:
    """The headers of this request."""
    return Asked(request.method, range_, if_range, if_none_match)


AskedDep = Annotated[Asked, Depends(asked)]


def contents(*media_types: str) -> dict[str, Any]:
    """What a call's documentation says of bytes in one of these media types."""
    plain = sorted({media_type.partition(";")[0] for media_type in media_types})
    file = {"type": "string", "format": "binary"}
    return {"content": {t: {"schema": {} if t == "application/json" else file} for t in plain}}


@dataclass(frozen=True)
class Blob:
    """Bytes in the store, and how to name them."""

    sha256: str
    size: int
    media_type: str
    name: str


def send_blob(backend: Backend, blob: Blob, ask: Asked, *, download: bool = False) -> Response:
    """Answer with the bytes of ``blob``, or the part that is asked for.

    Raises
    ------
    Problem
        ``range-not-satisfiable``.
    """
    etag = f'"{blob.sha256}"'
    kind = "attachment" if download else "inline"
    headers = {
        **SAFE,
        "ETag": etag,
        "Accept-Ranges": "bytes",
        "Cache-Control": "private, max-age=0, must-revalidate",
        "Content-Disposition": f"{kind}; filename*=UTF-8''{quote(blob.name)}",
    }
    if matches(ask.if_none_match, etag):
        return Response(None, 304, headers)
    if ask.method == "GET" and (url := _presigned(backend, blob)) is not None:
        return RedirectResponse(url, 307, {"ETag": etag, "Cache-Control": "no-store"})
    part = byte_range(ask.range, ask.if_range, etag, blob.size)
    start, length = (part.start, part.length) if part else (0, blob.size)
    headers["Content-Length"] = str(length)
    if part:
        headers["Content-Range"] = part.header(blob.size)
    status = 206 if part else 200
    if ask.method == "HEAD":
        return Response(None, status, headers, blob.media_type)
    return StreamingResponse(backend.store.get(blob.sha256, start, start + length), status, headers, blob.media_type)


def _presigned(backend: Backend, blob: Blob) -> str | None:
    seconds = float(backend.settings.presigned_s)
    return backend.store.presigned_url(blob.sha256, seconds, filename=blob.name, media_type=blob.media_type)
