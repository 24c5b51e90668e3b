"""Which machine this is, and whether a process of it still lives."""

from __future__ import annotations

import contextlib
import os
import platform
from pathlib import Path

import psutil


def this_host() -> str:
    """Name, boot and process namespace: where this string is the same, a process id means the same process."""
    parts = [platform.node()]
    with contextlib.suppress(OSError):
        parts.append(Path("/proc/sys/kernel/random/boot_id").read_text().strip())
    with contextlib.suppress(OSError):
        parts.append(os.readlink("/proc/self/ns/pid"))
    return "/".join(parts)


def started_at(pid: int) -> float:
    """When a process started; with the id, this names it for ever."""
    return psutil.Process(pid).create_time()


def is_alive(pid: int, started: float) -> bool:
    """Whether the process that had this id and this start is still there."""
    try:
        process = psutil.Process(pid)
        return abs(process.create_time() - started) < 2.0 and process.status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False
