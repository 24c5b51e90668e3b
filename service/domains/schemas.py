"""What clients see of a domain; lengths in the domain's own units."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field

from dualms.spec import Unit

Vector = tuple[float, float, float]


class Output(BaseModel):
    """A frozen answer; every field is always there."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class FacetOut(Output):
    """A planar part of the boundary, by which a port can be named."""

    index: int = Field(description='Names the facet in a port: {"facet": index}.')
    center: Vector = Field(description="Centre (units).")
    normal: Vector = Field(description="Outward unit normal.")
    area: float = Field(description="Area (units²).")


class DomainOut(Output):
    """An uploaded envelope that passed the checks."""

    id: str = Field(description="SHA-256 of the file's bytes and the units: the same upload gives the same id.")
    name: str = Field(description="File name at the first upload.")
    format: str = Field(description="Suffix, such as `stl`.")
    size: int = Field(description="Bytes.")
    sha256: str = Field(description="SHA-256 of the file's bytes.")
    units: Unit
    vertices: int
    faces: int
    bounds: tuple[Vector, Vector] = Field(description="Lower and upper corner (units).")
    volume: float = Field(description="Enclosed volume (units³).")
    area: float = Field(description="Surface area (units²).")
    watertight: bool
    facets: list[FacetOut] = Field(description="Planar facets of more than 0.1 % of the area, largest first.")
    problems: list[str] = Field(description="What was put right or is worth knowing; an empty list is best.")
    created_at: str = Field(description="Time of the first upload (ISO 8601, UTC).")
    href: str = Field(description="Address of this record.")
    file: str = Field(description="Address of the file's bytes.")


class DomainPage(Output):
    """Some domains, newest first."""

    items: list[DomainOut]
    next: str | None = Field(description="Address of the next page.")
