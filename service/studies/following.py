"""Answers about one study, at once or after waiting for it."""

from __future__ import annotations

import asyncio
import time

from fastapi.concurrency import run_in_threadpool
from fastapi.responses import Response

from service.artifacts.sending import SAFE
from service.backend import Backend
from service.conditional import matches
from service.problems import Problem
from service.studies.drawing import picture, picture_etag
from service.studies.views import FILES, study_etag, study_table, study_view
from worker.studies import Studies, StudyRecord

LOOK_S = 0.5  # between two looks at a study that somebody waits for


def find_study(backend: Backend, study_id: str) -> StudyRecord:
    """The study.

    Raises
    ------
    Problem
        ``study-not-found``.
    """
    study = Studies(backend.records).study(study_id)
    if study is None:
        raise study_not_found(study_id)
    return study


def study_not_found(study_id: str) -> Problem:
    """The refusal for an id that names no study."""
    advice = "It may have been deleted; GET /v1/studies lists those that are."
    return Problem("study-not-found", f"There is no study {study_id}.", advice)


async def follow_study(backend: Backend, study: StudyRecord, wait_s: float, seen: str | None) -> StudyRecord:
    """The study when it has ended, or, with If-None-Match, has changed, or when the time is over."""
    deadline = time.monotonic() + wait_s
    while not study.final and time.monotonic() < deadline:
        if seen is not None and not matches(seen, study_etag(study)):
            break
        await asyncio.sleep(min(LOOK_S, max(deadline - time.monotonic(), 0.0)))
        study = await run_in_threadpool(find_study, backend, study.id)
    return study


def study_answer(
    backend: Backend, study: StudyRecord, status: int = 200, *, waited_s: float = 0, seen: str | None = None
) -> Response:
    """A study in full, with the headers that go with it; 304 where the client has seen it."""
    headers = {"ETag": study_etag(study), "Cache-Control": "no-cache", "Content-Location": f"/v1/studies/{study.id}"}
    if not study.final:
        headers["Retry-After"] = "2"
    if waited_s > 0:
        headers["Preference-Applied"] = f"wait={int(waited_s)}"
    if matches(seen, headers["ETag"]):
        return Response(None, 304, headers)
    return Response(study_view(backend, study).model_dump_json(), status, headers, "application/json")


def study_file(backend: Backend, study_id: str, name: str, seen: str | None) -> Response:
    """A file of a study, from the rows as they stand.

    Raises
    ------
    Problem
        ``study-not-found`` or ``artifact-not-found``.
    """
    study = find_study(backend, study_id)
    if name not in FILES:
        raise Problem("artifact-not-found", f"A study has no file '{name}'.", f"It has {', '.join(FILES)}.")
    table = study_table(study)
    etag = picture_etag(table)
    headers = {**SAFE, "ETag": etag, "Cache-Control": "no-cache", "Content-Disposition": f"inline; filename={name}"}
    if matches(seen, etag):
        return Response(None, 304, headers)
    makers = {"table.csv": table.to_csv, "table.json": table.to_json, "table.html": table.to_html}
    content: str | bytes = makers[name]() if name in makers else picture(table)
    return Response(content, 200, headers, FILES[name])
