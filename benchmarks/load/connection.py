"""A client that costs little, so that the server is what is measured."""

from __future__ import annotations

import asyncio
import re
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass

import psutil


class Line:
    """One kept-alive HTTP/1.1 connection."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader, self.writer = reader, writer

    async def get(self, path: str, headers: str = "") -> int:
        """Status of a GET; the body is read and dropped."""
        self.writer.write(f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1\r\n{headers}\r\n".encode())
        head = (await self.reader.readuntil(b"\r\n\r\n")).decode("latin-1").lower()
        status = int(head[9:12])
        if found := re.search(r"content-length: (\d+)", head):
            await self.reader.readexactly(int(found[1]))
        return status


@asynccontextmanager
async def line(url: str) -> AsyncIterator[Line]:
    """A connection to ``url``."""
    host, port = url.removeprefix("http://").split(":")
    reader, writer = await asyncio.open_connection(host, int(port))
    try:
        yield Line(reader, writer)
    finally:
        writer.close()


@dataclass(frozen=True)
class Rate:
    """Answers a second, and answers a second of the server's processor time: that one holds on a busy machine, too."""

    per_s: float
    per_cpu_s: float


async def rate(server: int, url: str, path: str, connections: int, seconds: float, headers: str = "") -> Rate:
    """How fast a server (by its process id) answers connections that ask again and again."""
    count, end = 0, time.monotonic() + seconds

    async def ask() -> None:
        nonlocal count
        async with line(url) as connection:
            while time.monotonic() < end:
                status = await connection.get(path, headers)
                if status not in (200, 304):
                    raise RuntimeError(f"status {status}")
                count += 1

    began, used = time.monotonic(), cpu_s(server)
    await asyncio.gather(*(ask() for _ in range(connections)))
    return Rate(count / (time.monotonic() - began), count / max(cpu_s(server) - used, 1e-9))


def cpu_s(process: int) -> float:
    """Processor time of a process so far, without its children's."""
    times = psutil.Process(process).cpu_times()
    return float(times.user + times.system)
