"""The report's page: its certificate in units that people read."""

from __future__ import annotations

import pytest

from dualms.measure.certificate import Check
from dualms.page import readable


@pytest.mark.parametrize(
    ("line", "shown"),
    [
        (("least wall, m", 7.906e-4, "> 0"), ("least wall, mm", "0.7906", "> 0")),
        (("hot: dead-end volume, m³", 1.611e-8, "≤ 4.415e-05"), ("hot: dead-end volume, cm³", "0.01611", "≤ 44.15")),
        (
            ("powder trapped in closed cavities, m³", -0.0, "= 0"),
            ("powder trapped in closed cavities, cm³", "0", "= 0"),
        ),
        (("overhang below 45°, m²", 0.04125, "stated"), ("overhang below 45°, cm²", "412.5", "stated")),
        (
            ("triangles of the largest mesh", 1011306.0, "≤ 3,000,000"),
            ("triangles of the largest mesh", "1,011,306", "≤ 3,000,000"),
        ),
        (("required: area density, 1/m", 120.2, "≥ 100"), ("required: area density, 1/m", "120.2", "≥ 100")),
    ],
)
def test_lines_are_shown_in_units_that_people_read(line: tuple[str, float, str], shown: tuple[str, str, str]) -> None:
    name, value, limit = line
    assert readable(Check(name=name, value=value, limit=limit, passed=True)) == shown
