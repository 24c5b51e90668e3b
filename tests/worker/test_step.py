"""What a step tells its parent when a process that it had started is killed: that it is lost, not that it failed."""

from __future__ import annotations

import os
import signal
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from dualms import beside, pipeline
from worker import step


def killed_in_the_middle(*_: object) -> None:
    with beside.second_process(10**9) as other:
        other.submit(os.kill, other.submit(os.getpid).result(), signal.SIGKILL).result()


@pytest.mark.parametrize(
    ("run", "told"),
    [(killed_in_the_middle, "away"), (lambda *_: 1 / 0, "failure")],
    ids=["killed beside", "an error of its own"],
)
def test_a_killed_second_process_is_no_failure(
    run: Any, told: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(beside, "get_num_threads", lambda: 2)
    monkeypatch.setattr(pipeline, "run_step", run)
    monkeypatch.setattr(step, "Spec", SimpleNamespace(model_validate=lambda spec: spec))
    monkeypatch.setattr(step, "_fetch_inputs", lambda *_: tmp_path)
    job = {"step": "build", "spec": {}, "device": "cpu"}
    assert list(step._outcome(job, SimpleNamespace(send=lambda _: None), threading.Event())) == [told]  # type: ignore[arg-type]
