"""Schemathesis against the real service: no server error, no answer that the document does not promise."""

from __future__ import annotations

import json
import os
import re
import sys
from pathlib import Path
from subprocess import run
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from conftest import Team

SECONDS = int(os.environ.get("DUALMS_FUZZ_SECONDS", "90"))
HOOKS = Path(__file__).with_name("fuzz_hooks.py")


@pytest.mark.slow
def test_generated_requests_find_no_server_error_and_no_undocumented_answer(
    team: Team, box: Path, spec: dict[str, Any], tmp_path: Path
) -> None:
    client = team.client("fuzz")
    domain = team.upload(client, box).json()["id"]
    (tmp_path / "spec.json").write_text(json.dumps(spec))
    command = [
        sys.executable, "-m", "schemathesis.cli", "run", f"{team.service.url}/openapi.json",
        "--header", f"Authorization: {client.headers['authorization']}",
        # Random bytes are no mesh: that valid forms are accepted is for the other tests to show.
        "--checks", "all", "--exclude-checks", "positive_data_acceptance",
        "--seed", "1", "--max-time", str(SECONDS), "--request-timeout", "90", "--warnings", "off",
    ]  # fmt: skip
    known = {"MESH": str(box), "SPEC": str(tmp_path / "spec.json"), "DOMAIN": domain}
    env = {**os.environ, **{f"DUALMS_FUZZ_{k}": v for k, v in known.items()}, "SCHEMATHESIS_HOOKS": str(HOOKS)}
    done = run(command, capture_output=True, text=True, cwd=tmp_path, env=env, timeout=SECONDS + 400, check=False)
    assert done.returncode == 0, done.stdout[-8000:] + done.stderr[-2000:]
    covered = re.search(r"API Links:\s+(\d+) covered", done.stdout)
    assert covered, "there was no stateful phase"
    assert int(covered[1]) > 0, "no answer led to another request"
    assert "incident" not in (team.service.data / "logs" / "api.log").read_text()
