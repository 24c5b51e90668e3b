"""Kills parts of a running service at random while small designs run, and counts what was lost or done twice.

    python -m benchmarks.fault_campaign --jobs 300 --kills 1000 --seed 1

Starts ``dualms serve`` at its default settings (but for the number of tries) on a folder of its own, sends designs over
HTTP (each with an idempotency key, repeated until it is answered; the k-th once so many kills are done that both end
together), and kills (SIGKILL) API, workers, step processes, broker, and now and then everything. Then it reads the
records: every design must have ended, no step may have been recorded twice, and no ended design may have changed. It
prints one JSON object: the counts, and the distributions of the times to re-dispatch, to cancel, and until the API
answers again. Exit code 1 where anything was lost or doubled.
"""

from __future__ import annotations

import argparse
import json
import math
import random
import signal
import sys
import tempfile
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import psutil
import trimesh

from benchmarks.fault_figures import MUST_BE_ZERO, Observed, all_states, figures, provenance
from benchmarks.fault_service import Service, design_of
from worker.records import Records
from worker.settings import Settings
from worker.views import FINAL

# Turns of each part, on average; what does not run, or not yet, is passed over. Most of the time no step runs, so its
# turn comes often: many steps end, many go on later.
WEIGHTS = {"api": 2.2, "worker": 0.35, "step": 2.0, "broker": 3.0, "all": 0.03}
YOUNG = 0.2  # how often a part may be killed that was killed before and is not back yet
MOST_BROKER = 0.55  # of all kills
SO_FAR_S = 30.0
SILENCE_S = 120.0  # after so long without news the workers write down where each of their threads is


@dataclass(frozen=True)
class Plan:
    """Size of a campaign; every ``cancel_every``-th design is cancelled while it runs; ``pause_s`` between turns.

    After ``strike_s`` it kills no more, however many kills are left, and what was not sent is sent at once.
    """

    jobs: int
    kills: int
    seed: int
    pause_s: float
    folder: Path
    cancel_every: int = 10
    patience_s: float = 7200.0
    strike_s: float = math.inf


def run(plan: Plan) -> dict[str, Any]:
    """Carry out a campaign, and give its figures."""
    data = plan.folder / "data"
    data.mkdir(parents=True)
    campaign = _Campaign(plan, Service(data, DUALMS_MAX_TRIES="100"), Records.open(_settings(data)))
    began = time.monotonic()
    try:
        campaign.run()
    finally:
        took = time.monotonic() - began
        left = campaign.close()
    records = Records.open(_settings(data))
    found = figures(records, plan.jobs, campaign.seen)
    records.close()
    kills = dict(sorted(campaign.seen.killed.items()))
    return {
        "jobs": plan.jobs,
        "seed": plan.seed,
        "pause_s": plan.pause_s,
        "seconds": round(took, 1),
        "kills": kills,
        "kills_total": sum(kills.values()),
        "left_behind": left,
        **found,
    }


