"""A design's rows as clients see them."""

from __future__ import annotations

from collections.abc import Sequence
from urllib.parse import quote

from dualms.spec import Spec
from dualms.steps import STAGES, steps_of
from service.designs.schemas import (
    ArtifactOut,
    DesignOut,
    DesignSummary,
    DomainRef,
    ErrorOut,
    Stage,
    StageOut,
    Status,
)
from service.times import iso
from worker.views import ArtifactRecord, DesignRecord

FINAL = frozenset({Status.SUCCEEDED, Status.FAILED, Status.CANCELLED})


def etag(row: DesignRecord) -> str:
    """Changes with every visible change of the design."""
    return f'"{row.version}"'


def retry_after_s(status: str) -> int | None:
    """When it is worth asking again; None if never."""
    if status in FINAL:
        return None
    return 1 if status == "running" else 2


def design_summary(row: DesignRecord, domain_name: str) -> DesignSummary:
    """A design in a list."""
    return DesignSummary(**_brief(row, domain_name))


def design_view(row: DesignRecord, domain_name: str, artifacts: Sequence[ArtifactRecord], now: float) -> DesignOut:
    """A design in full.

    Parameters
    ----------
    row, domain_name, artifacts
        From the records.
    now
        Time by the database's clock.
    """
    spec = Spec.model_validate(row.spec)
    order = [stage for step in steps_of(spec) for stage in STAGES[step]]
    return DesignOut(
        **_brief(row, domain_name),
        spec=spec,
        deadline_at=iso(row.deadline_at),
        webhook=row.webhook,
        stages=[StageOut(stage=Stage(s), seconds=row.timings[s]) for s in order if s in row.timings],
        eta_s=_eta_s(row, now),
        note=row.note,
        metrics=row.metrics,
        artifacts=[artifact_view(row.id, a) for a in artifacts if not a.internal],
        events=f"/v1/designs/{row.id}/events",
    )


def artifact_view(design_id: str, row: ArtifactRecord) -> ArtifactOut:
    """One file."""
    return ArtifactOut(
        name=row.name,
        size=row.size,
        sha256=row.sha256,
        media_type=row.media_type,
        href=f"/v1/designs/{design_id}/artifacts/{quote(row.name)}",
    )


def _brief(row: DesignRecord, domain_name: str) -> dict[str, object]:
    return {
        "id": row.id,
        "name": row.name,
        "labels": list(row.labels),
        "domain": DomainRef(id=row.domain_id, name=domain_name, href=f"/v1/domains/{row.domain_id}"),
        "status": Status(row.status),
        "stage": Stage(row.stage) if row.stage else None,
        "progress": min(max(row.progress, 0.0), 1.0),
        "attempt": row.tries,
        "created_at": iso(row.created_at),
        "started_at": iso(row.started_at),
        "finished_at": iso(row.finished_at),
        "error": error_view(row),
        "href": f"/v1/designs/{row.id}",
    }


def error_view(row: DesignRecord) -> ErrorOut | None:
    """Why a design failed, if it did."""
    if row.error is None:
        return None
    return ErrorOut(
        code=str(row.error.get("code", "design-failed")),
        detail=str(row.error.get("detail", row.error.get("message", ""))),
        advice=str(row.error.get("advice", "")),
        measured=dict(row.error.get("measured") or {}),
    )


def _eta_s(row: DesignRecord, now: float) -> float | None:
    """Time spent so far, carried on at the same pace."""
    if row.status != "running" or row.started_at is None or row.progress < 0.02:
        return None
    return round(max(now - row.started_at, 0.0) * (1 - row.progress) / row.progress, 1)
