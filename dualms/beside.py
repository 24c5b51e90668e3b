"""A second process for half of a step's work.

The libraries that cut, measure and draw hold the interpreter's lock while they work, so threads would take turns.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import fields
from importlib import import_module
from multiprocessing import active_children, get_context, parent_process
from multiprocessing.process import BaseProcess
from typing import ParamSpec, TypeVar

from numba import get_num_threads

P = ParamSpec("P")
T = TypeVar("T")

WORTH_VOXELS = 500_000  # of a grid; below, loading the modules twice costs more than is won


class Passed:
    """A dataclass that goes to another process without what it keeps cached."""

    def __getstate__(self) -> dict[str, object]:
        return {field.name: getattr(self, field.name) for field in fields(self)}  # type: ignore[arg-type]


class Here(Executor):
    """Runs what is submitted in this process, when its result is asked for."""

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """The call that is to come; its exception comes out of the future's ``result``."""
        return _Later(lambda: fn(*args, **kwargs))


class _Later(Future[T]):
    def __init__(self, call: Callable[[], T]) -> None:
        super().__init__()
        self._call = call

    def result(self, timeout: float | None = None) -> T:
        if not self.done():
            self.set_result(self._call())
        return super().result(timeout)


@contextmanager
def second_process(voxels: int, *modules: str) -> Iterator[Executor]:
    """Where to submit what may run beside: a process of its own if that pays and there is a core for it.

    Parameters
    ----------
    voxels
        Of the grid that is worked on.
    modules
        What it loads first.

    Notes
    -----
    The process is started afresh, never forked. It ends with this one, and at once if the block ends by an exception.
    If it is killed from outside, what was submitted raises ``concurrent.futures.process.BrokenProcessPool``. A core
    counts as there for it if numba may use two threads (``NUMBA_NUM_THREADS``).
    """
    if voxels < WORTH_VOXELS or get_num_threads() < 2:
        yield Here()
        return
    others = set(active_children())
    with ProcessPoolExecutor(1, get_context("spawn"), _end_with_parent) as pool:
        pool.submit(_load, modules)
        try:
            yield pool
        except BaseException:
            for child in set(active_children()) - others:
                child.kill()
            raise


def _load(modules: tuple[str, ...]) -> None:
    for name in modules:
        import_module(name)


def _end_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        threading.Thread(target=_end_after, args=(parent,), daemon=True).start()


def _end_after(process: BaseProcess) -> None:
    process.join()
    os._exit(1)
