"""Calls about studies."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Header, Path, Query
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import Response

from service.access import CallerDep, note
from service.artifacts.sending import contents
from service.backend import BackendDep
from service.conditional import wait_s
from service.designs.endpoints import Prefer
from service.problems import answers
from service.studies.following import find_study, follow_study, study_answer, study_file, study_not_found
from service.studies.schemas import StudyIn, StudyOut, StudyPage
from service.studies.submission import submit_study
from service.studies.views import FILES, study_summary
from worker.studies import Studies

router = APIRouter(prefix="/v1/studies", tags=["studies"])

StudyId = Annotated[str, Path(pattern="^[0-9a-f]{32}$", description="Id of a study.")]
Seen = Annotated[str | None, Header(alias="If-None-Match", description="304 while the ETag is this one.")]

_HEADERS = {
    "Location": {"description": "Address of the study.", "schema": {"type": "string"}},
    "Retry-After": {"description": "Seconds to the next look.", "schema": {"type": "integer"}},
    "ETag": {"description": "Changes with the study.", "schema": {"type": "string"}},
}
_BYTES = contents(*FILES.values())


@router.post("", status_code=202, response_model=StudyOut,
             responses={202: {"headers": _HEADERS}, **answers(400, 404, 413, 422)})  # fmt: skip
async def create_study(
    backend: BackendDep,
    caller: CallerDep,
    wanted: StudyIn,
    idempotency_key: Annotated[str | None, Header(description="The same key and body give the same study.")] = None,
    prefer: Prefer = None,
) -> Response:
    """Ask for a design at every point of a grid over the specification."""
    study = await run_in_threadpool(submit_study, backend, caller, wanted, idempotency_key)
    patience = wait_s(prefer, backend.settings.max_wait_s)
    study = await follow_study(backend, study, patience, None)
    answer = await run_in_threadpool(study_answer, backend, study, 202, waited_s=patience)
    answer.headers["Location"] = f"/v1/studies/{study.id}"
    return answer


@router.get("", responses=answers(422))
def list_studies(
    backend: BackendDep,
    caller: CallerDep,
    limit: Annotated[int, Query(ge=1, le=100, description="Studies a page.")] = 20,
    cursor: Annotated[str | None, Query(pattern="^[0-9a-f]{32}$", description="From the page before.")] = None,
) -> StudyPage:
    """Studies, newest first."""
    studies, following = Studies(backend.records).page(limit, cursor, caller.only)
    address = f"/v1/studies?limit={limit}&cursor={following}" if following else None
    return StudyPage(items=[study_summary(backend, study) for study in studies], next=address)


@router.get("/{study_id}", response_model=StudyOut,
            responses={304: {"description": "Unchanged."}, **answers(404, 422)})  # fmt: skip
async def get_study(backend: BackendDep, study_id: StudyId, seen: Seen = None, prefer: Prefer = None) -> Response:
    """Where a study stands; with `Prefer: wait=N` when it ends, or, with If-None-Match too, when it changes."""
    study = await run_in_threadpool(find_study, backend, study_id)
    patience = wait_s(prefer, backend.settings.max_wait_s)
    study = await follow_study(backend, study, patience, seen)
    return await run_in_threadpool(study_answer, backend, study, waited_s=patience, seen=seen)


@router.post("/{study_id}/cancel", response_model=StudyOut, responses=answers(404, 422))
def cancel_study(backend: BackendDep, caller: CallerDep, study_id: StudyId) -> Response:
    """Cancel all designs of a study; those that have ended stay as they are."""
    study = Studies(backend.records).cancel(study_id)
    if study is None:
        raise study_not_found(study_id)
    note(backend, caller, "study.cancel", study_id)
    return study_answer(backend, study)


@router.delete("/{study_id}", status_code=204, responses=answers(404, 422))
def delete_study(backend: BackendDep, caller: CallerDep, study_id: StudyId) -> Response:
    """Forget a study with its designs and their artifacts; those that run are cancelled first."""
    if not Studies(backend.records).delete(study_id):
        raise study_not_found(study_id)
    note(backend, caller, "study.delete", study_id)
    return Response(None, 204)


@router.get("/{study_id}/artifacts/{name}", response_class=Response,
            responses={200: _BYTES, 304: {"description": "Unchanged."}, **answers(404, 422)})  # fmt: skip
def get_study_file(
    backend: BackendDep,
    study_id: StudyId,
    name: Annotated[str, Path(max_length=64, description="table.csv, table.json, table.html or picture.png.")],
    seen: Seen = None,
) -> Response:
    """The table or the picture, as the rows stand."""
    return study_file(backend, study_id, name, seen)
