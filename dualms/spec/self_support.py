"""Self-support: fewer surfaces that face down flatter than 45°."""

from __future__ import annotations

from pydantic import Field

from dualms.spec.model import Model


class SelfSupportSpec(Model):
    """Design in a space compressed along the build direction: channels come out tall, their walls steep (ours)."""

    steepness: float = Field(
        1.5,
        ge=1,
        le=3,
        description="How much longer cells are along the build direction than across it; 1 changes nothing. Gain and "
        "cost are measured in docs/decisions/0010-self-support.md.",
    )
