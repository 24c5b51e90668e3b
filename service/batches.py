"""One look at the records for all who ask at the same time.

A status poll costs a thread and a query; under load many come at once. Whoever asks while a look is under way is served
by the next, which begins after the question came: nothing that is answered is older than its question.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from typing import Generic, TypeVar

T = TypeVar("T")


class Busy(Exception):
    """A quick look would have to wait."""


class Batches(Generic[T]):
    """Gathers keys, and reads the values of all that have gathered in one call.

    Parameters
    ----------
    read
        Gives the values of keys; what is gone is missing. Called in a thread.
    quick
        Gives the value of one key within microseconds, or raises ``Busy``; called at once, where there is such a way.
    """

    def __init__(
        self, read: Callable[[list[str]], Mapping[str, T]], quick: Callable[[str], T | None] | None = None
    ) -> None:
        self._read, self._quick = read, quick
        self._asked: dict[str, list[asyncio.Future[T | None]]] = {}
        self._task: asyncio.Task[None] | None = None

    async def get(self, key: str) -> T | None:
        """The value of a key, or None."""
        if self._quick is not None:
            try:
                return self._quick(key)
            except Busy:
                pass  # then by a thread, which may wait
        future: asyncio.Future[T | None] = asyncio.get_running_loop().create_future()
        self._asked.setdefault(key, []).append(future)
        if self._task is None:
            self._task = asyncio.create_task(self._drain())
        return await future

    async def _drain(self) -> None:
        try:
            while self._asked:
                asked, self._asked = self._asked, {}
                try:
                    found = await asyncio.to_thread(self._read, list(asked))
                except Exception as error:  # noqa: BLE001 - whoever asked gets it, and the app's handlers know it
                    for future in (f for futures in asked.values() for f in futures if not f.done()):
                        future.set_exception(error)
                else:
                    for key, futures in asked.items():
                        for future in (f for f in futures if not f.done()):
                            future.set_result(found.get(key))
        finally:
            self._task = None
