"""Who goes first: uploads a few at a time, and what counts against one owner's quotas one after the other."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from typing import TypeVar

from anyio import CapacityLimiter, to_thread

T = TypeVar("T")


class Turns:
    """Turns within one API process.

    Parameters
    ----------
    uploads
        How many are read at once: each may take a core and the memory of its jail. The others wait on disk, and without
        a thread, so that everything else is answered meanwhile.
    """

    def __init__(self, uploads: int) -> None:
        self._uploads = CapacityLimiter(uploads)
        self._owners: dict[str, threading.Lock] = {}

    async def upload(self, call: Callable[[], T]) -> T:
        """Call something in a thread, when it is its turn."""
        return await to_thread.run_sync(call, limiter=self._uploads)

    def of(self, owner: str | None) -> AbstractContextManager[object]:
        """Nobody else of this owner within the block: what was found free is still free at its end."""
        return self._owners.setdefault(owner, threading.Lock()) if owner is not None else nullcontext()
