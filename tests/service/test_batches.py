"""Looks are shared, and none is older than its question."""

from __future__ import annotations

import asyncio
import time

import pytest

from service.batches import Batches, Busy


def test_questions_at_the_same_time_share_a_look() -> None:
    looks: list[list[str]] = []

    def read(keys: list[str]) -> dict[str, int]:
        looks.append(sorted(keys))
        time.sleep(0.05)
        return {key: len(looks) for key in keys if key != "gone"}

    async def ask() -> list[int | None]:
        batches = Batches(read)
        first = asyncio.create_task(batches.get("a"))
        await asyncio.sleep(0.02)  # the first look is under way: these must not be answered by it
        later = [asyncio.create_task(batches.get(key)) for key in ("a", "b", "b", "gone")]
        return [await first, *(await asyncio.gather(*later))]

    assert asyncio.run(ask()) == [1, 2, 2, 2, None]
    assert looks == [["a"], ["a", "b", "gone"]]


def test_a_look_that_fails_tells_all_who_asked_and_the_next_works() -> None:
    fail = [True]

    def read(keys: list[str]) -> dict[str, int]:
        if fail.pop() if fail else False:
            raise OSError("away")
        return dict.fromkeys(keys, 1)

    async def ask() -> int | None:
        batches = Batches(read)
        results = await asyncio.gather(batches.get("a"), batches.get("b"), return_exceptions=True)
        assert all(isinstance(r, OSError) for r in results)
        return await batches.get("a")

    assert asyncio.run(ask()) == 1


def test_one_who_stops_waiting_does_not_disturb_the_others() -> None:
    def read(keys: list[str]) -> dict[str, int]:
        time.sleep(0.05)
        return dict.fromkeys(keys, 1)

    async def ask() -> int | None:
        batches = Batches(read)
        impatient = asyncio.create_task(batches.get("a"))
        patient = asyncio.create_task(batches.get("a"))
        await asyncio.sleep(0.01)
        impatient.cancel()
        with pytest.raises(asyncio.CancelledError):
            await impatient
        return await patient

    assert asyncio.run(ask()) == 1


def test_a_quick_look_that_would_wait_is_made_in_a_thread() -> None:
    def quick(key: str) -> int | None:
        if key == "locked":
            raise Busy
        return 1

    async def ask() -> list[int | None]:
        batches = Batches(lambda keys: dict.fromkeys(keys, 2), quick)
        return [await batches.get("free"), await batches.get("locked")]

    assert asyncio.run(ask()) == [1, 2]
