"""What is measured: a service with two workers, on a folder of its own; and an endpoint that does nothing."""

from __future__ import annotations

import os
import re
import signal
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import psutil

from benchmarks.load.connection import cpu_s

PATIENCE_S = 120.0
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


@dataclass(frozen=True)
class Server:
    """Something that answers HTTP.

    Parameters
    ----------
    url, process
        Its address, and the id of the process that answers.
    ready_s, ready_cpu_s
        From the command to the first good answer: wall time, and processor time of all that had to start for it.
    own_s
        From the start of the process that answers to that answer.
    """

    url: str
    process: int
    ready_s: float
    ready_cpu_s: float
    own_s: float


def box(scale: float) -> bytes:
    """A box of 40 × 30 × 20 times ``scale``, as binary STL."""
    corners = [(x, y, z) for x in (-20, 20) for y in (-15, 15) for z in (-10, 10)]
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
    body = b"".join(struct.pack("<12fH", 0, 0, 0, *(scale * v for i in t for v in corners[i]), 0) for t in triangles)
    return bytes(80) + struct.pack("<I", len(triangles)) + body


@contextmanager
def served(folder: Path) -> Iterator[Server]:
    """A running service; ready when it says so itself."""
    console = folder / "console.log"
    serve = ["serve", "--port", "0", "--queues", "cpu", "--data", str(folder / "data")]
    began = time.monotonic()
    with console.open("wb") as out:
        process = _started([sys.executable, "-m", "service.cli", *serve], stdout=out, stderr=subprocess.STDOUT)
    try:
        url = ""
        while not (url and _answers(f"{url}/readyz")):
            if process.poll() is not None or time.monotonic() > began + PATIENCE_S:
                raise RuntimeError(console.read_text())
            found = re.search(r"listens at (http://\S+)", console.read_text())
            url = found[1] if found else ""
            time.sleep(0.005)
        seconds = time.monotonic() - began
        parent = psutil.Process(process.pid)
        api = next(p for p in parent.children() if p.name() == "dualms-api")
        later = api.create_time() - parent.create_time()
        yield Server(url, api.pid, seconds, cpu_s(process.pid) + cpu_s(api.pid), seconds - later)
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(60)


@contextmanager
def second_worker(folder: Path) -> Iterator[None]:
    """Another worker for the queue of the service on this folder."""
    data = folder / "data"
    env = {"DUALMS_DATA_DIR": str(data), "DUALMS_REDIS_URL": f"unix://{data / 'broker' / 'valkey.sock'}"}
    with (folder / "worker.log").open("wb") as out:
        worker = [sys.executable, "-m", "service.cli", "worker", "--queues", "cpu"]
        process = _started(worker, env, stdout=out, stderr=subprocess.STDOUT)
    try:
        yield
    finally:
        process.terminate()
        process.wait(60)


@contextmanager
def bare(folder: Path) -> Iterator[Server]:
    """An endpoint that does nothing, under uvicorn as the service has it."""
    (folder / "bare.py").write_text(BARE)
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    options = ["--port", str(port), "--no-access-log", "--log-level", "error"]
    began = time.monotonic()
    process = _started([sys.executable, "-m", "uvicorn", "bare:app", *options], cwd=folder)
    try:
        while not _answers(f"http://127.0.0.1:{port}/items/x"):
            if process.poll() is not None or time.monotonic() > began + PATIENCE_S:
                raise RuntimeError("the bare endpoint did not start")
            time.sleep(0.005)
        seconds = time.monotonic() - began
        yield Server(f"http://127.0.0.1:{port}", process.pid, seconds, cpu_s(process.pid), seconds)
    finally:
        process.terminate()
        process.wait(20)


def _started(command: list[str], extra: dict[str, str] | None = None, **options: Any) -> subprocess.Popen[bytes]:
    own = {k: v for k, v in os.environ.items() if not k.startswith("DUALMS_")}
    return subprocess.Popen(command, env={**own, "OMP_NUM_THREADS": "1", **(extra or {})}, **options)


def _answers(url: str) -> bool:
    try:
        return httpx.get(url, timeout=2).status_code == 200
    except httpx.TransportError:
        return False
