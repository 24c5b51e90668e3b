"""The body: the extraction of the surface, the wall and the shell."""

from __future__ import annotations

from pydantic import Field

from dualms.spec.model import Length, Model


class SurfaceSpec(Model):
    """Extraction of the zero level set."""

    resolution: int = Field(256, ge=24, le=512, description="Voxels along the longest side. Paper, section 6.1: 256.")


class WallThickness(Model):
    """Wall given by its thickness."""

    thickness: Length = Field(0.5, description="Thickness of the separating wall (units). Ours: printable in metal.")


class WallFraction(Model):
    """Wall given by the share of the domain that it takes."""

    volume_fraction: float = Field(gt=0, lt=0.9, description="Wall volume over domain volume, shell left out.")


class ShellSpec(Model):
    """A closed skin of the solid along the inside of the envelope, open at the ports."""

    thickness: Length = Field(1.0, description="Thickness (units). Ours: twice the default wall.")
