"""What clients are told about an envelope; apart from the reading, so that it costs no import of the science."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict

from dualms.spec import Unit


class FacetRecord(BaseModel):
    """A planar facet as clients see it, in the domain's units."""

    model_config = ConfigDict(frozen=True)
    index: int
    center: tuple[float, float, float]
    normal: tuple[float, float, float]
    area: float


class Inspection(BaseModel):
    """What a domain file holds, in the domain's units."""

    model_config = ConfigDict(frozen=True)
    units: Unit
    vertices: int
    faces: int
    bounds: tuple[tuple[float, float, float], tuple[float, float, float]]
    volume: float
    area: float
    watertight: bool
    facets: tuple[FacetRecord, ...]
    problems: tuple[str, ...]
