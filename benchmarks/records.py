"""Listing and polling with few and with many ended designs in the records.

    python benchmarks/records.py --designs 100000

Prints one JSON object: milliseconds a call with 100 designs and with the asked number, and their ratio.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from sqlalchemy import insert, select

from dualms.spec import Spec
from worker import tables
from worker.leases import Leases
from worker.queue import Wakeups
from worker.reaper import Reaper
from worker.records import Records
from worker.rows import NewDesign, new_id
from worker.settings import Settings

BATCH = 2000


def main() -> int:
    """Measure, and print the figures."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--designs", type=int, default=100_000)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="dualms-records-") as folder:
        records = Records.open(Settings(data_dir=Path(folder), database_url="", redis_url=""))
        few = fill(records, 100)
        small = _measure(records, few)
        many = fill(records, given.designs - 100)
        large = _measure(records, many)
        records.close()
    figures = {name: {"few_ms": small[name], "many_ms": large[name]} for name in small}
    for pair in figures.values():
        pair["ratio"] = round(pair["many_ms"] / pair["few_ms"], 2)
    print(json.dumps({"designs": given.designs, "calls": figures}, indent=2))
    return 0


def fill(records: Records, count: int) -> str:
    """Add ended designs; gives the id of one in the middle."""
    if records.domain("0" * 64) is None:
        records.add_domain(id="0" * 64, sha256="0" * 64, size=1, name="x", suffix=".stl", units="mm", inspection={})
    port = {"inlets": [{"facet": 0}], "outlets": [{"facet": 1}]}
    spec = Spec.model_validate(
        {"units": "mm", "fluids": {"hot": port, "cold": port}, "field": {"method": "phase-field"}}
    )
    record, _ = records.create_design(NewDesign("0" * 64, spec, labels=("a",)))
    records.cancel(record.id)
    with records.database.read() as session:
        row = session.execute(select(tables.Design.__table__).where(tables.Design.id == record.id)).mappings().one()
    ids = [record.id]
    for start in range(1, count, BATCH):
        batch = [new_id() for _ in range(min(BATCH, count - start))]
        ids += batch
        with records.database.write() as session:
            session.execute(insert(tables.Design), [{**row, "id": i, "status": "succeeded"} for i in batch])
            session.execute(insert(tables.DesignLabel), [{"label": "a", "design_id": i} for i in batch])
            session.execute(
                insert(tables.Event),
                [
                    {"design_id": i, "sequence": n, "kind": "step", "data": {}, "created_at": 0.0}
                    for i in batch
                    for n in range(1, 6)
                ],
            )
    return ids[len(ids) // 2]


def _measure(records: Records, design_id: str) -> dict[str, float]:
    leases, reaper = Leases(records), Reaper(records, Wakeups(records.settings))
    calls: dict[str, Callable[[], object]] = {
        "poll": lambda: records.design(design_id),
        "version": lambda: records.version(design_id),
        "events": lambda: records.events(design_id),
        "list": lambda: records.designs(limit=50),
        "list_middle": lambda: records.designs(limit=50, cursor=design_id),
        "list_status": lambda: records.designs(limit=50, status="succeeded"),
        "list_label": lambda: records.designs(limit=50, label="a"),
        "claim_none": lambda: leases.claim("cpu", "w"),
        "reap": reaper.run_once,
    }
    return {name: _milliseconds(call) for name, call in calls.items()}


def _milliseconds(call: Callable[[], object], repeats: int = 60) -> float:
    call()
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        call()
        times.append(time.perf_counter() - began)
    return round(sorted(times)[repeats // 2] * 1000, 3)


if __name__ == "__main__":
    sys.exit(main())
