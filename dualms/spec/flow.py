"""Guidance: along which direction each fluid should run."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from dualms.spec.model import Model, Point


class PotentialFlow(Model):
    """Guidance along the potential flow between each fluid's inlets and outlets."""

    kind: Literal["potential"] = "potential"
    spread: float = Field(
        2.0,
        ge=2,
        le=8,
        description="Exponent s of the flow that minimises ∫ |velocity|^s: 2 is the potential flow, more spreads each "
        "fluid more evenly over the envelope. Ours.",
    )


class DirectionFlow(Model):
    """Guidance along one direction."""

    kind: Literal["direction"]
    vector: Point = Field(description="Direction, of any length but zero.")

    @model_validator(mode="after")
    def _not_zero(self) -> DirectionFlow:
        if not any(self.vector):
            raise ValueError("the direction must not be the zero vector")
        return self


class PathFlow(Model):
    """Guidance along the tangent of the nearest segment of a polyline."""

    kind: Literal["path"]
    points: tuple[Point, ...] = Field(min_length=2, max_length=10_000, description="Polyline (units).")

    @model_validator(mode="after")
    def _not_a_point(self) -> PathFlow:
        if all(p == self.points[0] for p in self.points):
            raise ValueError("the points of the path must not all coincide")
        return self


class NoFlow(Model):
    """No guidance: all edges weigh 1."""

    kind: Literal["none"]


FlowSpec = Annotated[PotentialFlow | DirectionFlow | PathFlow | NoFlow, Field(discriminator="kind")]
