"""Real records, a real store, a real broker, and a small real design."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest
import trimesh

from dualms.spec import Spec
from tests.broker import Broker
from tests.proxy import Proxy
from worker.artifacts import put_file
from worker.lease import FileRecord, StepRecord
from worker.leases import Leases
from worker.queue import Wakeups
from worker.records import Records
from worker.rows import NewDesign
from worker.settings import Settings
from worker.stores import open_store
from worker.views import DesignRecord, DomainRecord

FACES = ("inlets", "outlets")


def small_spec(**changes: Any) -> Spec:
    """A design in a 20 × 20 × 40 mm box that takes a few seconds."""
    shared = {"inlets": [{"facet": 4}], "outlets": [{"facet": 5}]}
    return Spec.model_validate(
        {
            "units": "mm",
            "fluids": {"hot": shared, "cold": shared},
            "graph": {"sites": 32},
            "partition": {"seconds": 0.1},
            "field": {"method": "phase-field", "resolution": 32},
            "surface": {"resolution": 40},
            "pictures": {"width": 160},
            "wall": {"thickness": 1.5},
            "shell": None,
        }
        | changes
    )


def box_file(folder: Path) -> Path:
    path = folder / "box.stl"
    path.write_bytes(trimesh.creation.box((20, 20, 40)).export(file_type="stl"))
    return path


@pytest.fixture(params=["sqlite", "postgresql"])
def database_url(request: pytest.FixtureRequest) -> str:
    """An empty database of each kind that the records can be in; empty text: SQLite in the data folder."""
    return "" if request.param == "sqlite" else str(request.getfixturevalue("postgres").emptied())


@pytest.fixture
def settings(database_url: str, tmp_path: Path) -> Settings:
    return Settings(data_dir=tmp_path / "data", database_url=database_url, redis_url="")


@pytest.fixture
def records(settings: Settings) -> Iterator[Records]:
    records = Records.open(settings)
    yield records
    records.close()


@pytest.fixture
def leases(records: Records) -> Leases:
    return Leases(records)


@pytest.fixture
def domain(records: Records) -> DomainRecord:
    digest = "0" * 64
    return records.add_domain(
        id=digest, sha256=digest, size=1, name="box.stl", suffix=".stl", units="mm", inspection={}
    )


@pytest.fixture
def design(records: Records, domain: DomainRecord) -> DesignRecord:
    return records.create_design(NewDesign(domain.id, small_spec()))[0]


def result_of(step: str) -> StepRecord:
    """A step's result, as far as the records care."""
    return StepRecord((FileRecord(f"{step}.json", f"{len(step):064x}", 7),), {step: 1}, {step: 0.5})


class Cluster:
    """A broker and a worker on one data folder, with a small domain uploaded."""

    def __init__(self, folder: Path, *, behind_proxy: bool = False, **environment: str) -> None:
        self.broker = Broker()
        self.broker.start()
        self.proxy = Proxy(self.broker.socket) if behind_proxy else None  # the worker's way to the broker
        url = self.proxy.url if self.proxy is not None else self.broker.url
        values = {"DUALMS_DATA_DIR": str(folder), "DUALMS_REDIS_URL": url, "OMP_NUM_THREADS": "1"}
        self.environment = {**os.environ, **values, **environment}
        self.settings = Settings(
            data_dir=folder,
            redis_url=self.broker.url,
            **{k.removeprefix("DUALMS_").lower(): v for k, v in environment.items()},  # type: ignore[arg-type]
        )
        self.records = Records.open(self.settings)
        self.store = open_store(self.settings)
        self.wakeups = Wakeups(self.settings)
        self._worker: subprocess.Popen[bytes] | None = None
        self._log = (folder / "worker.log").open("ab")
        path = box_file(folder)
        blob = put_file(self.store, path)
        self.domain = self.records.add_domain(
            id=blob.sha256,
            sha256=blob.sha256,
            size=blob.size,
            name=path.name,
            suffix=".stl",
            units="mm",
            inspection={},
        )

    def start_worker(self, queues: str = "cpu") -> None:
        self._worker = subprocess.Popen(
            [sys.executable, "-m", "worker.main", queues], env=self.environment, stdout=self._log, stderr=self._log
        )

    def stop_worker(self) -> float:
        """Stop politely; returns the seconds that it took."""
        assert self._worker is not None
        began = time.monotonic()
        self._worker.terminate()
        self._worker.wait(30)
        return time.monotonic() - began

    def kill_worker(self) -> None:
        """End the worker and all its processes but the steps, with SIGKILL."""
        assert self._worker is not None
        family = psutil.Process(self._worker.pid).children(recursive=True)
        for process in [p for p in family if not is_step(p)]:
            process.kill()
        self._worker.kill()
        self._worker.wait()

    def steps(self) -> list[psutil.Process]:
        """The step processes at work."""
        return [p for p in psutil.process_iter() if is_step(p, str(self.settings.scratch))]

    def submit(self, **changes: Any) -> DesignRecord:
        record, _ = self.records.create_design(NewDesign(self.domain.id, small_spec(**changes)))
        self.wakeups.send(record)
        return record

    def design(self, design_id: str) -> DesignRecord:
        record = self.records.design(design_id)
        assert record is not None
        return record

    def close(self) -> None:
        if self._worker is not None and self._worker.poll() is None:
            self._worker.send_signal(signal.SIGTERM)
            try:
                self._worker.wait(30)
            except subprocess.TimeoutExpired:
                self.kill_worker()
        self._log.close()
        self.records.close()
        if self.proxy is not None:
            self.proxy.close()
        self.broker.close()


def is_step(process: psutil.Process, scratch: str = "") -> bool:
    try:
        return "worker.step" in process.cmdline() and process.cwd().startswith(scratch)
    except psutil.Error:
        return False


def wait_for(what: Callable[[], Any], seconds: float = 300.0) -> Any:
    """Wait until something holds, and give it."""
    deadline = time.monotonic() + seconds
    while not (value := what()):
        assert time.monotonic() < deadline, "it never came true"
        time.sleep(0.05)
    return value


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    cluster = Cluster(tmp_path_factory.mktemp("cluster"), DUALMS_DRAIN_S="2")
    cluster.start_worker()
    yield cluster
    cluster.close()
