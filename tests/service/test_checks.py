"""Hopeless specifications are refused at submission; doubtful ones are not."""

from __future__ import annotations

from typing import Any

import pytest

from dualms.errors import DualMSError, EvaluationUnavailable, MissingUnits
from dualms.spec import NeuralField, PhaseField, Spec, Unit
from service.designs.checks import check_against_domain
from service.designs.resolve import resolved

BOUNDS = ((-20.0, -15.0, -10.0), (20.0, 15.0, 10.0))


def spec(**changes: Any) -> Spec:
    left, right = {"center": [-20, 0, 0], "radius": 4}, {"facet": 5}
    fluid = {"inlets": [left], "outlets": [right]}
    return Spec.model_validate({"units": "mm", "fluids": {"hot": fluid, "cold": fluid}, **changes})


def test_a_specification_that_fits_passes() -> None:
    check_against_domain(spec(), Unit.MM, BOUNDS, 6)


@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({"units": "cm"}, "invalid-spec"),
        ({"wall": {"thickness": 20}}, "wall-too-thick"),
        ({"shell": {"thickness": 10}}, "wall-too-thick"),
    ],
)
def test_what_contradicts_the_domain_is_refused_with_its_code(changes: dict[str, Any], code: str) -> None:
    with pytest.raises(DualMSError) as refusal:
        check_against_domain(spec(**changes), Unit.MM, BOUNDS, 6)
    assert refusal.value.code == code
    assert refusal.value.advice


@pytest.mark.parametrize(
    "port",
    [
        {"facet": 6},
        {"center": [30, 0, 0], "radius": 4},
        {"box": [[21, 0, 0], [25, 1, 1]]},
    ],
)
def test_a_port_outside_the_domain_is_refused(port: dict[str, Any]) -> None:
    fluid = {"inlets": [port], "outlets": [{"facet": 0}]}
    with pytest.raises(DualMSError) as refusal:
        check_against_domain(spec(fluids={"hot": fluid, "cold": fluid}), Unit.MM, BOUNDS, 6)
    assert refusal.value.code == "port-not-on-boundary"
    assert "spec.fluids.hot.inlets.0" in refusal.value.message


def test_auto_is_neural_where_a_gpu_worker_is_registered_and_the_phase_field_elsewhere() -> None:
    assert isinstance(resolved(spec(), Unit.MM, frozenset({"cpu", "gpu"})).field, NeuralField)
    assert isinstance(resolved(spec(), Unit.MM, frozenset({"cpu"})).field, PhaseField)


def test_units_come_from_the_domain_where_the_specification_is_silent() -> None:
    assert resolved(spec(units=None), Unit.IN, frozenset()).units is Unit.IN
    with pytest.raises(MissingUnits):
        resolved(spec(units=None), None, frozenset())


def test_evaluation_is_refused_where_no_worker_can_do_it() -> None:
    with pytest.raises(EvaluationUnavailable):
        resolved(spec(evaluation={}), Unit.MM, frozenset({"cpu"}))
    assert resolved(spec(evaluation={}), Unit.MM, frozenset({"cpu", "cfd"})).evaluation is not None