class _Campaign:
    """One thread sends, one watches the records, this one kills."""

    def __init__(self, plan: Plan, service: Service, records: Records) -> None:
        self.seen = Observed()
        self._plan, self._service, self._records = plan, service, records
        self._rng = random.Random(plan.seed)
        self._stop = threading.Event()
        self._over = threading.Event()  # there will be no more kills
        self._done = threading.Event()  # all were sent and have ended
        self._api_killed: float | None = None
        self._threads = [threading.Thread(target=work) for work in (self._send, self._watch, self._call)]

    def run(self) -> None:
        self._service.start_if_dead()
        stl = trimesh.creation.box((20, 20, 40)).export(file_type="stl")
        answer = self._service.ask("POST", "/domains", files={"file": ("box.stl", stl)}, data={"units": "mm"})
        self._domain = str(answer.json()["id"])
        for thread in self._threads:
            thread.start()
        self._strike()
        self._over.set()
        deadline = time.monotonic() + self._plan.patience_s
        while not self._done.is_set() and time.monotonic() < deadline:
            self._service.start_if_dead()
            time.sleep(0.5)

    def close(self) -> int:
        """Stop all; gives the number of processes that are left behind."""
        self._stop.set()
        for thread in self._threads:
            if thread.is_alive():
                thread.join(60)
        self._service.stop()
        self._records.close()
        _, left = psutil.wait_procs(self._service.left_behind(), timeout=5)
        return len(left)

    def _send(self) -> None:
        for number in range(self._plan.jobs):
            due = number * self._plan.kills / max(self._plan.jobs - 1, 1) - 2
            while self.seen.killed.total() < due and not self._over.is_set() and not self._stop.wait(0.2):
                pass
            body = {"domain": self._domain, "spec": _spec(number)}
            answer = self._service.ask("POST", "/designs", json=body, headers={"Idempotency-Key": f"job-{number}"})
            self.seen.sent.append(str(answer.json()["id"]))

    def _watch(self) -> None:
        news, since = 0, time.monotonic()
        began = wrote = time.monotonic()
        while not self._stop.wait(1.0):
            designs = all_states(self._records)
            for design in designs:
                if design.status in FINAL:
                    self.seen.finals.setdefault(design.id, design.version)
            if len(self.seen.sent) == self._plan.jobs and all(design.status in FINAL for design in designs):
                self._done.set()
            if time.monotonic() - wrote > SO_FAR_S:
                wrote = time.monotonic()
                self._write_so_far(wrote - began)
            if (version := sum(design.version for design in designs)) != news:
                news, since = version, time.monotonic()
            elif time.monotonic() - since > SILENCE_S:
                since = time.monotonic()
                for worker in self._service.processes()["worker"]:
                    worker.send_signal(signal.SIGUSR1)

    def _write_so_far(self, seconds: float) -> None:
        """Keep what was seen until now beside the logs, for a campaign that is stopped."""
        kills = {"seconds": round(seconds, 1), "kills": dict(self.seen.killed), "kills_total": self.seen.killed.total()}
        found = figures(self._records, len(self.seen.sent), self.seen)
        (self._plan.folder / "so_far.json").write_text(json.dumps({**kills, **found}, indent=1))

    def _strike(self) -> None:
        """Kill parts at random until the number is reached, the time is over, or nothing is left to run."""
        to_cancel = self._plan.cancel_every
        end = time.monotonic() + self._plan.strike_s
        while self.seen.killed.total() < self._plan.kills and not self._done.is_set() and time.monotonic() < end:
            time.sleep(self._rng.expovariate(1 / self._plan.pause_s))
            self._service.start_if_dead()
            running = self._service.processes()
            if len(self.seen.sent) >= to_cancel and running["step"]:
                to_cancel += self._plan.cancel_every
                self._cancel(self._rng.choice(running["step"]))
                continue
            part = self._rng.choices(list(WEIGHTS), list(WEIGHTS.values()))[0]
            if running[part] and self._may_die(part, running):
                self._kill(part, running)

    def _may_die(self, part: str, running: dict[str, list[psutil.Process]]) -> bool:
        """Whether it is a part's turn: mostly those at work, now and then one that still starts."""
        if part == "broker":  # is back at once; without a bound it would be killed most
            return self.seen.killed["broker"] <= MOST_BROKER * self.seen.killed.total()
        starting = part in ("api", "all") and self._api_killed is not None
        if part == "worker":
            starting = not {w.pid for w in self._records.workers()} & {p.pid for p in running["worker"]}
        return not starting or self._rng.random() < YOUNG

    def _kill(self, part: str, running: dict[str, list[psutil.Process]]) -> None:
        victims = running["all"] if part == "all" else [self._rng.choice(running[part])]
        struck = [design_of(step) for step in running["step"]]
        now = time.time()
        for victim in victims:
            try:
                victim.kill()
            except psutil.NoSuchProcess:
                continue
        self.seen.killed[part] += 1
        if part in ("api", "all"):
            self._api_killed = time.monotonic()
        if part in ("step", "worker", "all"):
            self.seen.struck += [(now, design) for design in struck if design is not None]

    def _call(self) -> None:
        """Note when the API answers again after it was killed."""
        while not self._stop.wait(0.2):
            killed = self._api_killed
            if killed is not None and self._service.answers() and killed == self._api_killed:
                self.seen.api_back_s.append(time.monotonic() - killed)
                self._api_killed = None

    def _cancel(self, running: psutil.Process) -> None:
        design = design_of(running)
        if design is None:
            return
        answer = self._service.ask("POST", f"/designs/{design}/cancel")
        began = time.monotonic()
        if answer.json()["status"] == "cancelled":
            psutil.wait_procs([running], timeout=60)
            self.seen.cancelled_s.append(time.monotonic() - began)


def _settings(data: Path) -> Settings:
    return Settings(data_dir=data, database_url="", store_url="", redis_url="")


def _spec(number: int) -> dict[str, Any]:
    """Small designs: a hundred share skeletons and field, fifty of these all; what is equal is reused later."""
    shared = {"inlets": [{"facet": 4}], "outlets": [{"facet": 5}]}
    return {
        "units": "mm",
        "fluids": {"hot": shared, "cold": shared},
        "flow": {"kind": "none"},
        "graph": {"sites": 24},
        "partition": {"seconds": 0.05},
        "field": {"method": "phase-field", "resolution": 32},
        "surface": {"resolution": 32},
        "wall": {"thickness": round(1.5 + 0.001 * (number % 100 // 50), 6)},
        "shell": None,
        "pictures": {"width": 160},
        "seed": number // 100,
    }


def main() -> int:
    """Run the campaign that the arguments describe."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--jobs", type=int, default=300)
    parser.add_argument("--kills", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--pause", type=float, default=1.1, help="mean seconds between two turns")
    parser.add_argument("--minutes", type=float, default=math.inf, help="kill no longer than that")
    parser.add_argument("--folder", type=Path, help="a new folder that keeps the records and logs")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="dualms-faults-") as folder:
        place, strike_s = given.folder or Path(folder), 60 * given.minutes
        found = run(Plan(given.jobs, given.kills, given.seed, given.pause, place, strike_s=strike_s))
    print(json.dumps({"command": sys.argv[1:], **provenance(), **found}, indent=1))
    return int(any(found[name] for name in MUST_BE_ZERO))


if __name__ == "__main__":
    sys.exit(main())
