"""Calls about the files of a design."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Path
from fastapi.responses import Response

from dualms.steps import MEDIA_TYPES
from service.artifacts.sending import AskedDep, Blob, contents, send_blob
from service.backend import BackendDep
from service.designs.endpoints import DesignId
from service.problems import Problem, answers

router = APIRouter(prefix="/v1/designs", tags=["artifacts"])

_BYTES = contents("application/octet-stream", *MEDIA_TYPES.values())
_ANSWERS: dict[int | str, dict[str, Any]] = {
    200: _BYTES,
    206: {"description": "The range that was asked for.", **_BYTES},
    304: {"description": "Unchanged."},
    307: {"description": "The bytes are at another address (S3)."},
    **answers(404, 416, 422),
}


@router.head("/{design_id}/artifacts/{name}", response_class=Response, responses=_ANSWERS)
@router.get("/{design_id}/artifacts/{name}", response_class=Response, responses=_ANSWERS)
def get_artifact(
    backend: BackendDep,
    design_id: DesignId,
    name: Annotated[str, Path(max_length=128, description="Such as `solid.3mf`; GET /v1/designs/{id} lists them.")],
    ask: AskedDep,
) -> Response:
    """The bytes of an artifact."""
    row = backend.records.artifact(design_id, name)
    if row is None or row.internal:
        status = backend.design(design_id).status
        advice = "Artifacts appear as their step ends; GET /v1/designs/{id} lists those there are."
        raise Problem("artifact-not-found", f"The design ({status}) has no artifact '{name}'.", advice)
    return send_blob(backend, Blob(row.sha256, row.size, row.media_type, row.name), ask)
