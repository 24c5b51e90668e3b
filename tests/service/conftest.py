"""A real `dualms serve` in a temporary folder, and small real inputs."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from copy import deepcopy
from pathlib import Path
from typing import Any, NamedTuple

import httpx
import psutil
import pytest
import trimesh
from typer.testing import CliRunner

from service.cli import app
from service.commands import console
from tests.service.designs import read_stream, small
from worker.processes import with_parent

START_S = 120.0  # a busy machine takes long to import; the claim of 2 s is that of benchmarks.load


class Served:
    """A running `dualms serve`.

    Parameters
    ----------
    data
        Its data folder.
    """

    def __init__(self, data: Path, *options: str, env: dict[str, str] | None = None) -> None:
        self.data = data
        data.parent.mkdir(parents=True, exist_ok=True)
        self.console = data.parent / f"{data.name}-console.log"
        own = {k: v for k, v in os.environ.items() if not k.startswith("DUALMS_")}
        with self.console.open("wb") as out:
            serve = [sys.executable, "-m", "service.cli", "serve", "--port", "0", "--data", str(data), *options]
            self.process = subprocess.Popen(
                with_parent(serve),  # a test run that is killed leaves no service behind
                stdout=out,
                stderr=subprocess.STDOUT,
                env={**own, "OMP_NUM_THREADS": "1", "COLUMNS": "200", **(env or {})},
                start_new_session=True,
            )
        self.began = time.monotonic()
        self.url = self._url()
        self.http = httpx.Client(base_url=self.url, timeout=90)
        self._ready()
        self.ready_after_s = time.monotonic() - self.began

    def _url(self) -> str:
        while time.monotonic() < self.began + START_S and self.process.poll() is None:
            if found := re.search(r"listens at (http://\S+)", self.console.read_text()):
                return found[1]
            time.sleep(0.02)
        raise AssertionError(f"serve did not start:\n{self.logs()}")

    def _ready(self) -> None:
        while time.monotonic() < self.began + START_S:
            try:
                if self.http.get("/readyz").status_code == 200:
                    return
            except httpx.TransportError:
                pass
            time.sleep(0.02)
        raise AssertionError(f"the API did not start:\n{self.logs()}")

    def family(self) -> list[psutil.Process]:
        """This process and all below it."""
        try:
            parent = psutil.Process(self.process.pid)
            return [parent, *parent.children(recursive=True)]
        except psutil.NoSuchProcess:
            return []

    def kill_all(self) -> None:
        """SIGKILL to everything, the parent first."""
        for process in self.family():
            try:
                process.kill()
            except psutil.NoSuchProcess:
                continue
        self.process.wait(10)

    def stop(self, number: signal.Signals = signal.SIGINT, patience_s: float = 40.0) -> int:
        """Ask it to stop, as Ctrl-C does."""
        self.http.close()
        if self.process.poll() is None:
            self.process.send_signal(number)
        return self.process.wait(patience_s)

    def logs(self) -> str:
        """Console and logs, for a failed test's message."""
        files = [self.console, *sorted((self.data / "logs").glob("*.log"))]
        return "\n".join(f"== {f.name}\n{f.read_text(errors='replace')[-4000:]}" for f in files if f.exists())

    def upload(self, path: Path, units: str | None = "mm") -> httpx.Response:
        """POST /v1/domains."""
        data = {"units": units} if units else {}
        with path.open("rb") as file:
            return self.http.post("/v1/domains", files={"file": (path.name, file)}, data=data)

    def ended(self, design_id: str, patience_s: float = 600.0) -> dict[str, Any]:
        """The design once it has ended."""
        deadline = time.monotonic() + patience_s
        while time.monotonic() < deadline:
            answer = self.http.get(f"/v1/designs/{design_id}", headers={"Prefer": "wait=10"}).json()
            if answer["status"] in ("succeeded", "failed", "cancelled"):
                return answer
        raise AssertionError(f"design has not ended: {answer}\n{self.logs()}")


@pytest.fixture(scope="session")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    """One service for all tests that do not break it."""
    service = Served(tmp_path_factory.mktemp("served") / "data", "--queues", "cpu")
    yield service
    service.stop()


@pytest.fixture
def serve_at() -> Iterator[Callable[..., Served]]:
    """Starts services that a test may break; whatever is left of them is ended."""
    started: list[Served] = []

    def start(data: Path, *options: str, env: dict[str, str] | None = None) -> Served:
        started.append(Served(data, *options, env=env))
        return started[-1]

    yield start
    for service in started:
        service.stop()


