"""What the administrator is given agrees with the code."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from service.cli import app
from service.settings import Settings
from worker.settings import Settings as WorkerSettings

ROOT = Path(__file__).parents[2]


def test_dashboard_asks_only_for_metrics_that_there_are() -> None:
    dashboard = json.loads((ROOT / "docker" / "dashboard" / "dualms.json").read_text())
    asked = {
        name
        for panel in dashboard["panels"]
        for target in panel["targets"]
        for name in re.findall(r"dualms_\w+", target["expr"])
    }
    code = (ROOT / "service" / "metrics.py").read_text() + (ROOT / "service" / "system.py").read_text()
    for name in asked:
        assert f'"{re.sub("_(total|bucket)$", "", name)}"' in code, name


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
