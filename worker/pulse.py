"""Signs of life of a worker process: when the last message came, and what runs."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager


class Pulse:
    """Shared by the threads of one process."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._touched = time.monotonic()
        self._runs = 0

    def touch(self) -> None:
        """A message came."""
        with self._lock:
            self._touched = time.monotonic()

    @contextmanager
    def busy(self) -> Iterator[None]:
        """A step runs."""
        with self._lock:
            self._runs += 1
        try:
            yield
        finally:
            with self._lock:
                self._runs -= 1
                self._touched = time.monotonic()

    @property
    def runs(self) -> int:
        """Steps that run now."""
        with self._lock:
            return self._runs

    @property
    def quiet_s(self) -> float:
        """Seconds since the last message or the last end of a step."""
        with self._lock:
            return time.monotonic() - self._touched
