"""Which machine this is, and whether a process of it still lives."""

from __future__ import annotations

import contextlib
import os
import platform
import sys
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
    """When a process started, in seconds since the machine's boot; with the id and the boot, this names it for ever.

    Not in seconds since 1970, which change for a process that runs when the clock is set: its neighbours would take it
    for another one, and take its work away.

    Raises
    ------
    psutil.NoSuchProcess
        If there is none with this id.
    """
    if sys.platform != "linux":
        return psutil.Process(pid).create_time()
    try:
        stat = Path(f"/proc/{pid}/stat").read_text()
    except (FileNotFoundError, ProcessLookupError):
        raise psutil.NoSuchProcess(pid) from None
    ticks = int(stat.rpartition(")")[2].split()[19])  # field 22; the name, in brackets, may hold anything
    return ticks / os.sysconf("SC_CLK_TCK")


def is_alive(pid: int, started: float) -> bool:
    """Whether the process that had this id and this start is still there."""
    try:
        return abs(started_at(pid) - started) < 0.5 and psutil.Process(pid).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False
