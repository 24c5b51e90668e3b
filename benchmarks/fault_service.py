"""A service to be killed: ``dualms serve`` on a fixed port, its parts by name, requests repeated until answered."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import httpx
import psutil

PARTS = {
    "api": "dualms-api",
    "worker": "worker.station",
    "step": "worker.step",
    "broker": "valkey-server",
}
ANSWERED_S = 900.0


class Service:
    """``dualms serve``, started again where it was killed."""

    def __init__(self, folder: Path, **settings: str) -> None:
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self.port = int(probe.getsockname()[1])
        self.url = f"http://127.0.0.1:{self.port}"
        own = {k: v for k, v in os.environ.items() if not k.startswith("DUALMS_")}
        self._environment = {**own, "OMP_NUM_THREADS": "1", **settings}
        self._command = [sys.executable, "-m", "service.cli", "serve", "--data", str(folder), "--queues", "cpu"]
        self._command += ["--port", str(self.port)]
        self._client = httpx.Client(timeout=30)
        self._folder = str(folder)
        self._log = folder.parent / "serve.log"
        self._process: subprocess.Popen[bytes] | None = None

    def start_if_dead(self) -> None:
        """Start it, if it does not run."""
        if self._process is None or self._process.poll() is not None:
            with self._log.open("ab") as log:
                self._process = subprocess.Popen(self._command, env=self._environment, stdout=log, stderr=log)

    def processes(self) -> dict[str, list[psutil.Process]]:
        """The running processes of each part; ``all``: every process of the service."""
        found: dict[str, list[psutil.Process]] = {part: [] for part in (*PARTS, "all")}
        if self._process is None or self._process.poll() is not None:
            return found
        try:
            top = psutil.Process(self._process.pid)
            found["all"] = [top, *top.children(recursive=True)]
        except psutil.NoSuchProcess:
            return found
        for process in found["all"][1:]:
            for part, words in PARTS.items():
                if _is(process, words):
                    found[part].append(process)
                    break
        return found

    def answers(self) -> bool:
        """Whether the API answers now."""
        try:
            return self._client.get(f"{self.url}/healthz", timeout=0.3).status_code == 200
        except httpx.TransportError:
            return False

    def ask(self, method: str, path: str, **arguments: Any) -> httpx.Response:
        """A request, repeated until it is answered; refusing and failing are no answers here."""
        deadline = time.monotonic() + ANSWERED_S
        while True:
            try:
                answer = self._client.request(method, f"{self.url}/v1{path}", **arguments)
                if answer.status_code < 500 and answer.status_code != 429:
                    answer.raise_for_status()
                    return answer
            except httpx.TransportError:
                pass
            if time.monotonic() > deadline:
                raise TimeoutError(f"{method} {path} was not answered")
            time.sleep(0.2)

    def stop(self) -> None:
        """End it politely, then for sure."""
        self._client.close()
        if self._process is not None and self._process.poll() is None:
            self._process.send_signal(signal.SIGTERM)
            try:
                self._process.wait(60)
            except subprocess.TimeoutExpired:
                for process in self.processes()["all"]:
                    process.kill()

    def left_behind(self) -> list[psutil.Process]:
        """Processes of this service that still run; none should once it has stopped."""
        found = []
        for process in psutil.process_iter():
            try:
                if process.environ().get("DUALMS_DATA_DIR") == self._folder and process.is_running():
                    found.append(process)
            except psutil.Error:
                continue
        return found


def design_of(step: psutil.Process) -> str | None:
    """The design that a step process works for, from its folder's name."""
    try:
        return Path(step.cwd()).name.split("-")[3]
    except (psutil.Error, IndexError):
        return None


def _is(process: psutil.Process, words: str) -> bool:
    try:
        return words in " ".join([process.name(), *process.cmdline()])
    except psutil.Error:
        return False
