"""A team's cluster: API, broker, PostgreSQL, S3 and two workers, each on a machine of its own that knows three URLs."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import psutil
from sqlalchemy import select

from tests.broker import Broker
from tests.machines import Machines
from tests.postgres import Postgres
from tests.s3 import S3
from worker import tables
from worker.records import Records
from worker.settings import Settings

WORKERS = ("one", "two")
NAMES = ("api", "broker", "base", "store", *WORKERS)
PORT = 8000
_ASK = """
import json, sys, httpx
method, url, arguments = json.load(sys.stdin)
if "upload" in arguments:
    arguments["files"] = {"file": ("box.stl", bytes.fromhex(arguments.pop("upload")))}
answer = httpx.request(method, url, timeout=60, **arguments)
answer.raise_for_status()
print(answer.text)
"""


class Team:
    """The cluster, running.

    Parameters
    ----------
    folder
        For data folders and logs.
    settings
        Environment variables of the API and the workers.
    """

    def __init__(self, folder: Path, **settings: str) -> None:
        self.folder = folder
        self.machines = Machines(NAMES)
        self._processes: list[subprocess.Popen[bytes]] = []
        self._servers: list[Broker | Postgres | S3] = []
        self._records: Records | None = None
        try:
            self._start_all(settings)
        except BaseException:
            self.close()
            raise

    def _start_all(self, settings: dict[str, str]) -> None:
        at = self.machines
        broker = Broker(at.address("broker"), at.on("broker"))
        postgres = Postgres(at.address("base"), at.on("base"))
        s3 = S3(at.address("store"), at.on("store"))
        for server in (broker, postgres, s3):
            self._servers.append(server)
            server.start()
        own = {k: v for k, v in os.environ.items() if not k.startswith("DUALMS_")}
        urls = {
            "DUALMS_DATABASE_URL": postgres.emptied(),
            "DUALMS_REDIS_URL": broker.url,
            "DUALMS_STORE_URL": s3.url,
        }
        environment = {**own, **s3.environment, **urls, "OMP_NUM_THREADS": "1", **settings}
        serving = f"import uvicorn; uvicorn.run('service.app:create_app', factory=True, host='0.0.0.0', port={PORT})"
        self._start("api", environment, "-c", serving)
        for name in WORKERS:
            self._start(name, environment, "-m", "worker.main", "cpu")
        self._records = Records.open(Settings(data_dir=self.folder, database_url=postgres.from_here(), redis_url=""))

    def _start(self, name: str, environment: dict[str, str], *words: str) -> None:
        environment = {**environment, "DUALMS_DATA_DIR": str(self.folder / name)}
        with (self.folder / f"{name}.log").open("ab") as log:
            command = [*self.machines.on(name), sys.executable, *words]
            self._processes.append(subprocess.Popen(command, env=environment, stdout=log, stderr=log))

    def ask(self, method: str, path: str, **arguments: Any) -> Any:
        """What the API answers to a request from its own machine, repeated until it listens."""
        request = json.dumps([method, f"http://127.0.0.1:{PORT}{path}", arguments]).encode()
        command = [*self.machines.on("api"), sys.executable, "-c", _ASK]
        deadline = time.monotonic() + 120
        while True:
            done = subprocess.run(command, input=request, capture_output=True, check=False)
            if done.returncode == 0:
                return json.loads(done.stdout)
            if time.monotonic() > deadline:
                raise TimeoutError(done.stderr.decode()[-2000:] + self.log("api")[-2000:])
            time.sleep(0.5)

    @property
    def records(self) -> Records:
        """The records, seen from outside."""
        assert self._records is not None
        return self._records

    def holder(self, design_id: str) -> str | None:
        """The machine whose worker has the lease of a design."""
        w, d = tables.Worker, tables.Design
        with self.records.database.read() as session:
            pid = session.scalars(select(w.pid).join(d, d.worker_id == w.id).where(d.id == design_id)).first()
        return Path(psutil.Process(pid).environ()["DUALMS_DATA_DIR"]).name if pid is not None else None

    def log(self, name: str) -> str:
        """What a machine's process has printed."""
        return (self.folder / f"{name}.log").read_text(errors="replace")

    def close(self) -> None:
        if self._records is not None:
            self._records.close()
        for process in self._processes:
            process.terminate()
        for process in self._processes:
            try:
                process.wait(40)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        for server in self._servers:
            server.close()
        self.machines.close()
