"""Polls, long polls, event streams and uploads from many clients at once."""

from __future__ import annotations

import asyncio
import statistics
import time
from collections import Counter
from collections.abc import Awaitable, Callable
from typing import Any

import httpx

from benchmarks.load.connection import line
from benchmarks.load.service import box

WAVE = 20  # connections that are opened together


async def mixture(url: str, designs: list[str], clients: int, seconds: float) -> dict[str, Any]:
    """Many clients of four kinds for a while; counts, errors, latencies."""
    errors: Counter[str] = Counter()
    counts: Counter[str] = Counter()
    latencies: dict[str, list[float]] = {"poll": [], "upload": []}
    end = time.monotonic() + seconds
    limits = httpx.Limits(max_connections=clients + 10)
    async with httpx.AsyncClient(base_url=url, timeout=60, limits=limits) as http:

        async def poll(n: int) -> None:
            async with line(url) as connection:
                while time.monotonic() < end:
                    began = time.monotonic()
                    status = await connection.get(f"/v1/designs/{designs[n % len(designs)]}")
                    latencies["poll"].append(time.monotonic() - began)
                    _count("poll", status == 200, counts, errors, str(status))
                    await asyncio.sleep(0.25)

        async def long_poll(n: int) -> None:
            etag = ""
            while (left := end - time.monotonic()) > 1:
                headers = {"Prefer": f"wait={int(min(left, 10))}", **({"If-None-Match": etag} if etag else {})}
                answer = await http.get(f"/v1/designs/{designs[n % len(designs)]}", headers=headers)
                etag = answer.headers.get("etag", "")
                _count("long poll", answer.status_code in (200, 304), counts, errors, str(answer.status_code))
                await asyncio.sleep(0.05)

        async def stream(n: int) -> None:
            while time.monotonic() < end:
                async with http.stream("GET", f"/v1/designs/{designs[n % len(designs)]}/events") as answer:
                    _count("stream", answer.status_code == 200, counts, errors, str(answer.status_code))
                    try:
                        async with asyncio.timeout(max(end - time.monotonic(), 0.1)):
                            async for text in answer.aiter_lines():
                                counts["event"] += text.startswith("data:")
                    except TimeoutError:
                        return
                await asyncio.sleep(0.5)

        async def upload(n: int) -> None:
            while time.monotonic() < end:
                began = time.monotonic()
                file = ("box.stl", box(1 + n / 1000))
                answer = await http.post("/v1/domains", files={"file": file}, data={"units": "mm"})
                latencies["upload"].append(time.monotonic() - began)
                _count("upload", answer.status_code == 201, counts, errors, answer.text[:200])
                await asyncio.sleep(1)

        kinds: list[tuple[float, Callable[[int], Awaitable[None]]]] = [(0.5, poll), (0.25, long_poll), (0.2, stream)]
        tasks = [kind(n) for share, kind in kinds for n in range(round(share * clients))]
        tasks += [upload(n) for n in range(clients - len(tasks))]
        results = await asyncio.gather(*tasks, return_exceptions=True)
    for result in results:
        if isinstance(result, BaseException):
            errors[repr(result)[:200]] += 1
    return {
        "clients": clients,
        "seconds": seconds,
        "answers": dict(counts),
        "errors": dict(errors),
        "latency_ms": {kind: _spread(values) for kind, values in latencies.items() if values},
    }


def _count(kind: str, good: bool, counts: Counter[str], errors: Counter[str], what: str) -> None:
    counts[kind] += 1
    if not good:
        errors[f"{kind}: {what}"] += 1


def _spread(seconds: list[float]) -> dict[str, float]:
    if len(seconds) < 2:
        return {"n": len(seconds), "max": round(1e3 * max(seconds), 1)}
    cuts = statistics.quantiles(seconds, n=100, method="inclusive")
    return {
        "n": len(seconds),
        **{f"p{p}": round(1e3 * cuts[p - 1], 1) for p in (50, 95, 99)},
        "max": round(1e3 * max(seconds), 1),
    }
