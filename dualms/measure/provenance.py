"""What made a design, exactly: versions, seed, hashes."""

from __future__ import annotations

import hashlib
import platform
from importlib.metadata import version as installed
from typing import Any

from dualms import __version__
from dualms.field.field import Field
from dualms.measure.figures import Figures
from dualms.spec import Spec

LIBRARIES = ("numpy", "scipy", "scikit-image", "trimesh", "manifold3d", "libigl", "torch", "numba", "pyamg")


class Provenance(Figures):
    """What made this, exactly.

    ``files_sha256`` holds the files written before the report: a line of ``sha256sum`` proves that one belongs to it.
    """

    version: str
    seed: int
    domain_sha256: str
    spec_sha256: str
    files_sha256: dict[str, str]
    spec: dict[str, Any]
    device: str
    field_method: str
    libraries: dict[str, str]
    python: str


def provenance(spec: Spec, domain_sha256: str, field: Field) -> Provenance:
    """The provenance of a design whose files are yet to be written."""
    return Provenance(
        version=__version__,
        seed=spec.seed,
        domain_sha256=domain_sha256,
        spec_sha256=hashlib.sha256(spec.model_dump_json().encode()).hexdigest(),
        files_sha256={},
        spec=spec.model_dump(mode="json"),
        device=field.device,
        field_method=field.method,
        libraries={name: installed(name) for name in LIBRARIES},
        python=platform.python_version(),
    )
