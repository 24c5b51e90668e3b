"""Which mesh formats a design comes in."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from dualms.spec.model import Model

MeshFormat = Literal["obj", "vtu"]


class OutputSpec(Model):
    """Files on request."""

    formats: tuple[MeshFormat, ...] = Field(
        (),
        max_length=2,
        description="Mesh formats beside STL, 3MF and GLB, which are always written: obj (solid, fluids, surface), vtu "
        "(the wall with its thickness and mean curvature, solid and fluids with their patches). Ours: each is about as "
        "large as the STL, and few need it.",
    )
