"""What a GPU holds is what its driver's program says; a machine without one has none."""

from __future__ import annotations

from pathlib import Path

import pytest

from worker.gpus import Gpu, gpus
from worker.records import Records
from worker.station import Registration


def driver(folder: Path, answer: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A program that answers as nvidia-smi does."""
    program = folder / "nvidia-smi"
    program.write_text(f"#!/bin/sh\n{answer}\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{folder}:/usr/bin:/bin")


def test_memory_is_read_in_bytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    driver(tmp_path, 'echo "0, NVIDIA RTX A6000, 1024, 49140"; echo "1, NVIDIA GB10, [N/A], [N/A]"', monkeypatch)
    first = Gpu(0, "NVIDIA RTX A6000", 1 << 30, 49140 << 20)
    assert gpus() == (first, Gpu(1, "NVIDIA GB10", 0, 0))


@pytest.mark.parametrize("answer", ["echo No devices were found; exit 6", "echo nonsense", "exit 9"])
def test_a_driver_that_does_not_work_means_no_device(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, answer: str
) -> None:
    driver(tmp_path, answer, monkeypatch)
    assert gpus() == ()


def test_a_gpu_worker_tells_its_memory_with_each_heartbeat(
    records: Records, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    driver(tmp_path, 'echo "0, NVIDIA L4, 10, 23034"', monkeypatch)
    registration = Registration(records, "gpu", 1)
    driver(tmp_path, 'echo "0, NVIDIA L4, 20, 23034"', monkeypatch)
    registration.beat()
    (worker,) = records.workers()
    assert [gpu["used_bytes"] for gpu in worker.facts["gpus"]] == [20 << 20]
