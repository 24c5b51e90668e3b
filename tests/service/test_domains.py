"""Envelopes over HTTP: sent once, known by their bytes and units."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
import trimesh

from service.client import Client

if TYPE_CHECKING:
    from conftest import Served


def test_same_bytes_give_the_same_domain_named_by_their_hash(served: Served, box: Path, domain_id: str) -> None:
    answer = served.upload(box)
    assert answer.status_code == 201
    assert answer.json()["id"] == domain_id == hashlib.sha256(box.read_bytes()).hexdigest()
    assert answer.headers["location"] == f"/v1/domains/{domain_id}"
    assert served.http.get(answer.headers["location"]).json() == answer.json()


def test_domain_record_lists_size_and_facets_in_the_file_s_units(served: Served, domain_id: str) -> None:
    domain = served.http.get(f"/v1/domains/{domain_id}").json()
    assert domain["bounds"] == [[-20, -15, -10], [20, 15, 10]]
    assert domain["volume"] == pytest.approx(24000)
    assert domain["area"] == pytest.approx(5200)
    assert [f["area"] for f in domain["facets"]] == pytest.approx([1200, 1200, 800, 800, 600, 600])
    assert domain["watertight"] is True


def test_same_bytes_in_other_units_are_another_domain(served: Served, box: Path, domain_id: str) -> None:
    other = served.upload(box, "in").json()
    assert other["id"] != domain_id
    assert other["units"] == "in"
    assert served.upload(box, "in").json() == other
    assert served.http.get(f"/v1/domains/{domain_id}").json()["units"] == "mm"


def test_bytes_that_are_here_need_not_be_sent_again(served: Served, domain_id: str) -> None:
    again = served.http.post("/v1/domains", data={"sha256": domain_id, "units": "mm"})
    assert (again.status_code, again.json()["id"]) == (201, domain_id)
    other = served.http.post("/v1/domains", data={"sha256": domain_id, "units": "cm"}).json()
    assert (other["sha256"], other["units"]) == (domain_id, "cm")
    without = served.http.post("/v1/domains", data={"sha256": domain_id})
    assert (without.status_code, without.json()["code"]) == (422, "missing-units"), "as for the file itself"


def test_the_client_sends_bytes_once(served: Served, tmp_path: Path) -> None:
    path = tmp_path / "cylinder.stl"
    trimesh.creation.cylinder(10, 30, sections=20).export(path)
    with Client(served.url) as client:
        first, second = (client.upload_domain(path, "mm") for _ in range(2))
    assert first == second
    assert first["sha256"] == hashlib.sha256(path.read_bytes()).hexdigest()


def test_domains_are_listed_newest_first_in_pages(served: Served, domain_id: str) -> None:
    served.http.post("/v1/domains", data={"sha256": domain_id, "units": "m"})
    whole = served.http.get("/v1/domains?limit=200").json()
    paged, address = [], "/v1/domains?limit=1"
    while address:
        page = served.http.get(address).json()
        paged += page["items"]
        address = page["next"]
    assert paged == whole["items"]
    assert whole["next"] is None
    assert [d["created_at"] for d in paged] == sorted((d["created_at"] for d in paged), reverse=True)


def test_domain_file_comes_back_as_it_was(served: Served, box: Path, domain_id: str) -> None:
    answer = served.http.get(f"/v1/domains/{domain_id}/file")
    assert answer.content == box.read_bytes()
    assert "box.stl" in answer.headers["content-disposition"]
