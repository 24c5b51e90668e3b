"""What a fault campaign comes to: counts of what must be zero, and distributions of times."""

from __future__ import annotations

import os
import platform
import statistics
import subprocess
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

from sqlalchemy import select

from worker import tables
from worker.records import Records
from worker.views import DesignRecord, EventRecord

MUST_BE_ZERO = ("lost", "recorded_twice", "made_twice", "final_changed", "left_behind")


@dataclass
class Observed:
    """What the campaign has seen."""

    killed: Counter[str] = field(default_factory=Counter)
    struck: list[tuple[float, str]] = field(default_factory=list)  # time of a kill, design that ran then
    cancelled_s: list[float] = field(default_factory=list)
    api_back_s: list[float] = field(default_factory=list)
    finals: dict[str, int] = field(default_factory=dict)  # design -> version at which it was first seen final
    sent: list[str] = field(default_factory=list)  # designs in the order of their answers


class State(NamedTuple):
    """Where a design stands."""

    id: str
    version: int
    status: str


def figures(records: Records, jobs: int, seen: Observed) -> dict[str, Any]:
    """Read the records, and compare them with what was seen."""
    designs = {design.id: design for design in all_designs(records)}
    events = {i: records.events(i, limit=100_000) for i in designs}
    ended = {i for i, design in designs.items() if design.final}
    return {
        "designs": len(designs),
        "statuses": dict(Counter(design.status for design in designs.values())),
        "failures": sorted({str((d.error or {}).get("code")) for d in designs.values() if d.status == "failed"}),
        "lost": len(set(seen.sent) - ended) + (jobs - len(set(seen.sent))),
        "recorded_twice": sum(_recorded_twice(happened) for happened in events.values()),
        "made_twice": len(designs) - jobs,
        "final_changed": sum(designs[i].version != version for i, version in seen.finals.items()),
        "steps_started": sum(e.kind == "started" for happened in events.values() for e in happened),
        "steps_taken_away": sum(e.kind == "retrying" for happened in events.values() for e in happened),
        "longest_silence_s": _longest_silence(events),
        "redispatch_s": distribution(_redispatch(seen, events)),
        "cancel_s": distribution(seen.cancelled_s),
        "api_back_s": distribution(seen.api_back_s),
    }


def distribution(values: list[float]) -> dict[str, float]:
    """Number, median, 90th and 99th percentile and maximum, in seconds."""
    if not values:
        return {"n": 0}
    ordered = sorted(values)
    quantiles = {name: ordered[int(q * (len(ordered) - 1))] for name, q in (("p90", 0.9), ("p99", 0.99), ("max", 1.0))}
    return {
        "n": len(ordered),
        "median": round(statistics.median(ordered), 2),
        **{name: round(value, 2) for name, value in quantiles.items()},
    }


def all_designs(records: Records) -> list[DesignRecord]:
    """Every design there is."""
    found: list[DesignRecord] = []
    cursor = None
    while True:
        page = records.designs(limit=500, cursor=cursor)
        found += page.items
        if (cursor := page.next) is None:
            return found


def all_states(records: Records) -> Sequence[State]:
    """Id, version and status of every design, without the rest."""
    d = tables.Design
    with records.database.read() as session:
        return [State(*row) for row in session.execute(select(d.id, d.version, d.status))]


def provenance() -> dict[str, Any]:
    """Where and from what a result was made."""
    git = ["git", "-C", str(Path(__file__).parent), "describe", "--always", "--dirty", "--abbrev=12"]
    return {
        "commit": subprocess.run(git, capture_output=True, text=True, check=False).stdout.strip(),
        "date": time.strftime("%Y-%m-%d", time.gmtime()),
        "machine": platform.machine(),
        "cores": os.cpu_count(),
        "load_average": [round(load, 1) for load in os.getloadavg()],
        "python": platform.python_version(),
    }


def _recorded_twice(happened: tuple[EventRecord, ...]) -> int:
    done = [e.data["step"] for e in happened if e.kind in ("step", "reused", "succeeded")]
    return len(done) - len(set(done))


def _redispatch(seen: Observed, events: dict[str, tuple[EventRecord, ...]]) -> list[float]:
    """Seconds from each kill that hit a running step to the next start of a step of that design."""
    again = []
    for when, design in seen.struck:
        starts = [e.created_at for e in events.get(design, ()) if e.kind == "started" and e.created_at > when]
        again += [min(starts) - when] if starts else []
    return again


def _longest_silence(events: dict[str, tuple[EventRecord, ...]]) -> float:
    """The longest time in which nothing happened to any design although one had not ended."""
    moments = sorted({event.created_at for happened in events.values() for event in happened})
    spans = [(happened[0].created_at, happened[-1].created_at) for happened in events.values()]
    gaps = [b - a for a, b in pairwise(moments) if any(first <= a and b <= last for first, last in spans)]
    return round(max(gaps, default=0.0), 2)
