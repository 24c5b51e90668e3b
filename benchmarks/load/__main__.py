"""Load on the API by many clients at once, beside a bare FastAPI endpoint measured in the same run.

    python -m benchmarks.load --clients 200 --seconds 20 --out benchmarks/results/load.json

Starts ``dualms serve`` and a second worker on a folder of its own and measures: time from the command to ready; status
polls a second, against an endpoint that does nothing under the same uvicorn; a mixture of polls, long polls, event
streams and uploads from many clients while both workers make designs; the API's memory during a 500 MB upload; listing
and polling with 100,000 ended designs. Prints JSON; exit code 1 where a target is missed.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import sys
import tempfile
from dataclasses import asdict
from pathlib import Path
from typing import Any

import httpx

from benchmarks.load.connection import Rate, rate
from benchmarks.load.history import history
from benchmarks.load.memory import upload_memory
from benchmarks.load.mixture import mixture
from benchmarks.load.provenance import provenance
from benchmarks.load.service import SPEC, Server, bare, box, second_worker, served


def main() -> int:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--clients", type=int, default=200)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--starts", type=int, default=3)
    parser.add_argument("--connections", type=int, default=16)
    parser.add_argument("--designs", type=int, default=100_000, help="ended designs in the records")
    parser.add_argument("--out", type=Path, help="also write the figures here")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        figures = {"provenance": provenance(), **measure(Path(folder), options)}
    figures["targets"] = targets(figures)
    text = json.dumps(figures, indent=1)
    print(text)
    if options.out is not None:
        options.out.write_text(text + "\n")
    return 0 if all(figures["targets"].values()) else 1


def measure(folder: Path, options: argparse.Namespace) -> dict[str, Any]:
    """All figures."""
    result: dict[str, Any] = {"start": _starts(folder, options.starts)}
    with (
        served(folder) as server,
        second_worker(folder),
        bare(folder) as rival,
        httpx.Client(base_url=server.url, timeout=90) as http,
    ):
        domain = http.post("/v1/domains", files={"file": ("box.stl", box(1))}, data={"units": "mm"}).json()["id"]
        first = http.post("/v1/designs", json={"domain": domain, "spec": SPEC}).json()
        while http.get(first["href"], headers={"Prefer": "wait=30"}).json()["status"] in ("queued", "running"):
            pass
        etag = http.get(first["href"]).headers["etag"]
        result["polls"] = asyncio.run(_rates(server, rival, first["href"], etag, options.connections))
        designs = [first["id"]]
        for seed in range(1, 20):  # more than the workers can make meanwhile
            body = {"domain": domain, "spec": {**SPEC, "seed": seed}}
            designs.append(http.post("/v1/designs", json=body).json()["id"])
        result["mixture"] = asyncio.run(mixture(server.url, designs, options.clients, options.seconds))
        result["mixture"]["running"] = http.get("/readyz").json()["queues"][0]["running"]
        for design in designs:
            http.post(f"/v1/designs/{design}/cancel")
        result["upload"] = upload_memory(server, 500)
        result["history"] = history(server.url, folder / "data", options.designs, 60)
    return result


def targets(figures: dict[str, Any]) -> dict[str, bool]:
    """What the service promises."""
    return {
        "the API is ready within 2 s of its start": max(figures["start"]["api_ready_s"]) < 2,
        "status polls at least half as fast as a bare endpoint": figures["polls"]["ratio_cpu"]["status"] >= 0.5,
        "no error under load": not figures["mixture"]["errors"],
        "an upload of 500 MB takes under 64 MB of memory": figures["upload"]["memory_growth_mib"] < 64,
        "a long history slows down by under 1.5": all(c["ratio"] < 1.5 for c in figures["history"]["calls"].values()),
    }


def _starts(folder: Path, times: int) -> dict[str, Any]:
    services, rivals = [], []
    for k in range(times):
        place = folder / f"start-{k}"
        place.mkdir()
        with served(place) as server:
            services.append(server)
        with bare(place) as rival:
            rivals.append(rival)
    return {
        "api_ready_s": [round(s.own_s, 2) for s in services],
        "ready_s": [round(s.ready_s, 2) for s in services],
        "ready_cpu_s": [round(s.ready_cpu_s, 2) for s in services],
        "bare_ready_s": [round(s.ready_s, 2) for s in rivals],
        "bare_ready_cpu_s": [round(s.ready_cpu_s, 2) for s in rivals],
    }


async def _rates(server: Server, rival: Server, href: str, etag: str, connections: int) -> dict[str, Any]:
    """Polls, and the endpoint that does nothing before and after them."""
    seconds = 5.0
    first = await rate(rival.process, rival.url, "/items/x", connections, seconds)
    status = await rate(server.process, server.url, href, connections, seconds)
    unchanged = await rate(server.process, server.url, href, connections, seconds, f"If-None-Match: {etag}\r\n")
    second = await rate(rival.process, rival.url, "/items/x", connections, seconds)
    nothing = Rate((first.per_s + second.per_s) / 2, (first.per_cpu_s + second.per_cpu_s) / 2)
    kinds = {"status": status, "status_unchanged": unchanged}
    return {
        "bare_endpoint": _rounded(nothing),
        **{name: _rounded(found) for name, found in kinds.items()},
        "ratio": {name: round(found.per_s / nothing.per_s, 3) for name, found in kinds.items()},
        "ratio_cpu": {name: round(found.per_cpu_s / nothing.per_cpu_s, 3) for name, found in kinds.items()},
    }


def _rounded(found: Rate) -> dict[str, int]:
    return {name: round(value) for name, value in asdict(found).items()}


if __name__ == "__main__":
    sys.exit(main())
