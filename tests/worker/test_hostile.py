"""Every file that was made to break a reader is refused: within 30 s and 1.5 GB, and nothing is left behind.

python -m pytest -m slow tests/worker/test_hostile.py
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from dualms.spec import Unit
from tests.hostile import FILES, TETRAHEDRON, built, model, tetrahedron
from worker.inspection import inspect_upload
from worker.settings import Settings

SECONDS, BYTES = 30.0, 1_500_000_000

# The jailed child and its figures, in a process of its own: what its children took together is then this one child's.
READ = """
import json, resource, sys
from pathlib import Path
from dualms.errors import DualMSError
from dualms.spec import Unit
from worker.inspection import inspect_upload
from worker.settings import Settings
try:
    inspect_upload(Path(sys.argv[1]), sys.argv[1], Unit.MM, Settings())
    code, advice = "accepted", ""
except DualMSError as error:
    code, advice = error.code, error.advice
used = resource.getrusage(resource.RUSAGE_CHILDREN)
print(json.dumps([code, advice, used.ru_utime + used.ru_stime, used.ru_maxrss * 1024]))
"""

# A quick few in every run; the whole corpus where slow tests run.
QUICK = {"archive with a forged size", "XML of components that hold themselves", "glTF with 100,000 copies of a body"}


@pytest.mark.parametrize("name", [n if n in QUICK else pytest.param(n, marks=pytest.mark.slow) for n in FILES])
def test_hostile_file_is_refused_in_time_and_memory(tmp_path: Path, name: str) -> None:
    suffix, write = FILES[name]
    path = tmp_path / f"hostile{suffix}"
    write(path)
    done = subprocess.run(
        [sys.executable, "-c", READ, str(path)], capture_output=True, text=True, cwd=tmp_path, check=True
    )
    left = [p.name for p in tmp_path.iterdir()]
    path.unlink()  # some are large, and test folders are kept
    code, advice, seconds, memory = json.loads(done.stdout)
    assert code in ("unreadable-file", "too-large", "invalid-mesh"), code
    assert advice
    assert seconds < SECONDS, "of processor time: a busy machine takes longer by the clock"
    assert memory < BYTES
    assert left == [path.name]
    assert not Path("/tmp/hostile").exists()


def test_the_limits_are_those_that_are_promised() -> None:
    settings = Settings()
    assert settings.inspection_seconds < SECONDS
    assert settings.inspection_memory_bytes <= 3 << 29


def test_the_same_file_without_malice_is_read(tmp_path: Path) -> None:
    for name, write in (("good.3mf", model(built(TETRAHEDRON))), ("good.glb", tetrahedron())):
        write(tmp_path / name)
        assert inspect_upload(tmp_path / name, name, Unit.MM, Settings()).volume == pytest.approx(9**3 / 6)