@pytest.fixture(scope="session")
def box(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A box of 40 × 30 × 20 mm."""
    path = tmp_path_factory.mktemp("domains") / "box.stl"
    trimesh.creation.box((40, 30, 20)).export(path)
    return path


@pytest.fixture(scope="session")
def plain_spec() -> dict[str, Any]:
    """A small design in the box, with a shell: hot along x, cold against it."""
    return small(units="mm", shell={"thickness": 1.0})


@pytest.fixture
def spec(plain_spec: dict[str, Any]) -> dict[str, Any]:
    """The small design, to be changed."""
    return deepcopy(plain_spec)


@pytest.fixture(scope="session")
def domain_id(served: Served, box: Path) -> str:
    """The box, uploaded."""
    return str(served.upload(box).json()["id"])


class Trace(NamedTuple):
    """What a client saw of a design on its way: the answers of long polls, and the events of a stream."""

    polled: list[dict[str, Any]]
    etags: list[str]
    events: list[dict[str, str]]


@pytest.fixture(scope="session")
def traced(served: Served, domain_id: str) -> Trace:
    """The small design, followed to its end by long polls and by its event stream at once.

    It is the first that runs whole: whose steps are found in the cache shows no stage on its way. So a test that needs
    such a design to succeed asks for ``made``.
    """
    body = {"domain": domain_id, "spec": small(), "name": "made", "labels": ["a"]}
    answer = served.http.post("/v1/designs", json=body)
    assert answer.status_code == 202, answer.text
    design, etags = answer.json(), [answer.headers["etag"]]
    polled = [design]
    with ThreadPoolExecutor(1) as pool:
        stream = pool.submit(read_stream, served, design["events"])
        while polled[-1]["status"] in ("queued", "running"):
            look = served.http.get(design["href"], headers={"If-None-Match": etags[-1], "Prefer": "wait=20"})
            if look.status_code == 200:
                polled.append(look.json())
                etags.append(look.headers["etag"])
        return Trace(polled, etags, stream.result(30))


@pytest.fixture(scope="session")
def made(served: Served, traced: Trace) -> dict[str, Any]:
    """The small design, which has succeeded."""
    ended = traced.polled[-1]
    assert ended["status"] == "succeeded", f"{ended['error']}\n{served.logs()}"
    return ended


def as_json(answer: httpx.Response) -> str:
    """For messages."""
    return json.dumps(answer.json(), indent=1)


def run_keys(data: Path, *words: str) -> str:
    """Run `dualms keys` in this process; gives its output."""
    console.out.width = 200
    done = CliRunner(env={"DUALMS_DATA_DIR": str(data)}).invoke(app, ["keys", "--data", str(data), *words])
    assert done.exit_code == 0, done.output
    return str(done.stdout)


class Team:
    """A service with keys, and clients of several owners."""

    def __init__(self, service: Served) -> None:
        self.service = service
        self.clients: list[httpx.Client] = []

    def keys(self, *words: str) -> str:
        """Run `dualms keys`; gives its output."""
        return run_keys(self.service.data, *words)

    def client(self, owner: str, *options: str) -> httpx.Client:
        secret = self.keys("create", owner, *options).strip()
        assert secret.startswith("dms_")
        headers = {"Authorization": f"Bearer {secret}"}
        self.clients.append(httpx.Client(base_url=self.service.url, headers=headers, timeout=90))
        return self.clients[-1]

    def upload(self, client: httpx.Client, path: Path) -> httpx.Response:
        """POST /v1/domains by one of the clients, in millimetres."""
        with path.open("rb") as file:
            return client.post("/v1/domains", files={"file": (path.name, file)}, data={"units": "mm"})


@pytest.fixture(scope="session")
def keys() -> Callable[..., str]:
    """`dualms keys` on a data folder."""
    return run_keys


@pytest.fixture(scope="session")
def team(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Team]:
    """One service with keys for all tests that need no other."""
    service = Served(tmp_path_factory.mktemp("team") / "data", "--queues", "cpu")
    assert service.http.get("/v1/designs").status_code == 200, "open as long as there is no key"
    run_keys(service.data, "create", "first")
    time.sleep(1.2)  # whether there are keys is looked at once a second
    made = Team(service)
    yield made
    for client in made.clients:
        client.close()
    service.stop()
