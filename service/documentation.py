"""The OpenAPI document: what FastAPI derives, completed by what it cannot see.

The body of POST /v1/designs is read by hand (JSON or a form), and refusals are problem documents.
"""

from __future__ import annotations

import json
from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi
from pydantic.json_schema import models_json_schema

from service.designs.schemas import DesignIn
from service.problems import ProblemDocument

Schemas = dict[str, Any]

_KEY = "key"
_BEARER = {"type": "http", "scheme": "bearer", "description": "An API key: `dualms keys create`."}
_TEMPLATE = "#/components/schemas/{model}"


def describe(app: FastAPI) -> None:
    """Make ``app.openapi()`` complete."""

    def openapi() -> dict[str, Any]:
        if app.openapi_schema is None:
            app.openapi_schema = _document(app)
        return app.openapi_schema

    app.openapi = openapi  # type: ignore[method-assign]


def _document(app: FastAPI) -> dict[str, Any]:
    document = get_openapi(
        title=app.title,
        version=app.version,
        summary=app.summary,
        description=app.description,
        routes=app.routes,
        license_info=app.license_info,
    )
    schemas: Schemas = document["components"]["schemas"]
    for unused in ("HTTPValidationError", "ValidationError"):
        schemas.pop(unused, None)
    _, problem = models_json_schema([(ProblemDocument, "serialization")], ref_template=_TEMPLATE)
    schemas.update(problem["$defs"])
    _, sent = models_json_schema([(DesignIn, "validation")], ref_template=_TEMPLATE)
    schemas.update(_told_apart(sent["$defs"], schemas))
    _say_that_keys_are_asked_for(document)
    document["paths"]["/v1/designs"]["post"]["requestBody"] = _design_body(schemas)
    _complete_domain_form(document["paths"]["/v1/domains"]["post"]["requestBody"]["content"], schemas)
    return document


def _say_that_keys_are_asked_for(document: dict[str, Any]) -> None:
    """Every call under /v1 asks for a key: :func:`service.access.guard` reads it itself."""
    document["components"]["securitySchemes"] = {_KEY: _BEARER}
    for path, operations in document["paths"].items():
        if path.startswith("/v1/"):
            for operation in operations.values():
                operation["security"] = [{_KEY: []}]


def _told_apart(sent: Schemas, known: Schemas) -> Schemas:
    """Schemas of what is sent, renamed where an answer's schema of the same name differs, with all that lead there."""
    renamed: set[str] = set()
    while True:
        mapped = {name: _renamed(schema, renamed) for name, schema in sent.items()}
        more = {n for n, schema in mapped.items() if n not in renamed and n in known and schema != known[n]}
        if not more:
            return {f"{n}-Input" if n in renamed else n: schema for n, schema in mapped.items()}
        renamed |= more


def _renamed(schema: Any, names: set[str]) -> Any:
    text = json.dumps(schema)
    for name in names:
        text = text.replace(f'"{_TEMPLATE.format(model=name)}"', f'"{_TEMPLATE.format(model=name)}-Input"')
    return json.loads(text)


def _complete_domain_form(content: Any, schemas: Schemas) -> None:
    """A file or the hash of one; the file's name carries its format."""
    form = content["multipart/form-data"]
    form["encoding"] = _file_encoding("file")
    name = form["schema"]["$ref"].rpartition("/")[2]
    schemas[name]["oneOf"] = [{"required": ["file"]}, {"required": ["sha256"]}]


def _file_encoding(field: str) -> Any:
    example = f'form-data; name="{field}"; filename="envelope.stl"'
    text = "The file's name tells its format by its extension."
    return {field: {"headers": {"Content-Disposition": {"description": text, "schema": {"type": "string"},
                                                        "example": example}}}}  # fmt: skip


def _design_body(schemas: Schemas) -> dict[str, Any]:
    spec = "Spec-Input" if "Spec-Input" in schemas else "Spec"
    options = schemas["DesignIn"]["properties"]
    form = {
        "type": "object",
        "required": ["domain", "spec"],
        "additionalProperties": False,
        "properties": {
            "domain": {"type": "string", "format": "binary", "description": "The envelope's file."},
            "spec": {"$ref": _TEMPLATE.format(model=spec)},
            "name": {"type": "string", "minLength": 1, "maxLength": 200, "description": options["name"]["description"]},
            "labels": {"type": "string", "description": "For filters, with commas between."},
            "webhook": {"type": "string", "maxLength": 2000, "pattern": "^https?://"},
            "deadline_s": {
                "type": "number",
                "exclusiveMinimum": 0,
                "description": options["deadline_s"]["description"],
            },
            "priority": options["priority"],
        },
    }
    return {
        "required": True,
        "content": {
            "application/json": {"schema": {"$ref": _TEMPLATE.format(model="DesignIn")}},
            "multipart/form-data": {
                "schema": form,
                "encoding": {**_file_encoding("domain"), "spec": {"contentType": "application/json"}},
            },
        },
    }
