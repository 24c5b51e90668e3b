"""What a worker holds while it carries out a step, and what it hands in."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

from dualms.spec import Spec
from dualms.steps import Step, step_keys, steps_of
from worker.code import code_id
from worker.views import ArtifactRecord, DesignRecord, DomainRecord


@dataclass(frozen=True)
class FileRecord:
    """A file that a step has left in the store."""

    name: str
    sha256: str
    size: int


@dataclass(frozen=True)
class StepRecord:
    """What a step has produced: files, figures of the report, seconds per stage."""

    files: tuple[FileRecord, ...]
    metrics: dict[str, Any]
    timings: dict[str, float]


@dataclass(frozen=True)
class Lease:
    """The right to carry out one step of one design, as long as it is renewed."""

    design: DesignRecord
    domain: DomainRecord
    attempt: int
    worker_id: str
    inputs: tuple[ArtifactRecord, ...]
    checkpoint: dict[str, Any] | None
    hints: dict[str, Any]
    waiting_since: float  # seconds since 1970

    @property
    def id(self) -> str:
        """Id of the design."""
        return self.design.id

    @property
    def step(self) -> Step:
        """The step."""
        return cast("Step", self.design.step)

    @property
    def spec(self) -> Spec:
        """The design's specification."""
        return Spec.model_validate(self.design.spec)

    @property
    def trace(self) -> str | None:
        """The span that asked for the design, where traces are kept."""
        return self.hints.get("trace")

    @property
    def of_other_code(self) -> bool:
        """Whether the earlier steps were carried out by other code, whose files this one may not understand.

        The first version did not say which code it was.
        """
        return self.step != steps_of(self.spec)[0] and self.hints.get("code") != code_id()

    @property
    def key(self) -> str:
        """Cache key of the step's result, by this code."""
        text = f"{code_id()} {step_keys(self.domain.sha256, self.spec)[self.step]}"
        return hashlib.sha256(text.encode()).hexdigest()


def files_from(items: Sequence[Mapping[str, Any]]) -> tuple[FileRecord, ...]:
    """File records from a step's outcome."""
    return tuple(FileRecord(str(i["name"]), str(i["sha256"]), int(i["size"])) for i in items)
