"""Waiting for designs to change: one query for all who wait, however many they are."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections import defaultdict
from collections.abc import Callable, Mapping

log = logging.getLogger("dualms.service")

Versions = Callable[[list[str]], Mapping[str, int]]


class Watch:
    """Looks at the versions of the designs that somebody waits for, and wakes the waiters of those that changed.

    Parameters
    ----------
    versions
        Gives the versions of designs; ids that are gone are missing. Called in a thread.
    interval_s
        Time between two looks while somebody waits.
    """

    def __init__(self, versions: Versions, interval_s: float) -> None:
        self._versions, self._interval_s = versions, interval_s
        self._waiting: dict[str, set[tuple[int, asyncio.Future[None]]]] = defaultdict(set)
        self._somebody = asyncio.Event()
        self._task: asyncio.Task[None] | None = None

    @property
    def waiters(self) -> int:
        """How many wait now."""
        return sum(len(w) for w in self._waiting.values())

    async def __aenter__(self) -> Watch:
        self._task = asyncio.create_task(self._look())
        return self

    async def __aexit__(self, *_: object) -> None:
        if self._task is not None:
            self._task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._task
        for waiters in self._waiting.values():
            for _version, future in waiters:
                if not future.done():
                    future.set_result(None)

    async def change(self, design_id: str, version: int, timeout_s: float) -> bool:
        """Wait until a design's version differs from ``version``; False if it did not in time."""
        future: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        waiter = (version, future)
        self._waiting[design_id].add(waiter)
        self._somebody.set()
        try:
            async with asyncio.timeout(timeout_s):
                await future
        except TimeoutError:
            return False
        finally:
            self._waiting[design_id].discard(waiter)
            if not self._waiting[design_id]:
                del self._waiting[design_id]
        return True

    async def _look(self) -> None:
        while True:
            await self._somebody.wait()
            if not self._waiting:
                self._somebody.clear()
                continue
            try:
                versions = await asyncio.to_thread(self._versions, list(self._waiting))
            except Exception:  # the store may be locked or away for a moment; whoever waits goes on waiting
                log.exception("cannot look for changes")
                versions = {i: v for i, waiters in self._waiting.items() for v, _ in waiters}
            for design_id, waiters in list(self._waiting.items()):
                for version, future in waiters:
                    if versions.get(design_id) != version and not future.done():
                        future.set_result(None)
            await asyncio.sleep(self._interval_s)
