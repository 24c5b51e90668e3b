"""Calls about designs."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Depends, Header, Path, Request
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import Response

from service.access import CallerDep, note
from service.backend import BackendDep, backend_of, design_not_found
from service.conditional import wait_s
from service.designs.following import design_answer, follow, wait_for
from service.designs.listing import Filters, list_page
from service.designs.requests import read_request
from service.designs.schemas import DesignOut, DesignPage
from service.designs.submission import submit
from service.designs.views import FINAL
from service.events import event_stream, last_event_id
from service.problems import answers

router = APIRouter(prefix="/v1/designs", tags=["designs"])

DesignId = Annotated[str, Path(pattern="^[0-9a-f]{32}$", description="Id of a design.")]
Prefer = Annotated[str | None, Header(description="`wait=N`: answer after up to N seconds, when there is news.")]

_HEADERS = {
    "Location": {"description": "Address of the design.", "schema": {"type": "string"}},
    "Retry-After": {"description": "Seconds to the next look.", "schema": {"type": "integer"}},
    "ETag": {"description": "Changes with the design.", "schema": {"type": "string"}},
}


# First of all, since routes are tried in this order and this is the call that is made most.
@router.get(
    "/{design_id}", response_model=DesignOut, responses={304: {"description": "Unchanged."}, **answers(404, 422)}
)
async def get_design(
    request: Request,
    design_id: DesignId,
    if_none_match: Annotated[str | None, Header(description="304 while the ETag is this one.")] = None,
    prefer: Prefer = None,
) -> Response:
    """Where a design stands; with `Prefer: wait=N` when it ends, or, with If-None-Match too, when it changes."""
    backend = await backend_of(request)  # injected it would cost a tenth of the call
    return await follow(backend, design_id, wait_s(prefer, backend.settings.max_wait_s), if_none_match)


@router.post("", status_code=202, response_model=DesignOut,
             responses={202: {"headers": _HEADERS}, **answers(400, 404, 413, 415, 422)})  # fmt: skip
async def create_design(
    backend: BackendDep,
    caller: CallerDep,
    request: Request,
    idempotency_key: Annotated[str | None, Header(description="The same key and body give the same design.")] = None,
    prefer: Prefer = None,
) -> Response:
    """Ask for a design: JSON that names an uploaded domain, or a form with the file and the spec."""
    wanted = await read_request(backend, caller, request)
    row = await run_in_threadpool(submit, backend, caller, wanted, idempotency_key)
    if (patience := wait_s(prefer, backend.settings.max_wait_s)) > 0:
        await wait_for(backend, row, patience, lambda r: r.status in FINAL)
        row = await run_in_threadpool(backend.design, row.id)
    answer = await run_in_threadpool(design_answer, backend, row, 202, patience)
    answer.headers["Location"] = f"/v1/designs/{row.id}"
    return answer


@router.get("", responses=answers(422))
def list_designs(backend: BackendDep, caller: CallerDep, filters: Annotated[Filters, Depends()]) -> DesignPage:
    """Designs, newest first."""
    return list_page(backend, filters, caller.only)


@router.get("/{design_id}/events", response_class=Response,
            responses={200: {"content": {"text/event-stream": {}}}, 204: {"description": "Nothing more will come."},
                       **answers(400, 404, 422)})  # fmt: skip
def get_events(
    backend: BackendDep, design_id: DesignId,
    last: Annotated[str | None, Header(alias="Last-Event-ID", description="Go on after this event.")] = None,
) -> Response:  # fmt: skip
    """What happens to a design, as server-sent events."""
    return event_stream(backend, design_id, last_event_id(last))


@router.post("/{design_id}/cancel", response_model=DesignOut, responses=answers(404, 422))
def cancel_design(backend: BackendDep, caller: CallerDep, design_id: DesignId) -> Response:
    """Cancel a design; one that has ended stays as it is."""
    row = backend.records.cancel(design_id)
    if row is None:
        raise design_not_found(design_id)
    note(backend, caller, "design.cancel", design_id)
    return design_answer(backend, row)


@router.delete("/{design_id}", status_code=204, responses=answers(404, 422))
def delete_design(backend: BackendDep, caller: CallerDep, design_id: DesignId) -> Response:
    """Forget a design and its artifacts; one that runs is cancelled first."""
    if not backend.records.delete(design_id):
        raise design_not_found(design_id)
    note(backend, caller, "design.delete", design_id)
    return Response(None, 204)
