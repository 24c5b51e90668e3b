"""The committed OpenAPI document is the one that the code has."""

from __future__ import annotations

import json
from typing import Any

import pytest

from service.openapi import DEFAULT, document


@pytest.fixture(scope="module")
def api() -> dict[str, Any]:
    return json.loads(document())


def test_committed_document_is_current() -> None:
    assert DEFAULT.read_text(encoding="utf-8") == document(), "run: python -m service.openapi"


def test_every_reference_resolves(api: dict[str, Any]) -> None:
    schemas = api["components"]["schemas"]

    def walk(node: Any) -> None:
        if isinstance(node, dict):
            if "$ref" in node:
                assert node["$ref"].removeprefix("#/components/schemas/") in schemas
            for value in node.values():
                walk(value)
        elif isinstance(node, list):
            for value in node:
                walk(value)

    walk(api)


def test_the_promised_calls_are_there(api: dict[str, Any]) -> None:
    calls = {f"{method.upper()} {path}" for path, item in api["paths"].items() for method in item}
    assert calls >= {
        "POST /v1/domains",
        "GET /v1/domains/{domain_id}",
        "GET /v1/domains/{domain_id}/file",
        "POST /v1/designs",
        "GET /v1/designs",
        "GET /v1/designs/{design_id}",
        "GET /v1/designs/{design_id}/events",
        "POST /v1/designs/{design_id}/cancel",
        "DELETE /v1/designs/{design_id}",
        "GET /v1/designs/{design_id}/artifacts/{name}",
        "POST /v1/studies",
        "GET /v1/studies/{study_id}",
        "POST /v1/studies/{study_id}/cancel",
        "DELETE /v1/studies/{study_id}",
        "GET /v1/studies/{study_id}/artifacts/{name}",
        "GET /healthz",
        "GET /readyz",
        "GET /metrics",
    }


def test_answers_have_no_defaults_and_all_fields_are_required(api: dict[str, Any]) -> None:
    for name in (
        "DomainOut",
        "FacetOut",
        "DesignOut",
        "DesignSummary",
        "ArtifactOut",
        "ErrorOut",
        "ProblemDocument",
        "StudyOut",
        "StudySummary",
        "RowOut",
        "CountsOut",
    ):
        schema = api["components"]["schemas"][name]
        assert set(schema["required"]) == set(schema["properties"]), name
        assert not [k for k, p in schema["properties"].items() if "default" in p], name


def test_status_and_stage_are_closed_enumerations(api: dict[str, Any]) -> None:
    schemas = api["components"]["schemas"]
    assert schemas["Status"]["enum"] == ["queued", "running", "succeeded", "failed", "cancelled"]
    assert schemas["Stage"]["enum"] == (
        ["domain", "flow", "graph", "partition", "skeletons", "field", "surface", "body", "report", "evaluation"]
    )


def test_every_call_documents_its_refusals_as_problem_documents(api: dict[str, Any]) -> None:
    for path, item in api["paths"].items():
        if path.startswith("/v1"):
            for method, call in item.items():
                problems = [r for s, r in call["responses"].items() if s.startswith(("4", "5"))]
                assert problems, (method, path)
                assert all("application/problem+json" in r["content"] for r in problems), (method, path)
