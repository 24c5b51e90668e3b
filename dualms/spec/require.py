"""What the certificate must also meet."""

from __future__ import annotations

from pydantic import Field

from dualms.spec.model import Model


class RequireSpec(Model):
    """Requirements on the report's figures; each becomes a line of the certificate. SI units."""

    min_channel_m: float | None = Field(None, gt=0, description="Least channel width of either fluid.")
    min_passage_m: float | None = Field(None, gt=0, description="Largest ball that gets through either fluid.")
    min_wall_m: float | None = Field(None, gt=0, description="Measured wall thickness, 1st percentile.")
    max_dead_end_fraction: float | None = Field(None, ge=0, le=1, description="Stagnant share of either fluid.")
    max_overhang_fraction: float | None = Field(None, ge=0, le=1, description="Surface that faces down below 45°.")
    max_solid_fraction: float | None = Field(None, gt=0, le=1, description="Solid over the envelope's volume.")
    min_area_density_per_m: float | None = Field(None, gt=0, description="Surface over the envelope's volume.")
