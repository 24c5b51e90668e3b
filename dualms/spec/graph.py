"""The graph that is cut: its sites and the weights of its edges."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from dualms.spec.model import Model

GRAPH_PRESETS: dict[str, dict[str, object]] = {
    "aligned": {"transverse_weight": 20.0, "weighting": "smooth", "stretch": 3.0},
    "paper": {"transverse_weight": 5.0, "weighting": "two-valued", "stretch": 1.0},
}
"""What a preset sets where the specification is silent; chosen in docs/decisions/0007-alignment.md."""


class GraphSpec(Model):
    """Sites and edge weights of the graph (paper, section 4.1)."""

    preset: Literal["aligned", "paper"] = Field(
        "aligned",
        description="Defaults of the other fields: 'aligned' (ours: least solved pressure drop at equal heat transfer) "
        "or 'paper' (a = 5, two-valued, round cells).",
    )

    sites: int = Field(300, ge=8, le=20_000, description="Number of Voronoi sites. Paper, appendix A: 300 to 800.")
    transverse_weight: float = Field(
        20.0, ge=1, le=1000, description="Weight a of edges across the flow (Eq. 1). Paper: 5; 'aligned': 20."
    )
    weighting: Literal["two-valued", "smooth"] = Field(
        "smooth", description="'two-valued': a beyond 45° off the flow, else 1 (Eq. 1); 'smooth': 1 + (a-1) sin². Ours."
    )
    stretch: float = Field(
        3.0, ge=1, le=5, description="Length of a cell along the flow over its width. Paper: 1; 'aligned' (ours): 3."
    )
    port_density: float = Field(
        1.0, ge=1, le=20, description="Sites per volume at the ports over that far from them. Ours; the paper's: 1."
    )

    @model_validator(mode="before")
    @classmethod
    def _fill_from_preset(cls, given: object) -> object:
        if not isinstance(given, dict):
            return given
        preset = given.get("preset", "aligned")
        return {**GRAPH_PRESETS.get(preset, {}), **given} if isinstance(preset, str) else given
