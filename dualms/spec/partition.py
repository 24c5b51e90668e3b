"""The search for the maximum cut."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from dualms.spec.model import Model


class PartitionSpec(Model):
    """The constrained connected maximum cut (paper, section 4.2)."""

    method: Literal["anneal", "greedy"] = Field(
        "anneal", description="'greedy' is the paper's Algorithm 1; 'anneal' (ours) searches further, same constraints."
    )
    seconds: float = Field(1.0, gt=0, le=600, description="Search budget of 'anneal', as work worth so many seconds.")
    slack: float = Field(
        0.01,
        ge=0,
        le=0.2,
        description="Share of the cut weight that 'anneal' may give up for channels that resist the flow less. Ours.",
    )
    hot_share: float | None = Field(
        None, ge=0.15, le=0.85, description="Share of the sites that the hot fluid gets, within 0.02; null: free. Ours."
    )
