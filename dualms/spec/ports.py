"""Ports: the parts of the domain's boundary through which a fluid enters or leaves, with or without a stub pipe."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, Tag, model_validator

from dualms.spec.model import Length, Model, Point, by_key


class FlangeSpec(Model):
    """A round plate at the end of a header, flush with its opening."""

    radius: Length = Field(description="Outer radius of the plate (units); more than the pipe's outer radius.")
    thickness: Length = Field(description="Thickness of the plate (units).")


class HeaderSpec(Model):
    """A stub pipe that carries a port out of the envelope, along the port's normal."""

    radius: Length = Field(description="Inner radius at the pipe's end (units); the port's outline tapers to it.")
    length: Length = Field(description="From the body's skin at the port's centre to the pipe's end (units).")
    wall: Length | None = Field(None, description="Thickness of the pipe's wall (units); null: the shell's.")
    flange: FlangeSpec | None = Field(None, description="A plate at the pipe's end.")


class PlacedPort(Model):
    """What every kind of port may have."""

    header: HeaderSpec | None = Field(None, description="Stub pipe; needs a shell, and a port of one fluid alone.")

    @property
    def place(self) -> Model:
        """The port without its header: what tells whether two ports are the same opening."""
        return self.model_copy(update={"header": None})


class DiskPort(PlacedPort):
    """The part of the boundary within ``radius`` of ``center``."""

    center: Point = Field(description="Centre of the disk, on the domain's boundary (units).")
    radius: Length = Field(description="Radius of the disk (units).")


class BoxPort(PlacedPort):
    """The part of the boundary inside an axis-parallel box."""

    box: tuple[Point, Point] = Field(description="Lower and upper corner (units).")

    @model_validator(mode="after")
    def _ordered(self) -> BoxPort:
        low, high = self.box
        if any(a > b for a, b in zip(low, high, strict=True)):
            raise ValueError("the first corner of a port's box must not exceed the second in any coordinate")
        return self


class FacetPort(PlacedPort):
    """A whole planar facet, by its index in the domain's list of facets."""

    facet: int = Field(ge=0, description="Index in the list that `dualms inspect` and POST /v1/domains give.")


PortSpec = Annotated[
    Annotated[DiskPort, Tag("DiskPort")] | Annotated[BoxPort, Tag("BoxPort")] | Annotated[FacetPort, Tag("FacetPort")],
    by_key({"center": "DiskPort", "box": "BoxPort", "facet": "FacetPort"}),
]
