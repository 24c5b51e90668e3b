"""The API's process stays small: the science is imported by the workers only."""

from __future__ import annotations

import subprocess
import sys

import pytest


@pytest.mark.parametrize("module", ["torch", "numba", "trimesh", "scipy", "matplotlib", "alembic"])
def test_importing_the_app_does_not_import(module: str) -> None:
    code = f"import sys, service.app; sys.exit({module!r} in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_command_line_help_imports_neither_the_app_nor_the_science() -> None:
    heavy = ["fastapi", "numpy", "torch", "sqlalchemy", "celery", "httpx"]
    code = f"import sys, service.cli; sys.exit(any(m in sys.modules for m in {heavy!r}))"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
