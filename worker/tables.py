"""The SQL tables: the truth about domains, designs, workers and results.

Times are seconds since 1970 by the database's clock. A design's row is written by clients (create, cancel, delete) and
by whoever holds its lease; the latter always names ``(id, attempt)`` in the WHERE clause, so a late writer hits no row.
"""

from __future__ import annotations

from typing import Any, ClassVar

from sqlalchemy import JSON, BigInteger, Double, ForeignKey, Index, Integer, String, Text
from sqlalchemy.orm import DeclarativeBase, Mapped, mapped_column

Json = dict[str, Any]


class Base(DeclarativeBase):
    """All tables."""

    type_annotation_map: ClassVar[dict[Any, Any]] = {
        Json: JSON,
        list[str]: JSON,
        float: Double,
        str: String,
        int: Integer,
    }


class Domain(Base):
    """An uploaded envelope; the bytes are in the artifact store under ``sha256``."""

    __tablename__ = "domains"
    id: Mapped[str] = mapped_column(String(64), primary_key=True)
    sha256: Mapped[str] = mapped_column(String(64), index=True)
    size: Mapped[int] = mapped_column(BigInteger)
    name: Mapped[str] = mapped_column(Text)
    suffix: Mapped[str] = mapped_column(String(16))
    units: Mapped[str] = mapped_column(String(8))
    inspection: Mapped[Json]
    owner: Mapped[str | None] = mapped_column(String(64), index=True)
    created_at: Mapped[float]


class Design(Base):
    """A job: one specification to carry out on one domain."""

    __tablename__ = "designs"
    __table_args__ = (
        Index("ix_designs_status_id", "status", "id"),
        Index("ix_designs_waiting", "queue", "status", "lease_until"),
        Index("ix_designs_owner_id", "owner", "id"),
    )
    id: Mapped[str] = mapped_column(String(32), primary_key=True)  # sorts by time of creation
    domain_id: Mapped[str] = mapped_column(ForeignKey("domains.id"), index=True)
    spec: Mapped[Json]
    name: Mapped[str | None] = mapped_column(Text)
    labels: Mapped[list[str]]
    webhook: Mapped[str | None] = mapped_column(Text)
    owner: Mapped[str | None] = mapped_column(String(64))
    study_id: Mapped[str | None] = mapped_column(String(32), index=True)
    priority: Mapped[int]
    status: Mapped[str] = mapped_column(String(16))
    step: Mapped[str] = mapped_column(String(16))  # at work or next
    queue: Mapped[str] = mapped_column(String(16))  # where that step waits or runs
    stage: Mapped[str | None] = mapped_column(String(16))
    progress: Mapped[float]
    note: Mapped[str] = mapped_column(Text)
    attempt: Mapped[int]  # the fence: grows whenever a step is claimed or taken away
    tries: Mapped[int]  # starts of the step at hand
    lease_until: Mapped[float | None]
    worker_id: Mapped[str | None] = mapped_column(String(32), index=True)
    dispatched_at: Mapped[float | None]  # last message sent
    waiting_since: Mapped[float | None]
    created_at: Mapped[float]
    started_at: Mapped[float | None]
    finished_at: Mapped[float | None]
    deadline_at: Mapped[float | None] = mapped_column(index=True)
    timings: Mapped[Json]  # stage -> seconds
    metrics: Mapped[Json]
    error: Mapped[Json | None]
    checkpoint: Mapped[Json | None]  # of the step at hand: {"sha256", "size"}
    hints: Mapped[Json]  # for whoever goes on with it: a smaller batch, the code so far, the trace that it belongs to
    version: Mapped[int]  # grows with every visible change; also the sequence of the last event


class Study(Base):
    """A grid over the specification; its designs name it in ``study_id``."""

    __tablename__ = "studies"
    id: Mapped[str] = mapped_column(String(32), primary_key=True)  # sorts by time of creation
    domain_id: Mapped[str] = mapped_column(ForeignKey("domains.id"), index=True)
    name: Mapped[str | None] = mapped_column(Text)
    labels: Mapped[list[str]]
    owner: Mapped[str | None] = mapped_column(String(64), index=True)
    spec: Mapped[Json]  # as it was sent
    grid: Mapped[Json]  # {"axes": [[path, values], …]}: lists keep their order
    metrics: Mapped[list[str]]
    points: Mapped[Json]  # {"points": [[{path: value}, id of the design], …]}
    created_at: Mapped[float]


class DesignLabel(Base):
    """Index of labels."""

    __tablename__ = "design_labels"
    label: Mapped[str] = mapped_column(String(64), primary_key=True)
    design_id: Mapped[str] = mapped_column(ForeignKey("designs.id", ondelete="CASCADE"), primary_key=True, index=True)


class Event(Base):
    """What happened to a design; append-only, numbered within the design."""

    __tablename__ = "events"
    design_id: Mapped[str] = mapped_column(ForeignKey("designs.id", ondelete="CASCADE"), primary_key=True)
    sequence: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    kind: Mapped[str] = mapped_column(String(16))
    data: Mapped[Json]
    created_at: Mapped[float]


