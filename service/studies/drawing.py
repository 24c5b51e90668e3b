"""The picture of a study, drawn in a child process, so that this one never loads matplotlib."""

from __future__ import annotations

import hashlib
import subprocess
import sys
import threading
from functools import lru_cache

from dualms.study.table import Table
from service.problems import Problem

SECONDS = 60.0
_DRAWING = threading.Lock()  # one at a time: each takes a core for a second


def picture_etag(table: Table) -> str:
    """Changes with what is drawn."""
    return f'"{hashlib.sha256(table.to_json().encode()).hexdigest()[:32]}"'


def picture(table: Table) -> bytes:
    """The picture as PNG; the last ones are kept.

    Raises
    ------
    Problem
        ``not-ready`` if it takes too long.
    """
    with _DRAWING:
        return _drawn(table.to_json())


@lru_cache(maxsize=32)
def _drawn(document: str) -> bytes:
    command = [sys.executable, "-m", "dualms.study.picture"]
    try:
        done = subprocess.run(command, input=document.encode(), capture_output=True, timeout=SECONDS, check=True)
    except subprocess.TimeoutExpired:
        detail = f"The picture was not drawn within {SECONDS:.0f} s."
        raise Problem("not-ready", detail, "Try again in a moment.", headers={"Retry-After": "10"}) from None
    return done.stdout
