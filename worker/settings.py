"""What the environment says to the worker floor: the only place on this floor that reads it."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path

from pydantic import Field
from pydantic_settings import BaseSettings, SettingsConfigDict

GIB = 1 << 30


class Settings(BaseSettings):
    """Folders, addresses and limits; each from ``DUALMS_<NAME>`` or its default.

    Times are in seconds, sizes in bytes. The three addresses are all that machines of one cluster need to share.
    """

    model_config = SettingsConfigDict(env_prefix="DUALMS_", frozen=True, extra="ignore", allow_inf_nan=False)

    data_dir: Path = Field(Path("~/.local/share/dualms"), description="Folder of whatever stays on this machine.")
    database_url: str = Field("", description="SQLAlchemy URL; empty: SQLite in the data folder.")
    redis_url: str = Field(
        "", description="Broker: redis://, rediss://, unix:///path or redis+socket:///path; empty: none known."
    )
    store_url: str = Field("", description="file:///folder, s3://bucket/prefix or memory://; empty: the data folder.")

    upload_bytes: int = Field(500_000_000, gt=0, description="Largest domain file.")
    max_faces: int = Field(2_000_000, gt=0, description="Most triangles of a domain.")
    inspection_memory_bytes: int = Field(3 * GIB // 2, gt=0, description="Address space of the child that reads one.")
    inspection_seconds: float = Field(25.0, gt=0, description="CPU time of that child; wall time: four times this.")

    step_memory_bytes: int = Field(12 * GIB, gt=0, description="Resident memory of one step, all its processes.")
    step_seconds: float = Field(6 * 3600.0, gt=0, description="Wall time of one step.")
    grace_s: float = Field(5.0, ge=0, description="What a step gets to end by itself before it is killed.")
    drain_s: float = Field(12.0, ge=0, description="What running steps get to finish when the worker is stopped.")

    free_bytes: int = Field(GIB // 2, ge=0, description="Room on the disks below which steps wait for more.")

    lease_s: float = Field(45.0, gt=0, description="How long a silent worker keeps a step.")
    heartbeat_s: float = Field(2.0, gt=0, description="Between two renewals of a lease.")
    reap_s: float = Field(10.0, gt=0, description="Between two looks for expired leases and lost messages.")
    worker_gone_s: float = Field(30.0, gt=0, description="A worker silent for so long counts as gone.")
    max_tries: int = Field(3, ge=1, le=100, description="Starts of one step that end with its process lost.")

    webhook_private: bool = Field(False, description="Send webhooks to addresses that are not public, too.")

    tracing: bool = Field(
        False, description="Send traces (needs dualms[otel]); the standard OTEL_EXPORTER_OTLP_… say where."
    )

    collect_s: float = Field(600.0, gt=0, description="Between two collections of garbage.")
    blob_grace_s: float = Field(3600.0, ge=0, description="Bytes younger than this are never collected.")
    cache_days: float = Field(30.0, ge=0, description="Step results unused for so long are forgotten.")
    idempotency_days: float = Field(7.0, gt=0, description="How long an idempotency key is remembered.")
    retention_days: float | None = Field(
        None, gt=0, description="Ended designs, and unused domains, older than this are deleted."
    )

    @cached_property
    def folder(self) -> Path:
        """The data folder, absolute."""
        return self.data_dir.expanduser().resolve()

    @property
    def database(self) -> str:
        """URL of the records."""
        return self.database_url or f"sqlite:///{self.folder / 'dualms.sqlite3'}"

    @property
    def store(self) -> str:
        """URL of the artifacts."""
        return self.store_url or (self.folder / "artifacts").as_uri()

    @property
    def scratch(self) -> Path:
        """Folder in which the steps of this machine have their temporary folders."""
        return self.folder / "scratch"
