"""Schemathesis against the real service: no server error, no answer that the document does not promise."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from conftest import Served

SECONDS = int(os.environ.get("DUALMS_FUZZ_SECONDS", "60"))


@pytest.mark.slow
def test_generated_requests_find_no_server_error_and_no_undocumented_answer(served: Served, tmp_path: Path) -> None:
    program = shutil.which("st")
    if program is None:
        pytest.skip("Schemathesis is not installed: pip install schemathesis")
    # Random bytes are no mesh: that valid forms are accepted is for the other tests to show.
    command = [
        program, "run", f"{served.url}/openapi.json", "--checks", "all", "--exclude-checks", "positive_data_acceptance",
        "--seed", "1", "--max-time", str(SECONDS), "--request-timeout", "90", "--warnings", "off",
    ]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, timeout=SECONDS + 240, check=False)
    assert done.returncode == 0, done.stdout[-6000:]
