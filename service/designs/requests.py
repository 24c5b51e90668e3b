"""Reading POST /v1/designs: JSON that names a domain, or a form that carries the domain's file."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from typing import Any, TypeVar

from fastapi import Request
from fastapi.concurrency import run_in_threadpool
from pydantic import BaseModel, ValidationError
from starlette.datastructures import FormData, UploadFile

from dualms.spec import Spec
from service.access import Caller, may_use_domain
from service.backend import Backend
from service.designs.schemas import DesignIn, DesignOptions
from service.domains.uploads import receive_domain, sent
from service.problems import FieldProblem, Problem, from_validation
from worker.views import DomainRecord

M = TypeVar("M", bound=BaseModel)

MAX_SPEC_BYTES = 1024**2
JSON_ADVICE = "Send one JSON object, as GET /openapi.json describes it."
_FORM_FIELDS = frozenset({"domain", "spec", "name", "labels", "webhook", "deadline_s", "priority"})


@dataclass(frozen=True)
class Wanted:
    """A design that a client asks for.

    Parameters
    ----------
    domain
        Its domain.
    spec
        As it was sent.
    options
        Name, labels, deadline.
    sha256
        Hash of the request, for idempotency keys.
    """

    domain: DomainRecord
    spec: Spec
    options: DesignOptions
    sha256: str


async def read_request(backend: Backend, caller: Caller, request: Request) -> Wanted:
    """Read and check the body.

    Raises
    ------
    Problem, DualMSError
        If it cannot be a design.
    """
    kind = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    if kind == "application/json":
        return await run_in_threadpool(_from_json, backend, caller, await request.body())
    if kind == "multipart/form-data":
        async with request.form(max_files=2, max_fields=40, max_part_size=MAX_SPEC_BYTES) as form:
            return await backend.turns.upload(lambda: _from_form(backend, caller, form))
    raise Problem(
        "unsupported-media-type",
        f"The body is {kind or 'of no stated type'}.",
        "Send application/json, or multipart/form-data with the domain's file and the spec.",
    )


def _from_json(backend: Backend, caller: Caller, body: bytes) -> Wanted:
    sent = _model(DesignIn, _json(body, "The body"))
    options = DesignOptions(**sent.model_dump(include=set(DesignOptions.model_fields)))
    domain = backend.domain(sent.domain)
    may_use_domain(caller, domain.owner, domain.id)
    return Wanted(domain, sent.spec, options, _digest(sent.domain, sent.spec, options))


def _from_form(backend: Backend, caller: Caller, form: FormData) -> Wanted:
    unknown = sorted(set(form) - _FORM_FIELDS)
    if unknown:
        fields = [FieldProblem(field=name, message="Unknown form field") for name in unknown]
        raise Problem("invalid-request", f"{unknown[0]}: Unknown form field", _form_advice(), errors=fields)
    file, text = form.get("domain"), form.get("spec")
    if not isinstance(file, UploadFile):
        raise _missing("domain", "The form has no file 'domain'")
    if text is None:
        raise _missing("spec", "The form has no field 'spec'")
    body = text.file.read(MAX_SPEC_BYTES + 1) if isinstance(text, UploadFile) else text.encode()
    spec = _model(Spec, _json(body, "The form's field 'spec'"), "spec")
    options = _model(DesignOptions, _options(form))
    domain = receive_domain(backend, caller, sent(file.file, file.filename or ""), spec.units)
    return Wanted(domain, spec, options, _digest(domain.id, spec, options))


def _options(form: FormData) -> dict[str, Any]:
    options: dict[str, Any] = {k: form[k] for k in ("name", "webhook", "deadline_s", "priority") if k in form}
    if "labels" in form:
        options["labels"] = [label for text in form.getlist("labels") for label in str(text).split(",") if label]
    return options


def _json(body: bytes, what: str) -> Any:
    try:
        return json.loads(body, parse_constant=_no_constant)
    except (ValueError, RecursionError) as error:
        reason = str(error) if isinstance(error, json.JSONDecodeError) else "wrong encoding, numbers or depth"
        raise Problem("malformed-request", f"{what} is not JSON: {reason}.", JSON_ADVICE) from None


def _no_constant(name: str) -> float:
    raise ValueError(f"{name} is not JSON")


def _model(kind: type[M], document: Any, prefix: str = "") -> M:
    try:
        return kind.model_validate(document)
    except ValidationError as error:
        raise from_validation(error.errors(), document, prefix) from None


def _digest(domain_id: str, spec: Spec, options: DesignOptions) -> str:
    document = [domain_id, spec.model_dump(mode="json"), options.model_dump(mode="json")]
    return hashlib.sha256(json.dumps(document, sort_keys=True).encode()).hexdigest()


def _missing(field: str, message: str) -> Problem:
    return Problem(
        "invalid-request", message + ".", _form_advice(), errors=[FieldProblem(field=field, message=message)]
    )


def _form_advice() -> str:
    return "Send the file as 'domain' and the JSON as 'spec'; beside them name, labels, webhook, deadline_s, priority."
