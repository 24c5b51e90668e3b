"""Kills parts of a running service at random while small designs run, and counts what was lost or done twice.

    python benchmarks/fault_campaign.py --jobs 300 --kills 1000 --seed 1

Starts ``dualms serve`` on a folder of its own, sends designs over HTTP (each with an idempotency key, repeated until it
is answered), and kills (SIGKILL) API, workers, step processes, broker, and now and then everything. Then it reads the
records: every design must have ended, no step may have been recorded twice, and no ended design may have changed. It
prints one JSON object: the counts, and the distributions of the times to re-dispatch and to cancel.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import socket
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx
import psutil
import trimesh

from worker.records import DesignRecord, Records
from worker.settings import Settings

PARTS = {
    "api": "service.listen",
    "worker": "service.cli worker",
    "station": "worker.station",
    "step": "worker.step",
    "broker": "valkey-server",
}
WEIGHTS = {"api": 1.0, "worker": 1.0, "station": 1.5, "step": 3.0, "broker": 1.0, "all": 0.2}


@dataclass(frozen=True)
class Plan:
    """Size of a campaign; every ``cancel_every``-th design is cancelled while it runs."""

    jobs: int
    kills: int
    seed: int
    pause_s: float
    folder: Path
    cancel_every: int = 10
    patience_s: float = 7200.0


@dataclass
class Observed:
    """What the campaign has seen."""

    killed: dict[str, int] = field(default_factory=dict)
    struck: list[tuple[float, str]] = field(default_factory=list)  # time of a kill, design that ran then
    cancelled_s: list[float] = field(default_factory=list)
    finals: dict[str, int] = field(default_factory=dict)  # design -> version at which it was first seen final
    refused: int = 0


class Service:
    """``dualms serve`` on a fixed port, started again where it was killed."""

    def __init__(self, folder: Path) -> None:
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self.port = int(probe.getsockname()[1])
        self.url = f"http://127.0.0.1:{self.port}/v1"
        environment = {"DUALMS_MAX_TRIES": "100", "OMP_NUM_THREADS": "1", "DUALMS_DATA_DIR": str(folder)}
        self._environment = {**os.environ, **environment}
        self._command = [sys.executable, "-m", "service.cli", "serve", "--data", str(folder), "--queues", "cpu"]
        self._command += ["--port", str(self.port)]
        self._log = folder.parent / "serve.log"
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        with self._log.open("ab") as log:
            self._process = subprocess.Popen(self._command, env=self._environment, stdout=log, stderr=log)

    def start_again_if_dead(self) -> None:
        if self._process is None or self._process.poll() is not None:
            self.start()

    def parts(self, part: str) -> list[psutil.Process]:
        """Processes of a part; ``all``: every process of the service."""
        if self._process is None or self._process.poll() is not None:
            return []
        try:
            top = psutil.Process(self._process.pid)
            below = top.children(recursive=True)
        except psutil.NoSuchProcess:
            return []
        return [top, *below] if part == "all" else [p for p in below if _is(p, PARTS[part])]

    def stop(self) -> None:
        if self._process is not None and self._process.poll() is None:
            self._process.send_signal(signal.SIGTERM)
            try:
                self._process.wait(60)
            except subprocess.TimeoutExpired:
                for process in self.parts("all"):
                    process.kill()


def run(plan: Plan) -> dict[str, Any]:
    """Carry out a campaign, and give its figures."""
    rng = random.Random(plan.seed)
    data = plan.folder / "data"
    data.mkdir(parents=True)
    service, seen = Service(data), Observed()
    service.start()
    stop = threading.Event()
    records = Records.open(Settings(data_dir=data, database_url="", store_url="", redis_url=""))
    try:
        domain = _upload(service, plan.folder)
        made: list[str] = []
        threads = [
            threading.Thread(target=_send, args=(plan, service, domain, made, seen)),
            threading.Thread(target=_watch, args=(records, seen, stop)),
        ]
        for thread in threads:
            thread.start()
        began = time.monotonic()
        _strike(plan, rng, service, records, made, seen)
        threads[0].join()
        _wait(plan, service, records, made)
        took = time.monotonic() - began
        stop.set()
        threads[1].join()
        return _figures(plan, records, made, seen, took)
    finally:
        stop.set()
        service.stop()
        records.close()


def _upload(service: Service, folder: Path) -> str:
    stl = trimesh.creation.box((20, 20, 40)).export(file_type="stl")
    answer = _ask(service, "POST", "/domains", files={"file": ("box.stl", stl)}, data={"units": "mm"})
    return str(answer.json()["id"])


def _spec(number: int) -> dict[str, Any]:
    """Small designs: some differ from the first stage on, most in the wall alone."""
    shared = {"inlets": [{"facet": 4}], "outlets": [{"facet": 5}]}
    return {
        "units": "mm",
        "fluids": {"hot": shared, "cold": shared},
        "graph": {"sites": 24},
        "partition": {"seconds": 0.05},
        "field": {"method": "phase-field", "resolution": 32},
        "surface": {"resolution": 32},
        "wall": {"thickness": round(1.5 + 0.0001 * number, 6)},
        "shell": None,
        "seed": number // 8,
    }


def _send(plan: Plan, service: Service, domain: str, made: list[str], seen: Observed) -> None:
    for number in range(plan.jobs):
        body = {"domain": domain, "spec": _spec(number)}
        answer = _ask(service, "POST", "/designs", json=body, headers={"Idempotency-Key": f"job-{number}"})
        design = str(answer.json()["id"])
        made.append(design)


def _ask(service: Service, method: str, path: str, **arguments: Any) -> httpx.Response:
    """A request, repeated until it is answered; refusing is not an answer here."""
    deadline = time.monotonic() + 300
    while True:
        try:
            answer = httpx.request(method, service.url + path, timeout=30, **arguments)
            if answer.status_code < 500 and answer.status_code != 429:
                answer.raise_for_status()
                return answer
        except httpx.TransportError:
            pass
        if time.monotonic() > deadline:
            raise TimeoutError(f"{method} {path} was not answered")
        time.sleep(0.2)


def _watch(records: Records, seen: Observed, stop: threading.Event) -> None:
    while not stop.wait(1.0):
        for design in _all(records):
            if design.final:
                seen.finals.setdefault(design.id, design.version)


def _strike(
    plan: Plan, rng: random.Random, service: Service, records: Records, made: list[str], seen: Observed
) -> None:
    """Kill parts at random until the number is reached or nothing is left to run."""
    to_cancel = plan.cancel_every
    while sum(seen.killed.values()) < plan.kills:
        time.sleep(rng.expovariate(1 / plan.pause_s))
        service.start_again_if_dead()
        if len(made) == plan.jobs and all(d.final for d in _all(records)):
            return
        if len(made) >= to_cancel and (running := service.parts("step")):
            to_cancel += plan.cancel_every
            _cancel(service, rng.choice(running), seen)
            continue
        part = rng.choices(list(WEIGHTS), list(WEIGHTS.values()))[0]
        victims = service.parts(part)
        if not victims:
            continue
        if part != "all":
            victims = [rng.choice(victims)]
        struck = _design_of(service.parts("step")) if part in ("step", "station", "worker", "all") else None
        for victim in victims:
            try:
                victim.kill()
            except psutil.NoSuchProcess:
                continue
        seen.killed[part] = seen.killed.get(part, 0) + 1
        if struck is not None:
            seen.struck.append((time.time(), struck))
        service.start_again_if_dead()


def _cancel(service: Service, running: psutil.Process, seen: Observed) -> None:
    design = _design_of([running])
    if design is None:
        return
    answer = _ask(service, "POST", f"/designs/{design}/cancel")
    began = time.monotonic()
    if answer.json()["status"] == "cancelled":
        psutil.wait_procs([running], timeout=60)
        seen.cancelled_s.append(time.monotonic() - began)


def _design_of(steps: list[psutil.Process]) -> str | None:
    """The design that a step process works for, from its folder's name."""
    for step in steps:
        try:
            return Path(step.cwd()).name.split("-")[3]
        except (psutil.Error, IndexError):
            continue
    return None


