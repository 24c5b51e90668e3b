"""The OpenAPI document: what FastAPI derives, with our problem documents in place of its own."""

from __future__ import annotations

from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi
from pydantic.json_schema import models_json_schema

from service.designs.schemas import DesignIn
from service.problems import ProblemDocument

_PREFIX = "#/components/schemas/{model}"


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
        routes=app.routes,
        license_info=app.license_info,
    )
    schemas = document["components"]["schemas"]
    for unused in ("HTTPValidationError", "ValidationError"):
        schemas.pop(unused, None)
    _, extra = models_json_schema([(DesignIn, "validation"), (ProblemDocument, "serialization")], ref_template=_PREFIX)
    for name, schema in extra["$defs"].items():
        schemas.setdefault(name, schema)
    return document
