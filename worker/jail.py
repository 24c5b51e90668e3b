"""The child of :mod:`worker.inspection`: takes its limits first, then reads the mesh."""

from __future__ import annotations

import ctypes
import json
import math
import resource
import sys
from pathlib import Path
from typing import Any

_CLONE_NEWUSER, _CLONE_NEWNET = 0x10000000, 0x40000000  # linux/sched.h


def main() -> None:
    """Read a request from stdin, write one line of JSON to stdout."""
    request = json.load(sys.stdin)
    _limit(request)
    answer = _answer(request)
    sys.stdout.write("\n" + json.dumps(answer) + "\n")
    sys.stdout.flush()


def _limit(request: dict[str, Any]) -> None:
    _leave_the_network()
    memory, seconds = int(request["memory_bytes"]), math.ceil(request["seconds"])
    resource.setrlimit(resource.RLIMIT_AS, (memory, memory))
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 5))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 20, 1 << 20))


def _leave_the_network() -> None:
    """Into a network namespace without devices, where the kernel lets us (Linux: root, or user namespaces)."""
    if sys.platform == "linux":
        unshare = ctypes.CDLL(None).unshare
        if unshare(_CLONE_NEWNET) != 0:
            unshare(_CLONE_NEWUSER | _CLONE_NEWNET)


def _answer(request: dict[str, Any]) -> dict[str, Any]:
    from dualms.errors import DualMSError
    from dualms.reading import inspect_file
    from dualms.spec import Unit

    try:
        found = inspect_file(
            Path(request["path"]),
            Unit(request["units"]) if request["units"] is not None else None,
            max_faces=request["max_faces"],
            suffix=request["suffix"],
        )
    except DualMSError as error:
        return {
            "error": {
                "code": error.code,
                "message": error.message,
                "advice": error.advice,
                "measured": error.measured,
            }
        }
    except MemoryError:
        return {"limit": "memory"}
    return {"inspection": found.model_dump(mode="json")}
