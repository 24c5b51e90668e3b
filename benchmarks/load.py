"""Load on the API by many clients at once, beside a bare FastAPI endpoint measured in the same run.

    python benchmarks/load.py --clients 200 --seconds 20

Starts ``dualms serve`` on a folder of its own and measures: time from the command to the first answer; status polls a
second, against an endpoint that does nothing under the same uvicorn; a mixture of polls, long polls, event streams and
uploads from many clients while the worker makes designs; the API's memory during a 500 MB upload. Prints JSON.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import re
import signal
import socket
import statistics
import struct
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager, contextmanager
from pathlib import Path
from typing import Any

import httpx
import psutil

SPEC: dict[str, Any] = {
    "fluids": {
        "hot": {"inlets": [{"center": [-20, -7, 0], "radius": 5}], "outlets": [{"center": [20, -7, 0], "radius": 5}]},
        "cold": {"inlets": [{"center": [20, 7, 0], "radius": 5}], "outlets": [{"center": [-20, 7, 0], "radius": 5}]},
    },
    "graph": {"sites": 64},
    "partition": {"method": "anneal", "seconds": 0.1},
    "field": {"method": "phase-field", "resolution": 48},
    "surface": {"resolution": 64},
    "wall": {"thickness": 1.0},
}
BARE = """
from fastapi import FastAPI
app = FastAPI()
@app.get("/items/{name}")
async def item(name: str) -> dict[str, str]:
    return {"name": name}
"""


def box(scale: float) -> bytes:
    """A box of 40 × 30 × 20 times ``scale``, as binary STL."""
    corners = [(x, y, z) for x in (-20, 20) for y in (-15, 15) for z in (-10, 10)]
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
    body = b"".join(struct.pack("<12fH", 0, 0, 0, *(scale * v for i in t for v in corners[i]), 0) for t in triangles)
    return bytes(80) + struct.pack("<I", len(triangles)) + body


@contextmanager
def served(folder: Path) -> Any:
    """A running service: its address, its start-up time, its process."""
    console = folder / "console.log"
    environment = {k: v for k, v in os.environ.items() if not k.startswith("DUALMS_")} | {"OMP_NUM_THREADS": "1"}
    command = [
        sys.executable,
        "-m",
        "service.cli",
        "serve",
        "--port",
        "0",
        "--queues",
        "cpu",
        "--data",
        str(folder / "data"),
    ]
    began = time.monotonic()
    with console.open("wb") as out:
        process = subprocess.Popen(command, stdout=out, stderr=subprocess.STDOUT, env=environment)
    try:
        url = ""
        while not url or not _answers(url):
            if process.poll() is not None or time.monotonic() > began + 60:
                raise RuntimeError(console.read_text())
            found = re.search(r"listens at (http://\S+)", console.read_text())
            url = found[1] if found else ""
            time.sleep(0.005)
        yield url, time.monotonic() - began, process
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(60)


@contextmanager
def bare(folder: Path) -> Any:
    """An endpoint that does nothing, under uvicorn as the service has it."""
    (folder / "bare.py").write_text(BARE)
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    command = [
        sys.executable,
        "-m",
        "uvicorn",
        "bare:app",
        "--port",
        str(port),
        "--no-access-log",
        "--log-level",
        "error",
    ]
    process = subprocess.Popen(command, cwd=folder)
    try:
        while not _answers(f"http://127.0.0.1:{port}", "/items/x"):
            time.sleep(0.02)
        yield f"http://127.0.0.1:{port}"
    finally:
        process.terminate()
        process.wait(20)


def _answers(url: str, path: str = "/healthz") -> bool:
    try:
        return httpx.get(url + path, timeout=2).status_code == 200
    except httpx.TransportError:
        return False


# --- a client that costs little, so that the server is what is measured -------------------------------------------


class Line:
    """One kept-alive HTTP/1.1 connection."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader, self.writer = reader, writer

    async def get(self, path: str, headers: str = "") -> int:
        """Status of a GET; the body is read and dropped."""
        self.writer.write(f"GET {path} HTTP/1.1\r\nHost: x\r\n{headers}\r\n".encode())
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


