"""What the administrator is given agrees with the code."""

from __future__ import annotations

import json
import re
import socket
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from service.cli import app
from service.settings import Settings
from worker.settings import Settings as WorkerSettings

if TYPE_CHECKING:
    from conftest import Served

ROOT = Path(__file__).parents[2]


def test_dashboard_asks_only_for_metrics_that_the_service_gives(served: Served) -> None:
    dashboard = json.loads((ROOT / "docker" / "dashboard" / "dualms.json").read_text())
    asked = {
        name
        for panel in dashboard["panels"]
        for target in panel["targets"]
        for name in re.findall(r"dualms_\w+", target["expr"])
    }
    given = set(re.findall(r"^# TYPE (\w+)", served.http.get("/metrics").text, re.M))
    for name in asked:
        assert name in given or re.sub("_(bucket|sum|count)$", "", name) in given, name


def test_dashboard_shows_queue_ages_stages_gpu_memory_and_failures() -> None:
    text = (ROOT / "docker" / "dashboard" / "dualms.json").read_text()
    for name in (
        "queue_waiting",
        "queue_oldest_seconds",
        "stage_seconds_sum",
        "gpu_memory_used_bytes",
        "failures_total",
    ):
        assert f"dualms_{name}" in text


def test_every_line_of_the_logs_is_json_and_names_its_job(served: Served, domain_id: str, spec: dict[str, Any]) -> None:
    spec["fluids"]["hot"]["inlets"][0]["center"] = [0, 0, 0]  # fails at once
    design = served.http.post("/v1/designs", json={"domain": domain_id, "spec": spec}).json()["id"]
    served.ended(design)
    served.http.delete(f"/v1/designs/{design}")
    told: list[tuple[str, int]] = []
    deadline = time.monotonic() + 10
    while len(told) < 2 and time.monotonic() < deadline:  # a line is written after the answer has gone
        lines = {name: _lines(served.data / "logs" / f"{name}.log") for name in ("api", "worker")}
        told = [(x["message"], x["status"]) for x in lines["api"] if x.get("job_id") == design]
    assert told == [("POST /v1/designs", 202), (f"DELETE /v1/designs/{design}", 204)]
    steps = [x["message"] for x in lines["worker"] if x.get("job_id") == design]
    assert "step prepare, try 1" in steps
    for line in (x for some in lines.values() for x in some):
        assert {"time", "level", "logger", "message", "process"} <= set(line)
        assert "job_id" in line or "step" not in line["message"].split()[:1], line


def test_a_client_that_hangs_up_within_its_body_is_no_incident(served: Served) -> None:
    host, port = served.url.removeprefix("http://").split(":")
    log = served.data / "logs" / "api.log"
    before = len(_lines(log))
    head = (
        "POST /v1/designs HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: application/json\r\nContent-Length: 1000\r\n\r\n"
    )
    with socket.create_connection((host, int(port)), timeout=20) as line:
        line.sendall(f'{head}{{"domain":'.encode())
    deadline = time.monotonic() + 20
    told: list[dict[str, Any]] = []
    while not any(x["message"] == "POST /v1/designs" for x in told) and time.monotonic() < deadline:
        time.sleep(0.1)
        told = _lines(log)[before:]
    assert [x["status"] for x in told if x["message"] == "POST /v1/designs"] == [400]
    assert [x for x in told if x["level"] == "error"] == []


def _lines(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text().splitlines(keepends=True) if line.endswith("\n")]


@pytest.mark.parametrize("name", ["docs/team.md", "docker-compose.yml"])
def test_every_setting_that_is_named_exists(name: str) -> None:
    text = (ROOT / name).read_text()
    known = {f"DUALMS_{field.upper()}" for kind in (Settings, WorkerSettings) for field in kind.model_fields}
    known |= {"DUALMS_PORT", "DUALMS_API_KEY", "DUALMS_URL"}  # the compose file's own, and the client's
    for setting in set(re.findall(r"DUALMS_[A-Z_]+[A-Z]", text)):
        assert setting in known, setting


@pytest.mark.parametrize("unit", ["dualms-api.service", "dualms-worker@.service"])
def test_units_run_commands_that_there_are(unit: str) -> None:
    text = (ROOT / "docker" / "systemd" / unit).read_text()
    command = re.search(r"^ExecStart=\S+/dualms (\w+)", text, re.M)
    assert command
    assert command[1] in {c.name or c.callback.__name__ for c in app.registered_commands if c.callback}
    for needed in ("Restart=always", "EnvironmentFile=", "NoNewPrivileges=true", "TimeoutStopSec="):
        assert needed in text
