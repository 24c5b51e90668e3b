"""Requirements decide what they say and run nothing else."""

from __future__ import annotations

import pytest

from service.requirements import MAX_LENGTH, BadRequirement, check, parse

REPORT: dict[str, object] = {
    "solid_volume_fraction": 0.12,
    "leak_free": True,
    "fluids": {"hot": {"components": 1}, "cold": {"components": 2, "volume_m3": 1e-4}},
    "history": [1, 2, 5],
    "method": "phase-field",
    "evaluation": None,
}


@pytest.mark.parametrize(
    ("expression", "met"),
    [
        ("fluids.hot.components == 1 and solid_volume_fraction < 0.2", True),
        ("fluids.cold.components == 1", False),
        ("leak_free", True),
        ("not leak_free", False),
        ("0.1 < solid_volume_fraction <= 0.12", True),
        ("fluids.cold.volume_m3 * 2 > 1.9e-4", True),
        ("method == 'phase-field'", True),
        ("method in ['neural', 'distilled']", False),
        ("evaluation == none", True),
        ("leak_free == true", True),
        ("max(fluids.hot.components, fluids.cold.components) == 2", True),
        ("history[2] - history[0] == 4 and len(history) == 3", True),
        ("abs(-solid_volume_fraction) < 1", True),
        ("leak_free or no.such.figure", True),
    ],
)
def test_requirement_is_decided_on_the_report_s_figures(expression: str, met: bool) -> None:
    assert check(expression, REPORT).met is met


@pytest.mark.parametrize(
    "expression",
    [
        "__import__('os').system('true')",
        "(lambda: 1)()",
        "[x for x in history]",
        "fluids.hot.components.__class__ == 1",
        "history[0:2] == 1",
        "2 ** 100000 > 1",
        "'a' * 1000000000 == 'b'",
        "f'{history}' == ''",
        "open('x')",
        "leak_free if leak_free else leak_free",
        "solid_volume_fraction",
        "no_such == 1",
        "leak_free = 1",
        "",
        "(" * 500,
        "1 < 'a'",
        "1 / 0 < 1",
        "history[9] == 1",
        "leak_free " + "and leak_free " * MAX_LENGTH,
    ],
)
def test_what_is_not_of_the_language_is_refused(expression: str) -> None:
    with pytest.raises(BadRequirement):
        check(expression, REPORT)


def test_verdict_shows_the_figures_it_read() -> None:
    assert "fluids.cold.components = 2" in str(check("fluids.cold.components == 1", REPORT))


def test_missing_figure_is_named_with_what_there_is() -> None:
    with pytest.raises(BadRequirement, match=r"fluids has cold, hot"):
        check("fluids.warm.components == 1", REPORT)


def test_a_requirement_can_be_checked_before_there_is_a_report() -> None:
    parse("wall.thickness_min_m > 4e-4")
