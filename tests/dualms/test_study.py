"""Grids, fronts, tables and pictures of studies."""

from __future__ import annotations

import csv
import io
import itertools
import json
import random
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dualms.errors import InvalidSpec
from dualms.spec import Spec
from dualms.study.figures import GEOMETRIC, HYDRAULIC, Scalar, default_metrics, figure, objectives_of, problem_of
from dualms.study.front import pareto_front
from dualms.study.grid import MAX_POINTS, InvalidPoint, StudyTooLarge, grid_points
from dualms.study.table import Row, Table, make_table, table_of

PORTS = {"inlets": [{"facet": 0}], "outlets": [{"center": [0, 0, 1], "radius": 2}]}
BASE: dict[str, Any] = {"units": "mm", "fluids": {"hot": PORTS, "cold": PORTS}}


# --- grid ---------------------------------------------------------------------------------------------------------


def test_points_are_the_product_in_order_and_leave_the_base_alone() -> None:
    before = json.dumps(BASE)
    grid = {"graph.sites": [100, 200], "wall": [{"thickness": 1}, {"volume_fraction": 0.1}], "seed": [3, 4, 5]}
    points = grid_points(BASE, grid)
    assert [tuple(p.values.values()) for p in points] == list(itertools.product(*grid.values()))
    assert [(p.spec.graph.sites, p.spec.seed) for p in points] == [
        (s, k) for s in (100, 200) for _ in "ab" for k in (3, 4, 5)
    ]
    assert json.dumps(BASE) == before


def test_a_point_is_the_specification_written_by_hand() -> None:
    grid = {"shell.thickness": [2.0], "fluids.cold.outlets.0.radius": [7.0], "flow.kind": ["none"]}
    (point,) = grid_points({**BASE, "shell": None}, grid)
    cold = {**PORTS, "outlets": [{"center": [0, 0, 1], "radius": 7}]}
    by_hand = {**BASE, "shell": {"thickness": 2}, "fluids": {"hot": PORTS, "cold": cold}, "flow": {"kind": "none"}}
    assert point.spec == Spec.model_validate(by_hand)


@pytest.mark.parametrize(
    ("path", "value"),
    [("graph.sties", 1), ("graph.sites", 1), ("nothing", 1), ("units.x", 1), ("fluids.hot.inlets.1.facet", 0)],
)
def test_a_path_that_does_not_fit_is_named(path: str, value: object) -> None:
    with pytest.raises(InvalidPoint) as caught:
        grid_points(BASE, {"seed": [0], path: [value]})
    assert caught.value.errors[0][0] == f"grid.{path}"
    assert caught.value.values == {"seed": 0, path: value}


def test_what_is_wrong_in_the_base_is_not_blamed_on_the_grid() -> None:
    with pytest.raises(InvalidPoint) as caught:
        grid_points({**BASE, "wall": {"thickness": -1, "surprise": 2}}, {"seed": [0, 1]})
    assert all(field.startswith("spec.wall") for field, _ in caught.value.errors)


@pytest.mark.parametrize(
    "grid", [{}, {"seed": []}, {"seed": [1, 1]}, {"wall": [None], "wall.thickness": [1]}, {"": [1]}]
)
def test_a_grid_that_contradicts_itself_is_refused(grid: dict[str, list[Any]]) -> None:
    with pytest.raises(InvalidSpec):
        grid_points(BASE, grid)


def test_the_number_of_points_is_bounded_before_any_is_made() -> None:
    assert len(grid_points(BASE, {"seed": list(range(MAX_POINTS))})) == MAX_POINTS
    with pytest.raises(StudyTooLarge) as caught:
        grid_points(BASE, {"seed": list(range(10**4)), "graph.sites": list(range(8, 10**4))})
    assert caught.value.measured["points"] == 10**4 * (10**4 - 8)


# --- front --------------------------------------------------------------------------------------------------------

pairs = st.lists(st.tuples(*2 * [st.integers(0, 6).map(float)]), max_size=25)


def dominates(a: tuple[float, float], b: tuple[float, float]) -> bool:
    return a[0] <= b[0] and a[1] >= b[1] and a != b


@given(pairs)
def test_the_front_is_what_nothing_dominates(points: list[tuple[float, float]]) -> None:
    assert pareto_front(points) == tuple(not any(dominates(q, p) for q in points) for p in points)


@given(pairs, st.randoms(use_true_random=False))
def test_the_front_does_not_depend_on_the_order(points: list[tuple[float, float]], dice: random.Random) -> None:
    order = dice.sample(range(len(points)), len(points))
    front = pareto_front(points)
    assert pareto_front([points[k] for k in order]) == tuple(front[k] for k in order)


@given(pairs)
def test_the_front_rises_and_contains_both_extremes(points: list[tuple[float, float]]) -> None:
    front = sorted({p for p, on in zip(points, pareto_front(points), strict=True) if on})
    assert all(a[0] < b[0] and a[1] < b[1] for a, b in itertools.pairwise(front))
    if points:
        assert front[0][0] == min(p[0] for p in points)
        assert front[-1][1] == max(p[1] for p in points)


