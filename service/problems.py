"""What went wrong, as ``application/problem+json`` (RFC 9457): one table code -> HTTP status, one way out."""

from __future__ import annotations

import logging
import re
import secrets
from collections.abc import Mapping, Sequence
from http import HTTPStatus
from typing import Any

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse, Response
from pydantic import BaseModel, ConfigDict, Field
from sqlalchemy.exc import OperationalError
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect

from dualms.errors import DualMSError
from dualms.spec.refused import refused
from worker.artifacts import StoreAway, StoreFull

log = logging.getLogger("dualms.service")

MEDIA_TYPE = "application/problem+json"
TYPE_PREFIX = "urn:dualms:problem:"

# Every code that an answer may carry. A failed design's `error.code` comes from the same list and the workers'.
STATUS: dict[str, int] = {
    # the request
    "malformed-request": 400,
    "key-required": 401,
    "key-invalid": 401,
    "scope-missing": 403,
    "cross-site": 403,
    "not-found": 404,
    "domain-not-found": 404,
    "design-not-found": 404,
    "artifact-not-found": 404,
    "study-not-found": 404,
    "method-not-allowed": 405,
    "domain-in-use": 409,
    "too-large": 413,
    "unsupported-media-type": 415,
    "unsupported-format": 415,
    "range-not-satisfiable": 416,
    "invalid-request": 422,
    "webhook-refused": 422,
    "invalid-cursor": 422,
    "idempotency-key-reused": 422,
    # the domain file
    "unreadable-file": 422,
    "invalid-mesh": 422,
    "missing-units": 422,
    # the specification
    "invalid-spec": 422,
    "port-not-on-boundary": 422,
    "overlapping-ports": 422,
    "disconnected-domain": 422,
    "infeasible-partition": 422,
    "wall-too-thick": 422,
    "evaluation-unavailable": 422,
    "study-too-large": 422,
    "quota-exceeded": 429,
    # the service
    "internal-error": 500,
    "store-unavailable": 503,
    "storage-full": 507,
    "not-ready": 503,
}
TITLES: dict[str, str] = {
    "malformed-request": "The request cannot be read",
    "key-required": "An API key is needed",
    "key-invalid": "The API key is not valid",
    "scope-missing": "The API key does not allow this",
    "cross-site": "Pages of other sites may not do this",
    "webhook-refused": "The webhook's address cannot be used",
    "quota-exceeded": "A quota would be exceeded",
    "not-found": "There is nothing at this address",
    "domain-not-found": "There is no such domain",
    "design-not-found": "There is no such design",
    "artifact-not-found": "There is no such artifact",
    "study-not-found": "There is no such study",
    "method-not-allowed": "This address does not answer to that method",
    "domain-in-use": "The domain is in use",
    "too-large": "The input exceeds a limit",
    "unsupported-media-type": "The body's media type is not accepted here",
    "unsupported-format": "The file format is not read",
    "range-not-satisfiable": "The asked range lies outside the file",
    "invalid-request": "The request has invalid fields",
    "invalid-cursor": "The cursor is not one of this service",
    "idempotency-key-reused": "The idempotency key was used with another body",
    "unreadable-file": "The file cannot be read",
    "invalid-mesh": "The mesh cannot be an envelope",
    "missing-units": "The length unit is missing",
    "invalid-spec": "The specification contradicts itself or the domain",
    "port-not-on-boundary": "A port misses the domain's boundary",
    "overlapping-ports": "Two ports overlap",
    "disconnected-domain": "The domain is not connected",
    "infeasible-partition": "No partition meets the constraints",
    "wall-too-thick": "The wall leaves no room",
    "evaluation-unavailable": "No worker can solve the flow",
    "study-too-large": "The study has too many points",
    "internal-error": "Something broke in the service",
    "store-unavailable": "The store cannot be reached",
    "storage-full": "The service has no room left",
    "not-ready": "The service is not ready",
}
_BY_HTTP = {
    400: "malformed-request",
    404: "not-found",
    405: "method-not-allowed",
    413: "too-large",
    415: "unsupported-media-type",
}


class FieldProblem(BaseModel):
    """One field of the request that does not fit."""

    model_config = ConfigDict(frozen=True)
    field: str = Field(description="Path of the field, such as `spec.fluids.hot.inlets.0.radius`.")
    message: str


class ProblemDocument(BaseModel):
    """An error, as RFC 9457 has it."""

    model_config = ConfigDict(frozen=True)
    type: str = Field(description="A URN that ends in the code.")
    title: str
    status: int
    detail: str = Field(description="What is wrong, with the measured value and where.")
    code: str = Field(description="Stable; for programs.")
    advice: str = Field(description="What to try.")
    measured: dict[str, Any] = Field(description="The figures behind the detail.")
    errors: list[FieldProblem] = Field(description="The fields that do not fit, if any.")


class Problem(HTTPException):
    """A request that is answered with a problem document.

    Parameters
    ----------
    code
        One of ``STATUS``.
    detail, advice, measured
        As in ``ProblemDocument``.
    """

    def __init__(
        self,
        code: str,
        detail: str,
        advice: str = "",
        *,
        measured: Mapping[str, object] | None = None,
        errors: Sequence[FieldProblem] = (),
        headers: Mapping[str, str] | None = None,
    ) -> None:
        super().__init__(STATUS[code], detail, dict(headers or {}))
        self.code, self.advice = code, advice
        self.measured, self.errors = dict(measured or {}), list(errors)

    def document(self) -> ProblemDocument:
        """The document that the client gets."""
        return ProblemDocument(
            type=TYPE_PREFIX + self.code,
            title=TITLES[self.code],
            status=self.status_code,
            detail=self.detail,
            code=self.code,
            advice=self.advice,
            measured=self.measured,
            errors=self.errors,
        )

    def response(self) -> Response:
        """The whole answer."""
        document = self.document()
        return JSONResponse(document.model_dump(), document.status, self.headers, MEDIA_TYPE)


