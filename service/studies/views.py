"""A study's records as clients see them."""

from __future__ import annotations

import hashlib
from urllib.parse import quote

from dualms.study.figures import GEOMETRIC, HYDRAULIC, figure, problem_of
from dualms.study.table import PICTURE, Row, Table, make_table
from service.backend import Backend
from service.designs.schemas import DomainRef, ErrorOut, Status
from service.designs.views import error_view
from service.studies.schemas import CountsOut, FileOut, ObjectivesOut, RowOut, StudyOut, StudySummary
from service.times import iso
from worker.studies import StudyPoint, StudyRecord, status_of

FILES = {
    "table.csv": "text/csv; charset=utf-8",
    "table.json": "application/json",
    "table.html": "text/html; charset=utf-8",
    PICTURE: "image/png",
}


def study_etag(study: StudyRecord) -> str:
    """Changes with every visible change of the study."""
    return f'"{hashlib.sha256(repr(study.version).encode()).hexdigest()[:32]}"'


def study_table(study: StudyRecord) -> Table:
    """The table as it stands."""
    solved = any(p.design is not None and p.design.spec.get("evaluation") is not None for p in study.points)
    objectives = HYDRAULIC if solved else GEOMETRIC
    paths = dict.fromkeys([*study.metrics, objectives.small, objectives.large])
    rows = []
    for point in study.points:
        metrics = point.design.metrics if point.design is not None else {}
        figures = {path: figure(metrics, path) for path in paths}
        error = error_view(point.design) if point.design is not None else None
        row = Row(
            point.values,
            point.design_id,
            status_of(point),
            figures,
            _report(point),
            (error.code, error.detail) if error is not None else problem_of(metrics),
        )
        rows.append(row)
    return make_table(study.name or f"Study {study.id[:13]}", tuple(study.grid), study.metrics, objectives, rows)


def study_summary(backend: Backend, study: StudyRecord) -> StudySummary:
    """A study in a list."""
    return StudySummary(**_brief(backend, study))


def study_view(backend: Backend, study: StudyRecord) -> StudyOut:
    """A study in full."""
    table = study_table(study)
    rows = [
        RowOut(
            values=point.values,
            design=point.design_id,
            status=Status(row.status),
            progress=_progress(point),
            figures={path: row.figures[path] for path in study.metrics},
            front=row.front,
            error=_error(point, row),
            href=f"/v1/designs/{point.design_id}" if point.design is not None else None,
        )
        for point, row in zip(study.points, table.rows, strict=True)
    ]
    return StudyOut(
        **_brief(backend, study),
        spec=study.spec,
        grid=study.grid,
        metrics=list(study.metrics),
        objectives=ObjectivesOut(small=table.objectives.small, large=table.objectives.large),
        rows=rows,
        files=[
            FileOut(name=name, media_type=kind, href=f"/v1/studies/{study.id}/artifacts/{quote(name)}")
            for name, kind in FILES.items()
        ],
    )


def _brief(backend: Backend, study: StudyRecord) -> dict[str, object]:
    ends = [p.design.finished_at for p in study.points if p.design is not None and p.design.finished_at is not None]
    name = backend.domain_name(study.domain_id)
    return {
        "id": study.id,
        "name": study.name,
        "labels": list(study.labels),
        "domain": DomainRef(id=study.domain_id, name=name, href=f"/v1/domains/{study.domain_id}"),
        "status": Status(study.status),
        "progress": round(sum(map(_progress, study.points)) / len(study.points), 4),
        "counts": CountsOut(**study.counts),
        "created_at": iso(study.created_at),
        "finished_at": iso(max(ends)) if study.final and ends else None,
        "href": f"/v1/studies/{study.id}",
    }


def _error(point: StudyPoint, row: Row) -> ErrorOut | None:
    """Why the design failed, or why its flow could not be solved."""
    if point.design is not None and (error := error_view(point.design)) is not None:
        return error
    return ErrorOut(code=row.error[0], detail=row.error[1], advice="", measured={}) if row.error else None


def _progress(point: StudyPoint) -> float:
    """A point that has ended is done, however it ended."""
    return 1.0 if point.design is None or point.design.final else min(max(point.design.progress, 0.0), 1.0)


def _report(point: StudyPoint) -> str:
    if point.design is None or point.design.status != "succeeded":
        return ""
    return f"/v1/designs/{point.design_id}/artifacts/report.html"
