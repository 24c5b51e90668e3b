"""The API's process stays small: the science is imported by the workers only."""

from __future__ import annotations

import subprocess
import sys

import pytest


@pytest.fixture(scope="module")
def loaded() -> set[str]:
    """What importing the app has imported."""
    code = "import sys, service.app; print(*sys.modules)"
    return set(subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout.split())


@pytest.mark.parametrize("module", ["torch", "numba", "trimesh", "scipy", "matplotlib", "alembic"])
def test_importing_the_app_does_not_import(loaded: set[str], module: str) -> None:
    assert "service.app" in loaded
    assert module not in loaded


def test_command_line_help_imports_neither_the_app_nor_the_science() -> None:
    heavy = ["fastapi", "numpy", "torch", "sqlalchemy", "celery", "httpx"]
    code = f"import sys, service.cli; sys.exit(any(m in sys.modules for m in {heavy!r}))"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