class DesignArtifact(Base):
    """A file that a design has produced."""

    __tablename__ = "design_artifacts"
    design_id: Mapped[str] = mapped_column(ForeignKey("designs.id", ondelete="CASCADE"), primary_key=True)
    name: Mapped[str] = mapped_column(String(128), primary_key=True)
    step: Mapped[str] = mapped_column(String(16))
    sha256: Mapped[str] = mapped_column(String(64), index=True)
    size: Mapped[int] = mapped_column(BigInteger)
    media_type: Mapped[str] = mapped_column(String(128))
    internal: Mapped[bool]  # read by later steps only
    created_at: Mapped[float]


class StepResult(Base):
    """Cache: what a step with this key has produced."""

    __tablename__ = "step_results"
    key: Mapped[str] = mapped_column(String(64), primary_key=True)
    step: Mapped[str] = mapped_column(String(16))
    metrics: Mapped[Json]
    timings: Mapped[Json]
    created_at: Mapped[float]
    used_at: Mapped[float] = mapped_column(index=True)


class StepFile(Base):
    """One file of a cached step result."""

    __tablename__ = "step_files"
    key: Mapped[str] = mapped_column(ForeignKey("step_results.key", ondelete="CASCADE"), primary_key=True)
    name: Mapped[str] = mapped_column(String(128), primary_key=True)
    sha256: Mapped[str] = mapped_column(String(64), index=True)
    size: Mapped[int] = mapped_column(BigInteger)


class Worker(Base):
    """A worker process that takes steps from one queue."""

    __tablename__ = "workers"
    id: Mapped[str] = mapped_column(String(32), primary_key=True)
    host: Mapped[str] = mapped_column(Text)  # machine, boot and process namespace
    name: Mapped[str] = mapped_column(Text)  # for people
    pid: Mapped[int]
    pid_started: Mapped[float]
    queue: Mapped[str] = mapped_column(String(16))
    concurrency: Mapped[int]
    draining: Mapped[bool]
    facts: Mapped[Json]
    started_at: Mapped[float]
    heartbeat_at: Mapped[float] = mapped_column(index=True)


class IdempotencyKey(Base):
    """A client's promise that two requests are one."""

    __tablename__ = "idempotency_keys"
    owner: Mapped[str] = mapped_column(String(64), primary_key=True)  # "" for nobody
    key: Mapped[str] = mapped_column(String(255), primary_key=True)
    request_sha256: Mapped[str] = mapped_column(String(64))
    design_id: Mapped[str] = mapped_column(String(32), index=True)  # or the study's
    created_at: Mapped[float] = mapped_column(index=True)


class ApiKey(Base):
    """A key that a client shows; only its hash is kept."""

    __tablename__ = "api_keys"
    id: Mapped[str] = mapped_column(String(16), primary_key=True)
    sha256: Mapped[str] = mapped_column(String(64), unique=True)
    owner: Mapped[str] = mapped_column(String(64), index=True)
    name: Mapped[str] = mapped_column(Text)
    scopes: Mapped[list[str]]
    max_live_designs: Mapped[int | None]
    max_stored_bytes: Mapped[int | None] = mapped_column(BigInteger)
    max_uploads_a_day: Mapped[int | None]
    created_at: Mapped[float]
    expires_at: Mapped[float | None]
    revoked_at: Mapped[float | None]
    last_used_at: Mapped[float | None]


class AuditEntry(Base):
    """Who did what to what; append-only."""

    __tablename__ = "audit"
    id: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    at: Mapped[float] = mapped_column(index=True)
    owner: Mapped[str | None] = mapped_column(String(64), index=True)
    key_id: Mapped[str | None] = mapped_column(String(16))
    action: Mapped[str] = mapped_column(String(64))
    subject: Mapped[str] = mapped_column(String(128))
    detail: Mapped[Json]


class Delivery(Base):
    """A webhook message to be delivered; written in the transaction that ends the design."""

    __tablename__ = "deliveries"
    __table_args__ = (Index("ix_deliveries_due", "done_at", "next_at"),)
    id: Mapped[str] = mapped_column(String(40), primary_key=True)
    design_id: Mapped[str] = mapped_column(String(32), index=True)
    url: Mapped[str] = mapped_column(Text)
    body: Mapped[str] = mapped_column(Text)
    tries: Mapped[int]
    next_at: Mapped[float]
    done_at: Mapped[float | None]  # delivered or given up
    error: Mapped[str | None] = mapped_column(Text)  # why the last try failed


class Secret(Base):
    """A secret that all machines of the cluster share, made at its first use."""

    __tablename__ = "secrets"
    name: Mapped[str] = mapped_column(String(64), primary_key=True)
    value: Mapped[str] = mapped_column(Text)
    created_at: Mapped[float]


class Total(Base):
    """A running total for the metrics."""

    __tablename__ = "totals"
    kind: Mapped[str] = mapped_column(String(16), primary_key=True)
    name: Mapped[str] = mapped_column(String(64), primary_key=True)
    count: Mapped[int] = mapped_column(BigInteger)
    seconds: Mapped[float]