def _wait(plan: Plan, service: Service, records: Records, made: list[str]) -> None:
    deadline = time.monotonic() + plan.patience_s
    while time.monotonic() < deadline:
        service.start_again_if_dead()
        finals = {design.id for design in _all(records) if design.final}
        if finals.issuperset(made):
            return
        time.sleep(0.5)


def _figures(plan: Plan, records: Records, made: list[str], seen: Observed, took: float) -> dict[str, Any]:
    designs = {design.id: design for design in _all(records)}
    events = {i: records.events(i, limit=100_000) for i in designs}
    twice = 0
    for happened in events.values():
        done = [e.data["step"] for e in happened if e.kind in ("step", "reused", "succeeded")]
        twice += len(done) - len(set(done))
    again = []
    for when, design in seen.struck:
        starts = [e.created_at for e in events.get(design, ()) if e.kind == "started" and e.created_at > when]
        again += [min(starts) - when] if starts else []
    statuses: dict[str, int] = {}
    for design in designs.values():
        statuses[design.status] = statuses.get(design.status, 0) + 1
    return {
        "jobs": plan.jobs,
        "seed": plan.seed,
        "seconds": round(took, 1),
        "kills": dict(sorted(seen.killed.items())),
        "kills_total": sum(seen.killed.values()),
        "designs": len(designs),
        "statuses": statuses,
        "lost": sum(i not in designs or not designs[i].final for i in made) + (plan.jobs - len(set(made))),
        "recorded_twice": twice,
        "made_twice": len(designs) - plan.jobs,
        "final_changed": sum(designs[i].version != version for i, version in seen.finals.items()),
        "failures": sorted({str((d.error or {}).get("code")) for d in designs.values() if d.status == "failed"}),
        "redispatch_s": _distribution(again),
        "cancel_s": _distribution(seen.cancelled_s),
    }


def _distribution(values: list[float]) -> dict[str, float]:
    if not values:
        return {"n": 0}
    ordered = sorted(values)
    return {
        "n": len(ordered),
        "median": round(statistics.median(ordered), 2),
        "p90": round(ordered[int(0.9 * (len(ordered) - 1))], 2),
        "max": round(ordered[-1], 2),
    }


def _all(records: Records) -> list[DesignRecord]:
    found: list[DesignRecord] = []
    cursor = None
    while True:
        page = records.designs(limit=500, cursor=cursor)
        found += page.items
        if (cursor := page.next) is None:
            return found


def _is(process: psutil.Process, words: str) -> bool:
    try:
        return words in " ".join(process.cmdline())
    except psutil.Error:
        return False


def main() -> int:
    """Run the campaign that the arguments describe; exit code 1 where anything was lost or doubled."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--jobs", type=int, default=300)
    parser.add_argument("--kills", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--pause", type=float, default=2.0, help="mean seconds between two kills")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="dualms-faults-") as folder:
        figures = run(Plan(given.jobs, given.kills, given.seed, given.pause, Path(folder)))
    print(json.dumps(figures, indent=2))
    return int(any(figures[k] for k in ("lost", "recorded_twice", "made_twice", "final_changed")))


if __name__ == "__main__":
    sys.exit(main())
