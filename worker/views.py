"""What the records say, as frozen values that outlive a session."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

from worker import tables

Status = Literal["queued", "running", "succeeded", "failed", "cancelled"]
QueueName = Literal["cpu", "gpu", "cfd"]
LIVE: tuple[Status, ...] = ("queued", "running")
FINAL: tuple[Status, ...] = ("succeeded", "failed", "cancelled")


@dataclass(frozen=True)
class DomainRecord:
    """An uploaded envelope; times in seconds since 1970."""

    id: str
    sha256: str
    size: int
    name: str
    suffix: str
    units: str
    inspection: dict[str, Any]
    owner: str | None
    created_at: float


@dataclass(frozen=True)
class ArtifactRecord:
    """A file of a design; the store has the bytes under ``sha256``."""

    name: str
    step: str
    sha256: str
    size: int
    media_type: str
    internal: bool
    created_at: float


@dataclass(frozen=True)
class DesignRecord:
    """A design as it stands; times in seconds since 1970.

    ``attempt`` is the fence of its writers, ``tries`` counts the starts of the step at hand. ``version`` grows with
    every visible change (use it for the ETag) and is the sequence of the last event.
    """

    id: str
    domain_id: str
    spec: dict[str, Any]
    name: str | None
    labels: tuple[str, ...]
    webhook: str | None
    owner: str | None
    study_id: str | None
    priority: int
    status: Status
    step: str
    queue: str
    stage: str | None
    progress: float
    note: str
    attempt: int
    tries: int
    created_at: float
    started_at: float | None
    finished_at: float | None
    deadline_at: float | None
    timings: dict[str, float]
    metrics: dict[str, Any]
    error: dict[str, Any] | None
    version: int

    @property
    def final(self) -> bool:
        """Whether it has ended and will never change again."""
        return self.status in FINAL


@dataclass(frozen=True)
class EventRecord:
    """Something that happened to a design, numbered within it.

    ``kind`` is one of ``queued started progress step reused retrying succeeded failed cancelled``.
    """

    design_id: str
    sequence: int
    kind: str
    data: dict[str, Any]
    created_at: float


@dataclass(frozen=True)
class WorkerRecord:
    """A worker process that is alive, or was."""

    id: str
    host: str
    name: str
    pid: int
    pid_started: float
    queue: str
    concurrency: int
    draining: bool
    facts: dict[str, Any]
    started_at: float
    heartbeat_at: float
    alive: bool


@dataclass(frozen=True)
class Page:
    """Designs, newest first; ``next`` is the cursor of the page after this one, None on the last."""

    items: tuple[DesignRecord, ...]
    next: str | None


@dataclass(frozen=True)
class QueueFacts:
    """What waits and runs on one queue; the age is that of the oldest waiting step, in seconds."""

    queue: str
    waiting: int
    running: int
    oldest_waiting_s: float
    workers: int


def domain_record(row: tables.Domain) -> DomainRecord:
    """The frozen value of a row."""
    return DomainRecord(**_columns(row, DomainRecord))


def design_record(row: tables.Design) -> DesignRecord:
    """The frozen value of a row."""
    return DesignRecord(**{**_columns(row, DesignRecord), "labels": tuple(row.labels)})


def event_record(row: tables.Event) -> EventRecord:
    """The frozen value of a row."""
    return EventRecord(**_columns(row, EventRecord))


def artifact_record(row: tables.DesignArtifact) -> ArtifactRecord:
    """The frozen value of a row."""
    return ArtifactRecord(**_columns(row, ArtifactRecord))


def worker_record(row: tables.Worker, alive: bool) -> WorkerRecord:
    """The frozen value of a row."""
    return WorkerRecord(**_columns(row, WorkerRecord), alive=alive)


def _columns(row: tables.Base, kind: type) -> dict[str, Any]:
    return {name: getattr(row, name) for name in kind.__dataclass_fields__ if hasattr(type(row), name)}  # type: ignore[attr-defined]
