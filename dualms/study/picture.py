"""The picture of a study: every point by its two objectives, and the front through the best of them.

``python -m dualms.study.picture`` reads ``table.json`` from stdin and writes the PNG to stdout, for a caller that does
not want to load matplotlib.
"""

from __future__ import annotations

import io
import json
import sys
from typing import Any

from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from dualms.study.figures import HYDRAULIC
from dualms.study.table import Row, Table, table_of

SIZE = (9.0, 6.0)  # inches
MARKERS = "osD^vP*Xh<>"
LOG_ABOVE = 20.0  # ratio of the largest to the smallest figure above which an axis is logarithmic
_NAMES = {HYDRAULIC.small: "pressure drop ΔP (Pa)", HYDRAULIC.large: "UA (W/K)"}


def study_picture(table: Table) -> bytes:
    """The picture as PNG.

    Parameters
    ----------
    table
        Rows without both objectives are counted in the caption and not drawn. Colour follows the first path of the
        grid, shape the second.
    """
    figure = Figure(figsize=SIZE, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    drawn = [(row, place) for row in table.rows if (place := table.place(row)) is not None]
    if drawn:
        _scatter(figure, axes, table, drawn)
    else:
        axes.text(0.5, 0.5, "no figures yet", ha="center", va="center", transform=axes.transAxes, color="0.5")
        axes.set_xticks([])
        axes.set_yticks([])
    axes.set_xlabel(_NAMES.get(table.objectives.small, table.objectives.small) + " – smaller is better")
    axes.set_ylabel(_NAMES.get(table.objectives.large, table.objectives.large) + " – larger is better")
    title = table.title if len(table.title) <= 80 else table.title[:79] + "…"
    axes.set_title(title, loc="left", parse_math=False)
    missing = len(table.rows) - len(drawn)
    caption = f"{len(drawn)} of {len(table.rows)} points" + (f"; {missing} without figures" if missing else "")
    axes.set_title(caption, loc="right", fontsize=9, color="0.4")
    png = io.BytesIO()
    figure.savefig(png, format="png", dpi=130)
    return png.getvalue()


def _scatter(figure: Figure, axes: Axes, table: Table, drawn: list[tuple[Row, tuple[float, float]]]) -> None:
    varied = [path for path in table.axes if len({json.dumps(row.values[path]) for row in table.rows}) > 1]
    hues = _levels(table, varied[0]) if varied else []
    shapes = _levels(table, varied[1]) if len(varied) > 1 else []
    palette = colormaps["viridis"].resampled(max(len(hues), 2))
    for row, (x, y) in drawn:
        hue = hues.index(json.dumps(row.values[varied[0]])) if hues else 0
        shape = shapes.index(json.dumps(row.values[varied[1]])) if shapes else 0
        axes.plot(x, y, marker=MARKERS[shape % len(MARKERS)], markersize=9 if row.front else 7, color=palette(hue),
                  markeredgecolor="black" if row.front else "white", linestyle="none", zorder=3)  # fmt: skip
    front = sorted(place for row, place in drawn if row.front)
    axes.plot(*zip(*front, strict=True), color="0.2", linewidth=1.2, linestyle="--", zorder=2, label="Pareto front")
    for number, row in enumerate(table.rows, 1):
        if row.front and (place := table.place(row)) is not None:
            axes.annotate(str(number), place, xytext=(7, 5), textcoords="offset points", fontsize=8)
    _legend(figure, axes, varied, hues, shapes, palette)
    for axis, scale in ((0, axes.set_xscale), (1, axes.set_yscale)):
        numbers = [place[axis] for _, place in drawn]
        if min(numbers) > 0 and max(numbers) > LOG_ABOVE * min(numbers):
            scale("log")
    axes.grid(visible=True, color="0.92")


def _levels(table: Table, path: str) -> list[str]:
    return list(dict.fromkeys(json.dumps(row.values[path]) for row in table.rows))


def _legend(figure: Figure, axes: Axes, varied: list[str], hues: list[str], shapes: list[str], palette: Any) -> None:
    most = 10
    for k, level in enumerate(hues[:most]):
        axes.plot([], [], "o", color=palette(k), label=f"{varied[0]} = {level[:24]}")
    if len(hues) > most:
        axes.plot([], [], " ", label=f"… {len(hues) - most} more")
    for k, level in enumerate(shapes[:most]):
        axes.plot([], [], MARKERS[k % len(MARKERS)], color="0.5", label=f"{varied[1]} = {level[:24]}")
    for text in figure.legend(loc="outside right upper", fontsize=8).get_texts():
        text.set_parse_math(False)


def main() -> None:
    """Read the table, write the picture."""
    sys.stdout.buffer.write(study_picture(table_of(json.load(sys.stdin))))


if __name__ == "__main__":
    main()
