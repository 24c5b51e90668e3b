"""What the service says of itself: readiness, metrics, pages for people, its document."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import httpx

from tests.service.designs import artifact, small

if TYPE_CHECKING:
    from conftest import Served


def test_readiness_tells_of_store_broker_and_workers(served: Served) -> None:
    facts = served.http.get("/readyz").json()
    assert (facts["ready"], facts["store"], facts["broker"]) == (True, True, True)
    assert "cpu" in {w["queue"] for w in facts["workers"]}


def test_metrics_count_requests_and_designs(served: Served, made: dict[str, Any]) -> None:
    text = served.http.get("/metrics").text
    assert 'dualms_designs{status="succeeded"}' in text
    assert 'dualms_workers{queue="cpu"} 1.0' in text
    assert 'route="/v1/designs/{design_id}"' in text


def test_landing_page_shows_the_design_and_needs_no_other_host(
    served: Served, domain_id: str, made: dict[str, Any]
) -> None:
    body = {"domain": domain_id, "spec": small(), "name": "<script>alert(1)</script>"}
    design = served.http.post("/v1/designs", json=body).json()
    ended = served.ended(design["id"])
    page = served.http.get("/").text
    assert "&lt;script&gt;alert(1)" in page
    assert "<script>" not in page
    assert artifact(ended, "preview.png")["href"] in page
    assert "//cdn" not in page
    assert 'src="http' not in page


def test_reference_page_shows_every_call_and_needs_no_other_host(served: Served) -> None:
    page = served.http.get("/docs").text
    for path in served.http.get("/openapi.json").json()["paths"]:
        assert f"<code>{path}</code>" in page
    assert 'src="' not in page
    assert "transverse_weight" in page


def test_answers_are_the_ones_that_the_document_promises(served: Served, made: dict[str, Any]) -> None:
    assert set(made) == set(
        httpx.get(f"{served.url}/openapi.json").json()["components"]["schemas"]["DesignOut"]["properties"]
    )
