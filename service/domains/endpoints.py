"""Calls about domains."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, File, Form, Header, Path, UploadFile
from fastapi.responses import Response

from dualms.spec import Unit
from service.artifacts.sending import send_file
from service.backend import Backend, BackendDep
from service.domains.schemas import DomainOut
from service.domains.uploads import receive_domain
from service.problems import Problem, answers
from worker.records import Domain

router = APIRouter(prefix="/v1/domains", tags=["domains"])

DomainId = Annotated[str, Path(pattern="^[0-9a-f]{64}$", description="Id of a domain.")]


@router.post("", status_code=201, response_model=DomainOut, responses=answers(413, 415, 422))
def upload_domain(
    backend: BackendDep,
    response: Response,
    file: Annotated[UploadFile, File(description="STL, OBJ, PLY, OFF, GLB or 3MF.")],
    units: Annotated[Unit | None, Form(description="Needed where the format carries none (all but GLB, 3MF).")] = None,
) -> DomainOut:
    """Upload an envelope. The same bytes again give the same record."""
    record = receive_domain(backend, file, units)
    response.headers["Location"] = f"/v1/domains/{record.id}"
    return view(record)


@router.get("/{domain_id}", response_model=DomainOut, responses=answers(404, 422))
def get_domain(backend: BackendDep, domain_id: DomainId) -> DomainOut:
    """What is known of a domain."""
    return view(find(backend, domain_id))


@router.get("/{domain_id}/file", response_class=Response, responses=answers(404, 416, 422))
def get_domain_file(
    backend: BackendDep,
    domain_id: DomainId,
    range_: Annotated[str | None, Header(alias="Range")] = None,
    if_range: Annotated[str | None, Header()] = None,
    if_none_match: Annotated[str | None, Header()] = None,
) -> Response:
    """The file as it was uploaded."""
    record = find(backend, domain_id)
    raise NotImplementedError
