"""Which science code this is: results of one code must not be mixed with those of another."""

from __future__ import annotations

import hashlib
from functools import cache
from pathlib import Path

import dualms


@cache
def code_id() -> str:
    """Version and hash of the sources of ``dualms``, as they were when this process first asked."""
    folder = Path(dualms.__file__).parent
    digest = hashlib.sha256()
    for path in sorted(folder.rglob("*.py")):
        digest.update(path.relative_to(folder).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    return f"{dualms.__version__}+{digest.hexdigest()[:16]}"
