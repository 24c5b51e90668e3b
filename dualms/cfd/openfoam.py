"""Finds OpenFOAM and runs its programs, one process at a time, with live output and cooperative stopping."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from dualms.errors import EvaluationUnavailable

ADVICE = "Install OpenFOAM (Debian or Ubuntu: apt-get install openfoam), or ask for no evaluation."
NEEDED = ("simpleFoam",)
_SHARES = ("/usr/share/openfoam", "/opt/openfoam")


@dataclass(frozen=True)
class OpenFoam:
    """An installation.

    Parameters
    ----------
    version
        As the programs state it, such as ``1912``.
    programs
        Folder of the programs.
    share
        The project folder (WM_PROJECT_DIR), which holds ``etc``.
    """

    version: str
    programs: Path
    share: Path

    def run(
        self, program: str, case: Path, on_line: Callable[[str], None] | None = None, arguments: tuple[str, ...] = ()
    ) -> int:
        """Run a program on a case; its output goes to ``log.PROGRAM`` in the case.

        Parameters
        ----------
        program
            Such as ``simpleFoam``.
        case
            The case's folder.
        on_line
            Called with each line of output; what it raises ends the program and is passed on.
        arguments
            More arguments.

        Returns
        -------
        int
            The program's exit code; negative for a signal.
        """
        command = [str(self.programs / program), "-case", str(case), *arguments]
        environment = dict(os.environ, WM_PROJECT_DIR=str(self.share), FOAM_SIGFPE="true", OMP_NUM_THREADS="1")
        with (
            (case / f"log.{program}").open("w") as log,
            subprocess.Popen(
                command,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                stdin=subprocess.DEVNULL,
                text=True,
                errors="replace",
                env=environment,
                start_new_session=True,
            ) as process,
        ):
            if process.stdout is None:
                raise RuntimeError("the program's output is not connected")
            try:
                for line in process.stdout:
                    log.write(line)
                    if on_line is not None:
                        on_line(line.rstrip("\n"))
            except BaseException:
                os.killpg(process.pid, signal.SIGKILL)
                raise
            return process.wait()


@lru_cache(maxsize=1)
def find_openfoam() -> OpenFoam | None:
    """Look for OpenFOAM: on the path, in WM_PROJECT_DIR, and where Debian puts it.

    Returns
    -------
    OpenFoam or None
        None if a needed program or the project folder is missing, or the programs do not start.
    """
    found = shutil.which(NEEDED[0])
    if found is None:
        return None
    programs = Path(found).parent
    shares = [os.environ.get("WM_PROJECT_DIR", ""), *_SHARES, *sorted(map(str, Path("/usr/lib/openfoam").glob("*")))]
    share = next((Path(s) for s in shares if s and (Path(s) / "etc" / "controlDict").is_file()), None)
    if share is None or not all((programs / name).exists() for name in NEEDED):
        return None
    try:
        told = subprocess.run(
            [found, "-help"],
            capture_output=True,
            text=True,
            timeout=30,
            check=True,
            env=dict(os.environ, WM_PROJECT_DIR=str(share)),
        ).stdout
    except (OSError, subprocess.SubprocessError):
        return None
    version = re.search(r"OpenFOAM-\s*\(?v?(\w+)\)?", told)
    return OpenFoam(version.group(1) if version else "unknown", programs, share)


def require_openfoam() -> OpenFoam:
    """The installation.

    Raises
    ------
    EvaluationUnavailable
        If there is none.
    """
    found = find_openfoam()
    if found is None:
        raise EvaluationUnavailable("OpenFOAM's simpleFoam was not found on this machine.", advice=ADVICE)
    return found
