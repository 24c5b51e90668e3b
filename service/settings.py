"""What the environment says to the service floor: the only place on this floor that reads it."""

from __future__ import annotations

from pathlib import Path

from pydantic import Field
from pydantic_settings import BaseSettings, SettingsConfigDict

from worker.routing import QUEUES
from worker.settings import Settings as WorkerSettings


class UnknownQueue(ValueError):
    """A queue that is none of ours."""


class Settings(BaseSettings):
    """How the API behaves; each from ``DUALMS_<NAME>`` or its default. Times are in seconds."""

    model_config = SettingsConfigDict(env_prefix="DUALMS_", frozen=True, extra="ignore", allow_inf_nan=False)

    max_wait_s: float = Field(60.0, ge=0, le=600, description="Longest answer to Prefer: wait.")
    watch_s: float = Field(0.2, gt=0, le=10, description="Between two looks for changes of the designs waited for.")
    require_keys: bool = Field(False, description="Ask for an API key even if none was ever made.")
    loopback_only: bool = Field(
        False, description="Without keys, answer only requests that name this machine (localhost, 127.0.0.1)."
    )
    sse_ping_s: int = Field(15, ge=1, le=300, description="Between two comments that keep an event stream open.")
    uploads_at_once: int = Field(2, ge=1, le=64, description="Uploads that are read at the same time; others wait.")
    presigned_s: int = Field(600, ge=10, le=86400, description="Life of an address that downloads from S3 directly.")


def worker_settings(data: Path | None = None) -> WorkerSettings:
    """Settings of the floor below, with the data folder of the command line if one is given."""
    return WorkerSettings(data_dir=data) if data is not None else WorkerSettings()


def queue_names(text: str) -> tuple[str, ...]:
    """Names with commas between, in order, each once.

    Raises
    ------
    UnknownQueue
        If one is not a queue.
    """
    names = tuple(dict.fromkeys(part.strip() for part in text.split(",") if part.strip()))
    unknown = [name for name in names if name not in QUEUES]
    if unknown or not names:
        raise UnknownQueue(f"'{text}' names no queues" if not names else f"There is no queue '{unknown[0]}'")
    return names
