"""The body: the extraction of the surface, the wall and the shell."""

from __future__ import annotations

import itertools
from typing import Annotated, Literal

from pydantic import Field, Tag, model_validator

from dualms.spec.model import Coordinate, Length, Model, Point, by_key

MAX_FACES = 3_000_000  # a 3MF of 45 MB


class SurfaceSpec(Model):
    """Extraction of the zero level set, and how finely the body shows it."""

    resolution: int = Field(256, ge=24, le=512, description="Voxels along the longest side. Paper, section 6.1: 256.")
    max_faces: int = Field(
        MAX_FACES,
        ge=1000,
        le=20_000_000,
        description="Triangles of the solid at most, as far as the wall keeps its thickness within 3 %; the "
        "certificate says where not. Ours: a 3MF of 45 MB.",
    )


class PicturesSpec(Model):
    """Pictures of the body."""

    width: int = Field(
        1280, ge=160, le=4096, description="Pixels across preview.png; the time goes with the square. Ours."
    )


class WallThickness(Model):
    """Wall given by its thickness."""

    thickness: Length = Field(0.5, description="Thickness of the separating wall (units). Ours: printable in metal.")


class WallFraction(Model):
    """Wall given by the share of the domain that it takes."""

    volume_fraction: float = Field(gt=0, lt=0.9, description="Wall volume over domain volume, shell left out.")


class GradedAlong(Model):
    """Thickness along a direction: linear between stations, constant beyond the outermost."""

    direction: Point = Field(description="Direction, of any length but zero.")
    stations: tuple[tuple[Coordinate, Length], ...] = Field(
        min_length=2,
        max_length=1000,
        description="Pairs of position (x · unit direction, units; rising) and thickness (units).",
    )

    @model_validator(mode="after")
    def _rising(self) -> GradedAlong:
        if not any(self.direction):
            raise ValueError("the direction must not be the zero vector")
        places = [place for place, _ in self.stations]
        if any(a >= b for a, b in itertools.pairwise(places)):
            raise ValueError("the stations' positions must rise")
        return self


class GradedAround(Model):
    """Thickness at points, between them the mean weighted by 1/distance² (Shepard 1968): never beyond the given."""

    points: tuple[tuple[Point, Length], ...] = Field(
        min_length=2, max_length=1000, description="Pairs of a point and the thickness there (units)."
    )

    @model_validator(mode="after")
    def _distinct(self) -> GradedAround:
        if len({point for point, _ in self.points}) < len(self.points):
            raise ValueError("no two of the points may coincide")
        return self


class WallGraded(Model):
    """Wall whose thickness the user varies over the body."""

    graded: Annotated[
        Annotated[GradedAlong, Tag("GradedAlong")] | Annotated[GradedAround, Tag("GradedAround")],
        by_key({"direction": "GradedAlong", "points": "GradedAround"}),
    ]


WallSpec = Annotated[
    Annotated[WallThickness, Tag("WallThickness")]
    | Annotated[WallFraction, Tag("WallFraction")]
    | Annotated[WallGraded, Tag("WallGraded")],
    by_key({"volume_fraction": "WallFraction", "graded": "WallGraded"}, default="WallThickness"),
]


class ShellSpec(Model):
    """A closed skin of the solid along the envelope, open at the ports."""

    thickness: Length = Field(1.0, description="Thickness (units). Ours: twice the default wall.")
    side: Literal["inside", "outside"] = Field(
        "inside", description="Inside, the envelope is the body's outline; outside, it is the fluids' room. Ours."
    )
