"""Clocks that are set while a design runs, in real processes (libfaketime): nothing is lost, nothing is done twice."""

from __future__ import annotations

import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from tests.worker.conftest import Cluster, wait_for
from worker.host import is_alive, started_at


def faked(clock: Path) -> dict[str, str]:
    """Environment of processes whose clock differs from the machine's by what a file says."""
    spec = find_spec("libfaketime")
    if spec is None or not spec.submodule_search_locations:
        pytest.skip("libfaketime is not installed")
    library = Path(spec.submodule_search_locations[0]) / "vendor" / "libfaketime" / "src" / "libfaketime.so.1"
    return {
        "LD_PRELOAD": str(library),
        "FAKETIME_TIMESTAMP_FILE": str(clock),
        "FAKETIME_NO_CACHE": "1",
        "DONT_FAKE_MONOTONIC": "1",  # setting a real clock does not change it either
    }


def set_clock(clock: Path, hours: int) -> None:
    aside = clock.with_suffix(".new")
    aside.write_text(f"{hours:+d}h\n")
    aside.replace(clock)


@pytest.mark.slow
@pytest.mark.parametrize("hours", [3, -3])
def test_a_clock_that_jumps_loses_nothing(tmp_path: Path, hours: int) -> None:
    clock = tmp_path / "clock"
    set_clock(clock, 0)
    cluster = Cluster(tmp_path, DUALMS_REAP_S="1", **faked(clock))
    try:
        cluster.start_worker()
        made = [cluster.submit(seed=seed) for seed in range(2)]
        wait_for(cluster.steps)
        set_clock(clock, hours)
        wait_for(lambda: cluster.design(made[0].id).step != "prepare")
        # The new worker reads the new clock; to it the old one's lease and heartbeat are hours away.
        cluster.kill_worker()
        cluster.start_worker()
        for design in made:
            final = wait_for(lambda d=design: (now := cluster.design(d.id)).final and now)
            assert final.status == "succeeded", final.error
            events = cluster.records.events(design.id, limit=10_000)
            assert [e.data["step"] for e in events if e.kind in ("step", "succeeded")] == ["prepare", "solve", "build"]
    finally:
        cluster.close()


def test_a_process_is_known_again_whatever_its_neighbours_clock_says(tmp_path: Path) -> None:
    clock = tmp_path / "clock"
    set_clock(clock, 5)
    pid, started = os.getpid(), started_at(os.getpid())
    assert is_alive(pid, started)
    code = f"from worker.host import is_alive; import sys; sys.exit(not is_alive({pid}, {started}))"
    assert subprocess.run([sys.executable, "-c", code], env={**os.environ, **faked(clock)}, check=False).returncode == 0
