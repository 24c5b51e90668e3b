"""Ports: the parts of the domain's boundary through which a fluid enters or leaves."""

from __future__ import annotations

from pydantic import Field, model_validator

from dualms.spec.model import Length, Model, Point


class DiskPort(Model):
    """The part of the boundary within ``radius`` of ``center``."""

    center: Point = Field(description="Centre of the disk, on the domain's boundary (units).")
    radius: Length = Field(description="Radius of the disk (units).")


class BoxPort(Model):
    """The part of the boundary inside an axis-parallel box."""

    box: tuple[Point, Point] = Field(description="Lower and upper corner (units).")

    @model_validator(mode="after")
    def _ordered(self) -> BoxPort:
        low, high = self.box
        if any(a > b for a, b in zip(low, high, strict=True)):
            raise ValueError("the first corner of a port's box must not exceed the second in any coordinate")
        return self


class FacetPort(Model):
    """A whole planar facet, by its index in the domain's list of facets."""

    facet: int = Field(ge=0, description="Index in the list that `dualms inspect` and POST /v1/domains give.")


PortSpec = DiskPort | BoxPort | FacetPort
