"""The one retry loop: for records that are away for a moment (a locked file, a database that restarts)."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from typing import TypeVar

from sqlalchemy.exc import InterfaceError, OperationalError

T = TypeVar("T")
AWAY = (OperationalError, InterfaceError)
log = logging.getLogger(__name__)


def patiently(call: Callable[[], T], seconds: float) -> T:
    """Call something until the records answer.

    Parameters
    ----------
    call
        Harmless to repeat: all writes of a worker are fenced.
    seconds
        After so long the last error passes.
    """
    deadline = time.monotonic() + seconds
    pause = 0.2
    while True:
        try:
            return call()
        except AWAY as error:
            if time.monotonic() + pause > deadline:
                raise
            log.warning("the records are away, trying again: %s", error)
        time.sleep(pause)
        pause = min(2 * pause, 5.0)
