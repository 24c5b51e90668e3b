"""What clients send and see of a design."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, StringConstraints

from dualms.spec import Spec
from service.domains.schemas import Output

Label = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9][A-Za-z0-9._:/=-]{0,63}$")]
Name = Annotated[str, StringConstraints(min_length=1, max_length=200, strip_whitespace=True)]


class Status(StrEnum):
    """Where a design stands; the last three are final."""

    QUEUED = "queued"
    RUNNING = "running"
    SUCCEEDED = "succeeded"
    FAILED = "failed"
    CANCELLED = "cancelled"


class Stage(StrEnum):
    """The stages of a design, in order."""

    DOMAIN = "domain"
    FLOW = "flow"
    GRAPH = "graph"
    PARTITION = "partition"
    SKELETONS = "skeletons"
    FIELD = "field"
    SURFACE = "surface"
    BODY = "body"
    REPORT = "report"
    EVALUATION = "evaluation"


class DesignOptions(BaseModel):
    """What may be said about a design beside its domain and specification."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    name: Name | None = Field(None, description="For people.")
    labels: tuple[Label, ...] = Field((), max_length=16, description="For filters.")
    webhook: str | None = Field(
        None, max_length=2000, pattern="^https?://", description="Told when the design ends (Standard Webhooks)."
    )
    deadline_s: float | None = Field(
        None,
        gt=0,
        le=30 * 86400,
        allow_inf_nan=False,
        description="Fail if not ended within so many seconds.",
    )
    priority: int = Field(
        0, ge=-10, le=10, description="Higher goes first among one owner's designs; owners take turns whatever it is."
    )


class DesignIn(DesignOptions):
    """A design to make."""

    domain: str = Field(pattern="^[0-9a-f]{64}$", description="Id of an uploaded domain.")
    spec: Spec


class StageOut(Output):
    """Time that one stage took."""

    stage: Stage
    seconds: float


class ArtifactOut(Output):
    """One file of a design."""

    name: str
    size: int = Field(description="Bytes.")
    sha256: str
    media_type: str
    href: str


class ErrorOut(Output):
    """Why a design failed; the members are those of a problem document."""

    code: str = Field(description="Stable; for programs.")
    detail: str = Field(description="What is wrong, with the measured value and where.")
    advice: str = Field(description="What to try.")
    measured: dict[str, Any] = Field(description="The figures behind the detail.")


class DomainRef(Output):
    """The domain of a design."""

    id: str
    name: str
    href: str


class DesignSummary(Output):
    """A design, in brief."""

    id: str
    name: str | None
    labels: list[str]
    domain: DomainRef
    status: Status
    stage: Stage | None = Field(description="Stage at work now, or at the end the last.")
    progress: float = Field(ge=0, le=1, description="Done part of the whole design.")
    attempt: int = Field(description="How often the step at hand has been started.")
    created_at: str
    started_at: str | None
    finished_at: str | None
    error: ErrorOut | None
    href: str


class DesignOut(DesignSummary):
    """A design, in full."""

    spec: Spec = Field(description="The specification as resolved: no `auto`, units filled in.")
    deadline_at: str | None
    webhook: str | None
    stages: list[StageOut] = Field(description="Times of the stages that ended, in order.")
    eta_s: float | None = Field(description="Seconds to the end, estimated from the progress so far.")
    note: str = Field(description="What the stage at work says for people.")
    metrics: dict[str, Any] = Field(description="Figures of the report; empty until there is one.")
    artifacts: list[ArtifactOut]
    events: str = Field(description="Address of the event stream.")


class DesignPage(Output):
    """Designs, newest first."""

    items: list[DesignSummary]
    next: str | None = Field(description="Address of the next page.")
