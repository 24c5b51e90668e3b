"""Calls about domains."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, File, Form, Path, Query, UploadFile
from fastapi.responses import Response

from dualms.spec import Unit
from service.access import CallerDep, note
from service.artifacts.sending import AskedDep, Blob, contents, send_blob
from service.backend import BackendDep
from service.domains.schemas import DomainOut, DomainPage
from service.domains.uploads import forget, receive
from service.domains.views import domain_view
from service.problems import answers
from worker.domains import Domains

router = APIRouter(prefix="/v1/domains", tags=["domains"])

_BYTES = contents("application/octet-stream")
_FILE: dict[int | str, dict[str, Any]] = {
    200: _BYTES,
    206: {"description": "The range that was asked for.", **_BYTES},
    304: {"description": "Unchanged."},
    307: {"description": "The bytes are at another address (S3)."},
    **answers(404, 416, 422),
}
DomainId = Annotated[str, Path(pattern="^[0-9a-f]{64}$", description="Id of a domain.")]


@router.post("", status_code=201, responses=answers(400, 404, 413, 415, 422))
async def upload_domain(
    backend: BackendDep,
    response: Response,
    caller: CallerDep,
    file: Annotated[UploadFile | None, File(description="STL, OBJ, PLY, OFF, GLB, 3MF or STEP.")] = None,
    sha256: Annotated[
        str | None, Form(pattern="^[0-9a-f]{64}$", description="Instead of the file: the hash of one sent before.")
    ] = None,
    units: Annotated[
        Unit | None, Form(description="Needed where the format carries none (all but GLB, 3MF, STEP).")
    ] = None,
) -> DomainOut:
    """Upload an envelope, or name one by its hash. The same bytes again give the same record."""
    row = await backend.turns.upload(lambda: receive(backend, caller, file, sha256, units))
    response.headers["Location"] = f"/v1/domains/{row.id}"
    return domain_view(row)


@router.get("", responses=answers(422))
def list_domains(
    backend: BackendDep,
    caller: CallerDep,
    limit: Annotated[int, Query(ge=1, le=200, description="Domains a page.")] = 50,
    cursor: Annotated[str | None, Query(pattern="^[0-9a-f]{64}$", description="From the page before.")] = None,
) -> DomainPage:
    """Domains, newest first."""
    rows, following = Domains(backend.records).page(limit, cursor, caller.only)
    address = f"/v1/domains?limit={limit}&cursor={following}" if following else None
    return DomainPage(items=[domain_view(row) for row in rows], next=address)


@router.get("/{domain_id}", responses=answers(404, 422))
def get_domain(backend: BackendDep, domain_id: DomainId) -> DomainOut:
    """What is known of a domain."""
    return domain_view(backend.domain(domain_id))


@router.head("/{domain_id}/file", response_class=Response, responses=_FILE)
@router.get("/{domain_id}/file", response_class=Response, responses=_FILE)
def get_domain_file(backend: BackendDep, domain_id: DomainId, ask: AskedDep) -> Response:
    """The file as it was uploaded."""
    row = backend.domain(domain_id)
    return send_blob(backend, Blob(row.sha256, row.size, "application/octet-stream", row.name), ask, download=True)


@router.delete("/{domain_id}", status_code=204, responses=answers(404, 409, 422))
def delete_domain(backend: BackendDep, caller: CallerDep, domain_id: DomainId) -> Response:
    """Forget a domain that no design and no study uses."""
    forget(backend, domain_id)
    note(backend, caller, "domain.delete", domain_id)
    return Response(None, 204)