# --- figures ------------------------------------------------------------------------------------------------------

REPORT = {
    "area": 2.5,
    "certified": True,
    "certificate": [{"name": "closed", "value": 1.0}, {"name": "wall", "value": 0.5}],
    "evaluation": {
        "comparisons": [
            {"surface": "gyroid", "match": "solid-fraction", "pressure_ratio": 0.5},
            {"surface": "gyroid", "match": "ua", "pressure_ratio": 0.4},
            {"surface": "p", "match": "ua", "pressure_ratio": 0.9},
        ]
    },
}


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("area", 2.5),
        ("certified", True),
        ("certificate.1.value", 0.5),
        ("certificate.wall.value", 0.5),
        ("evaluation.comparisons.gyroid.ua.pressure_ratio", 0.4),
        ("evaluation.comparisons.p.pressure_ratio", 0.9),
        ("evaluation.comparisons.gyroid.pressure_ratio", None),  # there are two
        ("evaluation.comparisons.d.ua.pressure_ratio", None),
        ("certificate.9.value", None),
        ("evaluation", None),
        ("area.x", None),
    ],
)
def test_a_path_finds_its_figure(path: str, value: object) -> None:
    assert figure(REPORT, path) == value


def test_solved_flows_are_weighed_by_pressure_drop_and_ua() -> None:
    plain = Spec.model_validate(BASE)
    solved = Spec.model_validate({**BASE, "evaluation": {"baselines": ["gyroid"], "match": "ua"}})
    assert objectives_of([plain]) == GEOMETRIC
    assert objectives_of([plain, solved]) == HYDRAULIC
    assert {HYDRAULIC.small, HYDRAULIC.large, "evaluation.comparisons.gyroid.ua.pressure_ratio"} <= set(
        default_metrics([solved])
    )
    assert not any(path.startswith("evaluation") for path in default_metrics([plain]))


# --- table --------------------------------------------------------------------------------------------------------

numbers = st.none() | st.floats(allow_nan=False, allow_infinity=False) | st.integers(-(10**9), 10**9) | st.booleans()


def table(figures: list[tuple[Scalar, Scalar]]) -> Table:
    rows = [
        Row({"seed": k, "wall": {"thickness": 1.5}}, f"{k:032x}", "succeeded", {HYDRAULIC.small: s, HYDRAULIC.large: g})
        for k, (s, g) in enumerate(figures)
    ]
    return make_table('a "title" <b>', ("seed", "wall"), (HYDRAULIC.small, HYDRAULIC.large), HYDRAULIC, rows)


@given(st.lists(st.tuples(numbers, numbers), min_size=1, max_size=8))
def test_csv_and_json_give_every_value_back(figures: list[tuple[Scalar, Scalar]]) -> None:
    made = table(figures)
    assert table_of(json.loads(made.to_json())) == made
    for line, row in zip(csv.DictReader(io.StringIO(made.to_csv())), made.rows, strict=True):
        for path in made.metrics:
            assert (json.loads(line[path]) if line[path] else None) == row.figures[path]
        assert {path: json.loads(line[path]) for path in made.axes} == row.values


def test_rows_without_figures_are_neither_on_the_front_nor_lost() -> None:
    made = table([(1.0, 1.0), (None, 5.0), (2.0, 0.5), (0.5, None), (2.0, 3.0)])
    assert [row.front for row in made.rows] == [True, False, False, False, True]
    assert len(made.to_csv().splitlines()) == 6


def test_the_page_shows_every_row_and_no_markup_of_the_title() -> None:
    page = table([(1.0, 1.0), (2.0, 2.0)]).to_html()
    assert page.count("<tr") == 3
    assert "<b>" not in page


@pytest.mark.parametrize("figures", [[], [(None, None)], [(1.0, 2.0)], [(1.0, 2.0), (100.0, 3.0), (0.0, -1.0)]])
def test_a_picture_is_drawn_whatever_there_is(figures: list[tuple[Scalar, Scalar]]) -> None:
    from dualms.study.picture import study_picture

    made = table(figures)
    assert study_picture(made).startswith(b"\x89PNG")
    assert study_picture(made) == study_picture(made)


def test_a_design_whose_flow_was_not_solved_says_so_in_its_row() -> None:
    assert problem_of({"evaluation": {"design": None, "problem": {"code": "c", "message": "m"}}}) == ("c", "m")
    assert problem_of({"evaluation": {"design": {}, "problem": None}}) is None
    assert problem_of({"evaluation": None}) is None
    row = Row({"seed": 0}, "0", "succeeded", dict.fromkeys((HYDRAULIC.small, HYDRAULIC.large)), "", ("c", "m"))
    made = make_table("t", ("seed",), (HYDRAULIC.large,), HYDRAULIC, [row])
    assert "<code>c</code>" in made.to_html()
    assert made.to_csv().splitlines()[1].endswith(",c")
