"""An owner can read nothing of another's, on any route of the OpenAPI document."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import httpx
import pytest

from service.app import create_app

if TYPE_CHECKING:
    from conftest import Team


@dataclass(frozen=True)
class Things:
    """What one owner has, and everything by which it could be recognised."""

    paths: dict[str, str]  # parameter of a path -> value
    marks: tuple[str, ...]

    def at(self, template: str) -> str:
        return template.format(**self.paths)


@pytest.fixture(scope="module")
def bob(team: Team) -> httpx.Client:
    """One who owns nothing; the bob of other files has uploaded the box."""
    return team.client("bob-who-owns-nothing")


@pytest.fixture(scope="module")
def anns(team: Team, box: Path, plain_spec: dict[str, Any]) -> tuple[httpx.Client, Things]:
    """Ann's domain, a design that has succeeded, a study."""
    ann = team.client("ann-who-owns-things")
    domain = team.upload(ann, box).json()
    body = {"domain": domain["id"], "spec": plain_spec, "name": "anns-design", "labels": ["anns-label"]}
    design = ann.post("/v1/designs", json=body, headers={"Prefer": "wait=30"}).json()
    while design["status"] in ("queued", "running"):
        design = ann.get(design["href"], headers={"Prefer": "wait=30"}).json()
    assert design["status"] == "succeeded", design["error"]
    body = {"domain": domain["id"], "spec": plain_spec, "grid": {"seed": [0]}, "name": "anns-study"}
    study = ann.post("/v1/studies", json=body).json()
    ids = {"domain_id": domain["id"], "design_id": design["id"], "study_id": study["id"]}
    return ann, Things(ids, (*ids.values(), "anns-design", "anns-label", "anns-study"))


def calls(prefix: str, *, named: bool) -> list[tuple[str, str]]:
    """Calls of the OpenAPI document, with or without something named in the path: new ones come in by themselves."""
    return [
        (method.upper(), path)
        for path, item in create_app().openapi()["paths"].items()
        for method in item
        if path.startswith(prefix) and ("{" in path) == named
    ]


@pytest.mark.parametrize(("method", "path"), calls("/v1", named=True))
def test_what_another_owner_has_is_answered_as_if_it_were_not_there(
    bob: httpx.Client, anns: tuple[httpx.Client, Things], method: str, path: str
) -> None:
    ann, things = anns
    files = {"designs": "solid.stl", "studies": "table.csv"}
    name = files.get(path.split("/")[2], "")
    nothing = {k: "0" * len(v) for k, v in things.paths.items()}
    theirs = bob.request(method, path.format(**things.paths, name=name))
    absent = bob.request(method, path.format(**nothing, name=name))
    assert (theirs.status_code, absent.status_code) == (404, 404)
    assert _without_ids(theirs, things.paths) == _without_ids(absent, nothing), "the answers tell them apart"
    if method == "GET":  # and it was there all the time
        assert ann.request(method, path.format(**things.paths, name=name)).status_code == 200


@pytest.mark.parametrize(("method", "path"), calls("/v1", named=False))
def test_lists_and_new_things_show_nothing_of_another_owner(
    bob: httpx.Client,
    anns: tuple[httpx.Client, Things],
    box: Path,
    plain_spec: dict[str, Any],
    method: str,
    path: str,
) -> None:
    ann, things = anns
    if method == "GET":
        assert any(mark in ann.get(path).text for mark in things.marks)
        answers = [bob.get(path), bob.get(f"{path}?limit=1"), bob.get(path, params={"label": "anns-label"})]
        answers += [bob.get(path, params={"cursor": value}) for value in things.paths.values()]
    else:
        bodies = {
            "/v1/domains": {"data": {"sha256": hashlib.sha256(box.read_bytes()).hexdigest(), "units": "mm"}},
            "/v1/designs": {"json": {"domain": things.paths["domain_id"], "spec": plain_spec}},
            "/v1/studies": {"json": {"domain": things.paths["domain_id"], "spec": plain_spec, "grid": {"seed": [1]}}},
        }
        answers = [bob.post(path, **bodies[path])]  # a new call must be thought about here
        assert answers[0].status_code == 404
    for answer in answers:
        said = answer.text if answer.status_code == 200 else ""
        assert not [mark for mark in things.marks if mark in said]


@pytest.mark.parametrize(("method", "path"), [c for c in calls("/", named=False) if not c[1].startswith("/v1")])
def test_pages_without_a_key_show_nothing_of_anybody(
    team: Team, anns: tuple[httpx.Client, Things], method: str, path: str
) -> None:
    for page in (path, "/", "/docs", "/openapi.json"):
        text = httpx.request(method, team.service.url + page).text
        assert not [mark for mark in anns[1].marks if mark in text]


def test_an_admin_sees_all(team: Team, anns: tuple[httpx.Client, Things]) -> None:
    admin = team.client("root", "--scopes", "admin")
    assert admin.get(anns[1].at("/v1/designs/{design_id}")).status_code == 200


def _without_ids(answer: httpx.Response, ids: dict[str, str]) -> str:
    text = answer.text
    for value in ids.values():
        text = text.replace(value, "ID")
    return text
