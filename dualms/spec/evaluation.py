"""The solved flow and heat transfer."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from dualms.spec.model import Model


class EvaluationSpec(Model):
    """Solved pressure drop and heat transfer, and baselines in the same envelope."""

    solver: Literal["openfoam"] = "openfoam"
    resolution: int = Field(96, ge=24, le=256, description="Voxels along the longest side. Ours: trends hold at 64.")
    baselines: tuple[Literal["gyroid", "p", "d", "iwp"], ...] = Field((), description="Surfaces to compare with.")
    match: Literal["solid-fraction", "ua"] = Field(
        "solid-fraction", description="What the baseline's cell size is chosen to equal."
    )
    iterations: int = Field(
        400, ge=20, le=10_000, description="Limit of the flow's iterations; it stops as soon as ΔP has settled. Ours."
    )
    scheme: Literal["linear-upwind", "upwind"] = Field(
        "linear-upwind", description="Momentum convection: second order, or first order (steadier, 20 % low). Ours."
    )
    wall_conductivity_w_m_k: float = Field(
        237.0, gt=0, le=1e5, description="Thermal conductivity of the wall (W/(m·K)). Paper, appendix C, aluminium."
    )
    keep_case: bool = Field(False, description="Keep the solver's case as an artifact.")
