"""One fault in a specification is one refusal, at the place where it was written."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from dualms.spec import DiskPort, FluidSpec, Spec, WallThickness
from dualms.spec.refused import refused

EXAMPLE = json.loads((Path(__file__).parents[2] / "examples" / "u_bend.json").read_text(encoding="utf-8"))
CORNERS = [[0, 0, 0], [1, 1, 1]]
KINDS = "one of the keys 'center', 'box' or 'facet' is needed"
PORTS = ("fluids", "hot", "inlets", "0")


def faults(document: dict[str, Any]) -> list[tuple[tuple[str, ...], str]]:
    with pytest.raises(ValidationError) as error:
        Spec.model_validate(document)
    return refused(error.value.errors(), document)


@pytest.mark.parametrize(
    ("port", "path", "message"),
    [
        ({"box": CORNERS, "header": {"radius": -1, "length": 2}}, ("header", "radius"), "greater than 0"),
        ({"box": CORNERS[::-1]}, (), "must not exceed"),
        ({"box": CORNERS, "center": [0, 0, 0], "radius": 1}, ("box",), "not permitted"),
        ({"center": [0, 0, 0], "radius": "x"}, ("radius",), "valid number"),
        ({"center": [0, 0, 0]}, ("radius",), "required"),
        ({"facet": -1}, ("facet",), "greater than or equal to 0"),
        ({"centre": [0, 0, 0], "radius": 1}, (), KINDS),
        ({}, (), KINDS),
        (7, (), KINDS),
        (None, (), KINDS),
    ],
)
def test_a_port_is_refused_as_the_kind_that_it_was_meant_to_be(port: Any, path: tuple[str, ...], message: str) -> None:
    hot = {**EXAMPLE["fluids"]["hot"], "inlets": [port]}
    ((where, what),) = faults({**EXAMPLE, "fluids": {**EXAMPLE["fluids"], "hot": hot}})
    assert where == (*PORTS, *path)
    assert message in what


@pytest.mark.parametrize(
    ("wall", "path"),
    [
        ({"thickness": -1}, ("thickness",)),
        ({"volume_fraction": 2}, ("volume_fraction",)),
        ({"thicknes": 1}, ("thicknes",)),
        ({"graded": {"stations": []}}, ("graded",)),
        ({"graded": {"direction": [0, 0, 1], "stations": []}}, ("graded", "stations")),
        ({"graded": {"points": [[[0, 0, 0], 1], [[0, 0, 0], 2]]}}, ("graded",)),
        ("thick", ()),
    ],
)
def test_a_wall_is_refused_as_the_kind_that_it_was_meant_to_be(wall: Any, path: tuple[str, ...]) -> None:
    ((where, _),) = faults({**EXAMPLE, "wall": wall})
    assert where == ("wall", *path)


@pytest.mark.parametrize(
    ("part", "value", "path"),
    [
        ("field", {"method": "phase-field", "resolution": 3}, ("field", "resolution")),
        ("field", {"method": "neural", "preset": "cpu", "points": 0}, ("field", "points")),
        ("field", {"method": "guess"}, ("field",)),
        ("flow", {"kind": "direction"}, ("flow", "vector")),
        ("flow", {"kind": "path", "points": [[0, 0, 0], [0, "x", 1]]}, ("flow", "points", "1", "1")),
    ],
)
def test_the_name_of_a_kind_is_no_key(part: str, value: dict[str, Any], path: tuple[str, ...]) -> None:
    ((where, _),) = faults({**EXAMPLE, part: value})
    assert where == path


def test_a_list_without_ports_is_too_short_of_itself() -> None:
    hot = {**EXAMPLE["fluids"]["hot"], "inlets": []}
    ((where, what),) = faults({**EXAMPLE, "fluids": {**EXAMPLE["fluids"], "hot": hot}})
    assert where == PORTS[:3]
    assert "at least 1" in what


def test_kinds_made_in_python_and_those_of_a_document_are_the_same() -> None:
    disk = DiskPort(center=(0, 0, 0), radius=1)
    fluid = FluidSpec(inlets=(disk,), outlets=(disk,))
    assert FluidSpec.model_validate(fluid.model_dump(mode="json")) == fluid
    assert Spec.model_validate({**EXAMPLE, "wall": {}}).wall == WallThickness()
