"""Conditional and patient requests: ETag (RFC 9110), Range (RFC 9110), ``Prefer: wait`` (RFC 7240)."""

from __future__ import annotations

import re
from dataclasses import dataclass

from service.problems import Problem

MAX_WAIT_S = 60.0

_RANGE = re.compile(r"bytes=(\d*)-(\d*)", re.ASCII)


@dataclass(frozen=True)
class ByteRange:
    """Bytes ``start`` to ``stop`` (excluded) of a file."""

    start: int
    stop: int

    @property
    def length(self) -> int:
        """Number of bytes."""
        return self.stop - self.start

    def header(self, size: int) -> str:
        """Value of Content-Range."""
        return f"bytes {self.start}-{self.stop - 1}/{size}"


def matches(header: str | None, etag: str) -> bool:
    """Whether an If-None-Match header names this ETag (weak comparison)."""
    if header is None:
        return False
    named = {part.strip().removeprefix("W/") for part in header.split(",")}
    return "*" in named or etag.removeprefix("W/") in named


def wait_s(prefer: str | None, limit: float = MAX_WAIT_S) -> float:
    """Seconds that a client prefers to wait; 0 where it says nothing or nonsense."""
    for part in (prefer or "").replace(";", ",").split(","):
        name, _, value = part.partition("=")
        if name.strip().lower() == "wait" and value.strip().isascii() and value.strip().isdigit():
            return min(float(value.strip()[:9]), limit)
    return 0.0


def byte_range(header: str | None, if_range: str | None, etag: str, size: int) -> ByteRange | None:
    """The one range that is asked for, or None for the whole file.

    Several ranges, other units and malformed headers are answered by the whole file, as the RFC allows.

    Raises
    ------
    Problem
        ``range-not-satisfiable`` if the range lies outside the file.
    """
    found = _RANGE.fullmatch((header or "").strip().replace(" ", ""))
    if found is None or found.groups() == ("", "") or (if_range is not None and if_range != etag):
        return None
    first, last = found.groups()
    if first and last and int(last) < int(first):
        return None
    if first:
        start, stop = int(first), min(int(last) + 1, size) if last else size
    else:
        start, stop = max(size - int(last), 0), size
    if start >= size or start >= stop:
        raise Problem(
            "range-not-satisfiable",
            f"The file has {size} bytes; {header} lies outside.",
            "Ask for bytes within it, or leave the Range header out.",
            measured={"size": size},
            headers={"Content-Range": f"bytes */{size}"},
        )
    return ByteRange(start, stop)
