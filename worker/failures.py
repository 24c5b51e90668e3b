"""What an exception becomes in the record: a stable code, a message that is safe to show, advice.

A ``DualMSError`` is shown as it is. Anything else is logged under an id, and the client gets the id.
"""

from __future__ import annotations

import logging
import secrets
from dataclasses import asdict, dataclass, field
from typing import Any

from dualms.errors import DualMSError

log = logging.getLogger(__name__)

GPU_OUT_OF_MEMORY = "gpu-out-of-memory"
STORE_FULL = "store-full"


@dataclass(frozen=True)
class Failure:
    """Why a design failed.

    Parameters
    ----------
    code
        Stable, for programs: a ``DualMSError``'s, or one of ``memory-limit time-limit deadline-exceeded worker-lost
        gpu-out-of-memory store-full internal-error``.
    message, advice
        What is wrong, and what to try; safe to show.
    measured
        The figures behind the message.
    id
        Under which the log has the details; None where there are no more.
    """

    code: str
    message: str
    advice: str = ""
    measured: dict[str, Any] = field(default_factory=dict)
    id: str | None = None

    def as_json(self) -> dict[str, Any]:
        """As the record keeps it."""
        return asdict(self)


def failure_of(error: BaseException) -> Failure:
    """The failure that an exception stands for; what is not safe to show is logged here, with its traceback."""
    if isinstance(error, DualMSError):
        return Failure(error.code, error.message, error.advice, error.measured)
    if isinstance(error, MemoryError):
        return Failure("memory-limit", "The step ran out of memory.", "Use a smaller resolution or fewer sites.")
    if type(error).__name__ == "OutOfMemoryError" and type(error).__module__.startswith("torch"):
        return Failure(
            GPU_OUT_OF_MEMORY, "The GPU has too little free memory.", "Use fewer points or a smaller network."
        )
    mark = secrets.token_hex(8)
    log.error("failure %s", mark, exc_info=error)
    return Failure(
        "internal-error",
        f"DualMS failed unexpectedly. The server's log has the details under {mark}.",
        "Send the request again; if it fails again, report the id.",
        id=mark,
    )


def memory_limit(limit_bytes: int, used_bytes: int) -> Failure:
    """The step took more memory than it may."""
    return Failure(
        "memory-limit",
        f"The step took {used_bytes / 2**20:.0f} MiB of memory; the limit is {limit_bytes / 2**20:.0f} MiB.",
        "Use a smaller resolution or fewer sites, or raise DUALMS_STEP_MEMORY_BYTES.",
        {"limit_bytes": limit_bytes, "used_bytes": used_bytes},
    )


def time_limit(limit_s: float) -> Failure:
    """The step took more time than it may."""
    return Failure(
        "time-limit",
        f"The step took longer than {limit_s:g} s.",
        "Use a smaller resolution or fewer iterations, or raise DUALMS_STEP_SECONDS.",
        {"limit_s": limit_s},
    )


def deadline_exceeded(deadline_s: float) -> Failure:
    """The design did not end in the time that its sender gave it."""
    return Failure(
        "deadline-exceeded",
        f"The design did not end within its deadline of {deadline_s:.0f} s.",
        "Give it more time with deadline_s, or send it when fewer designs wait.",
        {"deadline_s": round(deadline_s, 3)},
    )


def worker_lost(step: str, tries: int, reason: str) -> Failure:
    """The step's process ended from outside as often as is allowed."""
    return Failure(
        "worker-lost",
        f"The step {step} was started {tries} times and never came to its end; the last time: {reason}.",
        "If the machine is short of memory, use a smaller resolution; else look at the worker's log.",
        {"tries": tries},
    )