def from_dualms(error: DualMSError) -> Problem:
    """An input that the library refused."""
    return Problem(
        error.code if error.code in STATUS else "invalid-spec", error.message, error.advice, measured=error.measured
    )


def from_validation(errors: Sequence[Mapping[str, Any]], document: object, prefix: str = "") -> Problem:
    """Fields of a document that pydantic refused; never echoes their values."""
    faults = refused(errors, document)
    fields = [FieldProblem(field=_field(path, prefix), message=message) for path, message in faults[:20]]
    first = fields[0]
    more = f" ({len(faults) - 1} more)" if len(faults) > 1 else ""
    unknown = any(e["type"] == "extra_forbidden" for e in errors)
    advice = "Unknown keys are refused: check the spelling. " if unknown else ""
    advice += "GET /openapi.json has the schema."
    return Problem("invalid-request", f"{first.field}: {first.message}{more}", advice, errors=fields)


def answers(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """What a call's documentation says of its refusals; every call may also break (500)."""
    content = {MEDIA_TYPE: {"schema": {"$ref": "#/components/schemas/ProblemDocument"}}}
    return {s: {"description": HTTPStatus(s).phrase, "model": None, "content": content} for s in (*statuses, 500)}


def install(app: FastAPI) -> None:
    """Answer every failure of ``app`` with a problem document."""

    @app.exception_handler(Problem)
    async def _problem(request: Request, error: Problem) -> Response:
        return error.response()

    @app.exception_handler(DualMSError)
    async def _dualms(request: Request, error: DualMSError) -> Response:
        return from_dualms(error).response()

    @app.exception_handler(RequestValidationError)
    async def _validation(request: Request, error: RequestValidationError) -> Response:
        errors = list(error.errors())
        if any(e["type"] == "json_invalid" for e in errors):
            return Problem("malformed-request", "The body is not JSON.", "Send one JSON object.").response()
        given = {"path": request.path_params, "query": request.query_params, "header": request.headers}
        return from_validation(errors, {**given, "body": error.body}).response()

    @app.exception_handler(HTTPException)
    async def _http(request: Request, error: HTTPException) -> Response:
        code = _BY_HTTP.get(error.status_code)
        if code is None:
            raise error
        headers = dict(error.headers or {})
        if error.status_code == 405 and (methods := _methods_at(app, request.url.path)):
            headers["Allow"] = ", ".join(methods)
        detail = str(error.detail) if code == "malformed-request" else f"{request.method} {request.url.path}"
        return Problem(code, detail, "GET /openapi.json lists the calls.", headers=headers).response()

    @app.exception_handler(ClientDisconnect)
    async def _gone(request: Request, error: ClientDisconnect) -> Response:
        # Nobody reads this; but a client that goes away is no failure of the service.
        return Problem("malformed-request", "The connection ended before the body did.").response()

    @app.exception_handler(OperationalError)
    async def _store_away(request: Request, error: OperationalError) -> Response:
        log.error("the store does not answer: %s", error)
        advice = "Try again in a moment."
        problem = Problem("store-unavailable", "The records cannot be reached.", advice, headers={"Retry-After": "5"})
        return problem.response()

    @app.exception_handler(StoreAway)
    async def _artifacts_away(request: Request, error: StoreAway) -> Response:
        log.error("the artifact store does not answer: %s", error)
        advice = "Try again in a moment."
        problem = Problem("store-unavailable", "The artifacts cannot be reached.", advice, headers={"Retry-After": "5"})
        return problem.response()

    @app.exception_handler(StoreFull)
    async def _store_full(request: Request, error: StoreFull) -> Response:
        log.error("%s", error)
        return Problem("storage-full", "There is no room for the file.", "Tell whoever runs the service.").response()

    @app.exception_handler(Exception)
    async def _unexpected(request: Request, error: Exception) -> Response:
        incident = secrets.token_hex(6)
        job = {"job_id": request.path_params.get("design_id")}
        log.error("incident %s at %s %s", incident, request.method, request.url.path, exc_info=error, extra=job)
        return Problem(
            "internal-error",
            f"The service failed on this request; its log has the cause under {incident}.",
            "Try again; if it stays, send that id to whoever runs the service.",
            measured={"incident": incident},
        ).response()


def _methods_at(app: FastAPI, path: str) -> list[str]:
    """All methods that the OpenAPI document has for a path; Starlette names only those of one route."""
    for template, item in app.openapi()["paths"].items():
        if re.fullmatch(re.sub(r"\{[^}]+\}", "[^/]+", template), path):
            return sorted(method.upper() for method in item)
    return []


def _field(path: tuple[str, ...], prefix: str) -> str:
    """`spec.fluids.hot`, without the part of the request that FastAPI names first."""
    if path[:1] in (("body",), ("query",), ("path",), ("header",)):
        path = path[1:]
    return ".".join((prefix, *path) if prefix else path) or "body"
