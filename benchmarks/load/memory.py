"""How much the API's memory grows by a large upload."""

from __future__ import annotations

import tempfile
import threading
import time
from typing import Any

import httpx
import psutil

from benchmarks.load.service import Server


def upload_memory(server: Server, megabytes: int) -> dict[str, Any]:
    """How much the API's memory grows while it takes in a large file (which is refused in the end: it is no mesh)."""
    api = psutil.Process(server.process)
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
        answer = httpx.post(
            f"{server.url}/v1/domains", files={"file": ("zeros.stl", file)}, data={"units": "mm"}, timeout=300
        )
    done.set()
    watcher.join()
    return {
        "megabytes": megabytes,
        "status": answer.status_code,
        "code": answer.json().get("code"),
        "seconds": round(time.monotonic() - began, 2),
        "memory_growth_mib": round((peak - before) / 2**20, 1),
    }
