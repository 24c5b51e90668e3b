"""Reading an upload in a jailed child: limited address space, CPU and wall time, an empty folder, no environment.

The mesh formats' readers can be made to take gigabytes by a file of a megabyte, and to raise anything; see
``dualms.reading`` for what they check. Whatever happens in the child, the caller gets a record or a ``DualMSError``.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from dualms import errors
from dualms.inspection import Inspection
from dualms.spec import Unit
from worker.settings import Settings

_WALL = 4.0  # wall time over CPU time: the machine may be busy with other things
_OUTPUT_LIMIT = 64 << 20


def inspect_upload(path: Path, filename: str, units: Unit | None, settings: Settings) -> Inspection:
    """Say what a file holds, without trusting it.

    Parameters
    ----------
    path
        The bytes; is only read.
    filename
        Its name at the client; gives the format by its suffix.
    units
        Length unit, where the client names one.
    settings
        For the limits.

    Returns
    -------
    Inspection
        Frozen; ``model_dump(mode="json")`` is what the domain's record keeps.

    Raises
    ------
    DualMSError
        Whatever ``dualms.reading.inspect_file`` refuses; :class:`~dualms.errors.TooLarge` where the child hit a limit;
        :class:`~dualms.errors.UnreadableFile` where it ended in any other way.
    """
    request = {
        "path": str(path.resolve()),
        "suffix": Path(filename).suffix.lower(),
        "units": units.value if units is not None else None,
        "max_faces": settings.max_faces,
        "memory_bytes": settings.inspection_memory_bytes,
        "seconds": settings.inspection_seconds,
    }
    with tempfile.TemporaryDirectory(prefix="dualms-inspect-") as folder:
        try:
            done = subprocess.run(
                [sys.executable, "-I", "-X", "faulthandler=0", "-c", _BOOT, *_import_path()],
                input=json.dumps(request).encode(),
                capture_output=True,
                cwd=folder,
                env={"PATH": "/usr/bin:/bin", "HOME": folder, "TMPDIR": folder, "OMP_NUM_THREADS": "1"}
                | {"OPENBLAS_NUM_THREADS": "1", "NUMBA_CACHE_DIR": folder, "MALLOC_ARENA_MAX": "2"},
                timeout=_WALL * settings.inspection_seconds,
                start_new_session=True,
                check=False,
            )
        except subprocess.TimeoutExpired:
            raise _took_too_long(settings) from None
    return _result(done, settings)


# The packages are found where this process finds them, though the child runs isolated from the environment.
_BOOT = "import sys; sys.path[:0] = sys.argv[1:]; from worker.jail import main; main()"


def _import_path() -> list[str]:
    return [p for p in sys.path if p and Path(p).is_dir()]


def _result(done: subprocess.CompletedProcess[bytes], settings: Settings) -> Inspection:
    answer: dict[str, Any] = {}
    if done.returncode == 0 and len(done.stdout) <= _OUTPUT_LIMIT:
        lines = done.stdout.splitlines()
        answer = json.loads(lines[-1]) if lines else {}
    if "inspection" in answer:
        return Inspection.model_validate(answer["inspection"])
    if "error" in answer:
        kinds = {kind.code: kind for kind in _kinds(errors.DualMSError)}
        error = answer["error"]
        kind = kinds.get(error["code"], errors.UnreadableFile)
        raise kind(error["message"], advice=error["advice"], measured=error["measured"])
    if answer.get("limit") == "memory":
        raise errors.TooLarge(
            f"Reading the file takes more than {settings.inspection_memory_bytes / 2**20:.0f} MiB of memory.",
            advice="Send a mesh with fewer triangles; simplify it first.",
            measured={"limit_bytes": settings.inspection_memory_bytes},
        )
    if done.returncode in (-24, 137, -9):  # SIGXCPU, or killed
        raise _took_too_long(settings)
    raise errors.UnreadableFile(
        "The file cannot be read as a mesh: its reader broke down.",
        advice="Export it again, as binary STL if you can, and check that it opens in another program.",
        measured={"exit_code": done.returncode},
    )


def _took_too_long(settings: Settings) -> errors.TooLarge:
    return errors.TooLarge(
        f"Reading the file takes longer than {settings.inspection_seconds:g} s.",
        advice="Send a mesh with fewer triangles; simplify it first.",
        measured={"limit_s": settings.inspection_seconds},
    )


def _kinds(kind: type[errors.DualMSError]) -> list[type[errors.DualMSError]]:
    return [kind, *(k for sub in kind.__subclasses__() for k in _kinds(sub))]
