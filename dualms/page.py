"""The report as one self-contained page: pictures inside, lengths in millimetres, directions without decimals."""

from __future__ import annotations

import base64
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined

from dualms.measure.certificate import Check
from dualms.measure.report import Report

PICTURES = ("preview.png", "sections.png", "maps.png", "evaluation.png")
# How a certificate's name ends, and the unit that people read it in.
READABLE = {", m": (1e3, ", mm"), ", m²": (1e4, ", cm²"), ", m³": (1e6, ", cm³")}


def report_page(report: Report, folder: Path) -> str:
    """The page, with those of the pictures that are in the folder."""
    environment = Environment(
        loader=PackageLoader("dualms", "pages"), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    environment.filters["g"] = lambda value, digits=4: f"{value:.{digits}g}"
    environment.filters["direction"] = lambda vector: ", ".join(f"{round(x, 3) + 0.0:g}" for x in vector)
    environment.filters["readable"] = readable
    pictures = {
        name: base64.b64encode((folder / name).read_bytes()).decode() for name in PICTURES if (folder / name).exists()
    }
    return environment.get_template("report.html").render(report=report, pictures=pictures)


def readable(check: Check) -> tuple[str, str, str]:
    """Name, value and limit of a line of the certificate, in the units that people read."""
    ending = next((end for end in READABLE if check.name.endswith(end)), None)
    exact = check.value + 0.0  # -0 is 0
    if ending is None:
        value = f"{exact:,.0f}" if exact.is_integer() else f"{exact:.4g}"
        return check.name, value, check.limit
    factor, unit = READABLE[ending]
    symbol, _, number = check.limit.partition(" ")
    limit = f"{symbol} {factor * float(number):.4g}" if number else symbol
    return check.name.removesuffix(ending) + unit, f"{factor * exact:.4g}", limit
