"""The GPUs of this machine and their memory, asked of NVIDIA's own program: no process needs torch for it."""

from __future__ import annotations

import shutil
import subprocess
from dataclasses import dataclass

_QUERY = ("--query-gpu=index,name,memory.used,memory.total", "--format=csv,noheader,nounits")
_PATIENCE_S = 5.0
_MIB = 1 << 20


@dataclass(frozen=True)
class Gpu:
    """One CUDA device, and how much of its memory (bytes) is taken, by whomever."""

    index: int
    name: str
    used_bytes: int
    total_bytes: int


def gpus() -> tuple[Gpu, ...]:
    """The devices that answer; none where there is no driver, or it does not answer in time."""
    program = shutil.which("nvidia-smi")
    if program is None:
        return ()
    try:
        done = subprocess.run(
            [program, *_QUERY], capture_output=True, text=True, errors="replace", timeout=_PATIENCE_S, check=False
        )
    except (OSError, subprocess.TimeoutExpired):
        return ()
    if done.returncode != 0:
        return ()
    rows = (line.split(", ") for line in done.stdout.splitlines())
    return tuple(Gpu(int(row[0]), row[1], _bytes(row[2]), _bytes(row[3])) for row in rows if len(row) == 4)


def _bytes(mebibytes: str) -> int:
    """Some devices answer ``[N/A]``."""
    return int(mebibytes) * _MIB if mebibytes.isdigit() else 0
