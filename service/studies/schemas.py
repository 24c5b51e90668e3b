"""What clients send and see of a study."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, JsonValue, StringConstraints

from service.designs.schemas import DomainRef, ErrorOut, Label, Name, Status
from service.domains.schemas import Output

MetricPath = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9_-]+(\.[A-Za-z0-9_-]+)*$", max_length=200)]
Figure = float | int | bool | str | None


class StudyPlan(BaseModel):
    """What is varied, and what is shown: a study without its domain."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    spec: dict[str, JsonValue] = Field(
        description="The specification that all points share, as for designs; fields of the grid may be left out."
    )
    grid: dict[str, list[JsonValue]] = Field(
        description="Dotted path of a field to its values; a design for each combination, at most 256.",
        examples=[{"graph.sites": [300, 600], "graph.stretch": [1, 2], "seed": [0, 1, 2]}],
        max_length=16,
    )
    metrics: tuple[MetricPath, ...] | None = Field(
        None,
        max_length=64,
        description="Columns of the table: dotted paths into the report, such as `evaluation.design.ua_w_k`. In a list "
        "a part selects items by a value that they hold: `evaluation.comparisons.gyroid.ua.pressure_ratio`. "
        "Default: solved figures, comparisons, and geometry.",
    )
    name: Name | None = Field(None, description="For people.")
    labels: tuple[Label, ...] = Field((), max_length=15, description="For filters; each design has them all.")


class StudyIn(StudyPlan):
    """A study to make."""

    domain: str = Field(pattern="^[0-9a-f]{64}$", description="Id of an uploaded domain.")


class ObjectivesOut(Output):
    """What the picture weighs: pressure drop against UA where flows are solved, else curvature against area."""

    small: str = Field(description="Figure that should be small.")
    large: str = Field(description="Figure that should be large.")


class CountsOut(Output):
    """Points by status."""

    queued: int
    running: int
    succeeded: int
    failed: int
    cancelled: int


class RowOut(Output):
    """One point of a study."""

    values: dict[str, JsonValue] = Field(description="The grid's paths and the values here.")
    design: str = Field(description="Id of the design.")
    status: Status = Field(description="The design's; `cancelled` too where it was deleted.")
    progress: float = Field(ge=0, le=1)
    figures: dict[str, Figure] = Field(description="The metrics; null where there is no such figure.")
    front: bool = Field(description="Whether no other point is at least as good in both objectives and better in one.")
    error: ErrorOut | None = Field(description="Why the design failed, or why its flow could not be solved.")
    href: str | None = Field(description="Address of the design.")


class FileOut(Output):
    """A file of a study, made anew from the rows as they stand."""

    name: str
    media_type: str
    href: str


class StudySummary(Output):
    """A study, in brief."""

    id: str
    name: str | None
    labels: list[str]
    domain: DomainRef
    status: Status = Field(
        description="queued or running until all points have ended; then succeeded if one has and none was cancelled "
        "(the failed ones are listed as such), cancelled if one was cancelled, failed if all have failed."
    )
    progress: float = Field(ge=0, le=1)
    counts: CountsOut
    created_at: str
    finished_at: str | None
    href: str


class StudyOut(StudySummary):
    """A study, in full."""

    spec: dict[str, Any]
    grid: dict[str, list[JsonValue]]
    metrics: list[str]
    objectives: ObjectivesOut
    rows: list[RowOut] = Field(description="In the grid's order, the last path varying fastest.")
    files: list[FileOut]


class StudyPage(Output):
    """Studies, newest first."""

    items: list[StudySummary]
    next: str | None = Field(description="Address of the next page.")
