"""Three floors, one direction: the contracts hold, and the service never loads what it does not need."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent


def test_import_contracts_hold() -> None:
    lint = Path(sys.executable).with_name("lint-imports")
    result = subprocess.run([lint], cwd=ROOT, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stdout


@pytest.mark.parametrize("module", ["service.app", "service.cli", "worker.tasks", "worker.main"])
def test_a_floor_above_the_science_does_not_load_it(module: str) -> None:
    code = f"import sys, {module}; print(*sorted({{'torch', 'numba', 'igl', 'mitsuba'}} & set(sys.modules)))"
    result = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert result.stdout.strip() == ""
