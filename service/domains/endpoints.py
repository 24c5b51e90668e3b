"""Calls about domains."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, File, Form, Path, UploadFile
from fastapi.responses import Response

from dualms.spec import Unit
from service.access import CallerDep
from service.artifacts.sending import AskedDep, Blob, send_blob
from service.backend import BackendDep
from service.domains.schemas import DomainOut
from service.domains.uploads import receive_domain
from service.domains.views import domain_view
from service.problems import answers

router = APIRouter(prefix="/v1/domains", tags=["domains"])

DomainId = Annotated[str, Path(pattern="^[0-9a-f]{64}$", description="Id of a domain.")]


@router.post("", status_code=201, responses=answers(400, 413, 415, 422))
def upload_domain(
    backend: BackendDep,
    response: Response,
    file: Annotated[UploadFile, File(description="STL, OBJ, PLY, OFF, GLB, 3MF or STEP.")],
    caller: CallerDep,
    units: Annotated[
        Unit | None, Form(description="Needed where the format carries none (all but GLB, 3MF, STEP).")
    ] = None,
) -> DomainOut:
    """Upload an envelope. The same bytes again give the same record."""
    row = receive_domain(backend, caller, file.file, file.filename or "", units)
    response.headers["Location"] = f"/v1/domains/{row.id}"
    return domain_view(row)


@router.get("/{domain_id}", responses=answers(404, 422))
def get_domain(backend: BackendDep, domain_id: DomainId) -> DomainOut:
    """What is known of a domain."""
    return domain_view(backend.domain(domain_id))


@router.head("/{domain_id}/file", response_class=Response, responses=answers(404, 416, 422))
@router.get("/{domain_id}/file", response_class=Response, responses=answers(404, 416, 422))
def get_domain_file(backend: BackendDep, domain_id: DomainId, ask: AskedDep) -> Response:
    """The file as it was uploaded."""
    row = backend.domain(domain_id)
    return send_blob(backend, Blob(row.sha256, row.size, "application/octet-stream", row.name), ask, download=True)
