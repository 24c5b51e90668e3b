"""The table of a study, one row a point, as CSV, JSON and a self-contained page."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from dualms.study.figures import Objectives, Scalar
from dualms.study.front import pareto_front

PICTURE = "picture.png"


@dataclass(frozen=True)
class Row:
    """One point of a study.

    Parameters
    ----------
    values
        The grid's paths and the values at this point.
    design
        Names the design; empty where it is gone.
    status
        ``queued running succeeded failed cancelled``.
    figures
        The table's metrics; None where there is no such figure.
    href
        Where the design's report is, relative or absolute; empty where there is none.
    error
        Code and message, where the design failed or its flow could not be solved.
    """

    values: dict[str, Any]
    design: str
    status: str
    figures: dict[str, Scalar]
    href: str = ""
    error: tuple[str, str] | None = None
    front: bool = False


@dataclass(frozen=True)
class Table:
    """A study's figures; :func:`make_table` makes it."""

    title: str
    axes: tuple[str, ...]
    metrics: tuple[str, ...]
    objectives: Objectives
    rows: tuple[Row, ...]

    def place(self, row: Row) -> tuple[float, float] | None:
        """The two objectives of a row, if it has both."""
        small, large = (row.figures.get(path) for path in (self.objectives.small, self.objectives.large))
        if isinstance(small, int | float) and isinstance(large, int | float):
            return float(small), float(large)
        return None

    def count(self, status: str) -> int:
        """Number of rows with this status."""
        return sum(row.status == status for row in self.rows)

    def to_json(self) -> str:
        """A document with sorted keys and no NaN."""
        return json.dumps(asdict(self), indent=1, sort_keys=True, allow_nan=False) + "\n"

    def to_csv(self) -> str:
        """One line a point; text as it is, all else as JSON, so that every number comes back exactly."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow([*self.axes, "status", "front", *self.metrics, "design", "error"])
        for row in self.rows:
            cells = [
                *(row.values[a] for a in self.axes),
                row.status,
                row.front,
                *(row.figures[m] for m in self.metrics),
            ]
            writer.writerow([*map(_cell, cells), row.design, row.error[0] if row.error else ""])
        return text.getvalue()

    def to_html(self) -> str:
        """A page that shows the picture beside it and links to the designs' reports."""
        from jinja2 import Environment, PackageLoader, StrictUndefined  # the API starts without it

        environment = Environment(
            loader=PackageLoader("dualms", "pages"), autoescape=True, undefined=StrictUndefined, trim_blocks=True
        )
        environment.filters["cell"] = _shown
        return environment.get_template("study.html").render(table=self, picture=PICTURE)


def make_table(
    title: str, axes: Sequence[str], metrics: Sequence[str], objectives: Objectives, rows: Sequence[Row]
) -> Table:
    """The table of some rows, with those on the front marked.

    Parameters
    ----------
    title
        For people.
    axes, metrics
        Columns: paths of the grid, and of the report.
    objectives
        The front's; added to each row's figures by whoever makes the rows.
    rows
        In the grid's order.
    """
    table = Table(title, tuple(axes), tuple(metrics), objectives, tuple(rows))
    places = [(i, place) for i, row in enumerate(rows) if (place := table.place(row)) is not None]
    front = dict(zip((i for i, _ in places), pareto_front([p for _, p in places]), strict=True))
    return replace(table, rows=tuple(replace(row, front=front.get(i, False)) for i, row in enumerate(rows)))


def table_of(document: dict[str, Any]) -> Table:
    """The table that ``Table.to_json`` wrote."""
    rows = tuple(Row(**{**row, "error": tuple(row["error"]) if row["error"] else None}) for row in document["rows"])
    return Table(
        title=document["title"],
        axes=tuple(document["axes"]),
        metrics=tuple(document["metrics"]),
        objectives=Objectives(**document["objectives"]),
        rows=rows,
    )


def _cell(value: Any) -> str:
    if value is None:
        return ""
    return value if isinstance(value, str) else json.dumps(value)


def _shown(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return "–" if value is None else _cell(value)
