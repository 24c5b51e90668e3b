"""How much a long history slows listing and polling down, over HTTP."""

from __future__ import annotations

import asyncio
import statistics
import time
from pathlib import Path
from typing import Any

from benchmarks.load.connection import line
from benchmarks.records import fill
from worker.records import Records
from worker.settings import Settings

FEW = 100  # more than a page


def history(url: str, data: Path, many: int, calls: int) -> dict[str, Any]:
    """Milliseconds a call with ``FEW`` and with ``many`` ended designs, in turns with a call that reads no records.

    Parameters
    ----------
    url, data
        The service, and its data folder (its records are filled directly).
    many
        Ended designs in the end.
    calls
        Of each kind; medians are given.
    """
    records = Records.open(Settings(data_dir=data, database_url="", redis_url=""))
    try:
        few = asyncio.run(_medians(url, fill(records, FEW), calls))
        lots = asyncio.run(_medians(url, fill(records, many - FEW), calls))
    finally:
        records.close()
    base_few, base_many = few.pop("nothing"), lots.pop("nothing")
    # On a busy machine everything slows down alike; what does nothing tells how much.
    weather = base_many / base_few
    return {
        "designs": many,
        "nothing_ms": {"few": base_few, "many": base_many},
        "calls": {
            name: {"few_ms": few[name], "many_ms": lots[name], "ratio": round(lots[name] / few[name] / weather, 2)}
            for name in few
        },
    }


async def _medians(url: str, design_id: str, calls: int) -> dict[str, float]:
    paths = {
        "nothing": "/healthz",
        "poll": f"/v1/designs/{design_id}",
        "list": "/v1/designs?limit=50",
        "list_status": "/v1/designs?limit=50&status=succeeded",
        "list_label": "/v1/designs?limit=50&label=a",
        "list_middle": f"/v1/designs?limit=50&cursor={design_id}",
    }
    times: dict[str, list[float]] = {name: [] for name in paths}
    async with line(url) as connection:
        for _ in range(calls):
            for name, path in paths.items():
                began = time.perf_counter()
                if (status := await connection.get(path)) != 200:
                    raise RuntimeError(f"{path}: status {status}")
                times[name].append(time.perf_counter() - began)
    return {name: round(1e3 * statistics.median(values), 3) for name, values in times.items()}