async def rate(url: str, path: str, connections: int, seconds: float, headers: str = "") -> float:
    """Answers a second over some connections that ask again and again."""
    count, end = 0, time.monotonic() + seconds

    async def ask() -> None:
        nonlocal count
        async with line(url) as connection:
            while time.monotonic() < end:
                status = await connection.get(path, headers)
                if status not in (200, 304):
                    raise RuntimeError(f"status {status}")
                count += 1

    began = time.monotonic()
    await asyncio.gather(*(ask() for _ in range(connections)))
    return count / (time.monotonic() - began)


# --- the mixture --------------------------------------------------------------------------------------------------


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


# --- memory -------------------------------------------------------------------------------------------------------


def upload_memory(url: str, api: psutil.Process, megabytes: int) -> dict[str, Any]:
    """How much the API's memory grows while it takes in a large file (which is refused in the end: it is no mesh)."""
    before = peak = api.memory_info().rss
    done = threading.Event()

    def watch() -> None:
        nonlocal peak
        while not done.wait(0.02):
            peak = max(peak, api.memory_info().rss)

    watcher = threading.Thread(target=watch)
    watcher.start()
    with tempfile.TemporaryFile() as file:
        file.truncate(megabytes * 1_000_000)
        began = time.monotonic()
        answer = httpx.post(f"{url}/v1/domains", files={"file": ("zeros.stl", file)}, data={"units": "mm"}, timeout=300)
    done.set()
    watcher.join()
    return {
        "megabytes": megabytes,
        "status": answer.status_code,
        "code": answer.json().get("code"),
        "seconds": round(time.monotonic() - began, 2),
        "memory_growth_mib": round((peak - before) / 2**20, 1),
    }


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--clients", type=int, default=200)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--starts", type=int, default=3)
    parser.add_argument("--connections", type=int, default=16)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        print(json.dumps(measure(Path(folder), options), indent=1))


def measure(folder: Path, options: argparse.Namespace) -> dict[str, Any]:
    """All figures."""
    starts = []
    for k in range(options.starts):
        (folder / f"start-{k}").mkdir()
        with served(folder / f"start-{k}") as (_, seconds, _process):
            starts.append(round(seconds, 2))
    result: dict[str, Any] = {"cores": os.cpu_count(), "start_to_ready_s": starts}
    with served(folder) as (url, _, process), bare(folder) as rival, httpx.Client(base_url=url, timeout=60) as http:
        domain = http.post("/v1/domains", files={"file": ("box.stl", box(1))}, data={"units": "mm"}).json()["id"]
        first = http.post("/v1/designs", json={"domain": domain, "spec": SPEC}).json()
        while http.get(first["href"], headers={"Prefer": "wait=30"}).json()["status"] in ("queued", "running"):
            pass
        etag = http.get(first["href"]).headers["etag"]
        result["polls_per_s"] = asyncio.run(_rates(url, rival, first["href"], etag, options))
        designs = [first["id"]]
        for seed in range(1, 20):  # more than the worker can make meanwhile
            body = {"domain": domain, "spec": {**SPEC, "seed": seed}}
            designs.append(http.post("/v1/designs", json=body).json()["id"])
        result["mixture"] = asyncio.run(mixture(url, designs, options.clients, options.seconds))
        for design in designs:
            http.post(f"/v1/designs/{design}/cancel")
        api = next(p for p in psutil.Process(process.pid).children() if "service.listen" in " ".join(p.cmdline()))
        result["upload"] = upload_memory(url, api, 500)
    return result


async def _rates(url: str, rival: str, href: str, etag: str, options: argparse.Namespace) -> dict[str, float]:
    """Polls a second, and the endpoint that does nothing before and after them."""
    n, seconds = options.connections, 5.0
    first = await rate(rival, "/items/x", n, seconds)
    full = await rate(url, href, n, seconds)
    unchanged = await rate(url, href, n, seconds, f"If-None-Match: {etag}\r\n")
    second = await rate(rival, "/items/x", n, seconds)
    nothing = (first + second) / 2
    return {
        "bare_endpoint": round(nothing),
        "status": round(full),
        "status_unchanged": round(unchanged),
        "ratio_status": round(full / nothing, 3),
        "ratio_unchanged": round(unchanged / nothing, 3),
    }


if __name__ == "__main__":
    main()
