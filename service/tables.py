"""What the command line shows people: tables and progress bars."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from service.doctor import Finding

if TYPE_CHECKING:
    from dualms.inspection import Inspection

_MARKS = {"good": "[green]✓[/green]", "missing": "[bold red]✗[/bold red]", "optional": "[yellow]–[/yellow]"}


def inspection_tables(name: str, found: Inspection) -> list[Table]:
    """What ``dualms inspect`` prints."""
    unit = found.units.value
    size = [high - low for low, high in zip(*found.bounds, strict=True)]
    facts = Table(title=name, show_header=False, title_justify="left")
    facts.add_row("size", " × ".join(f"{s:.6g}" for s in size) + f" {unit}")
    facts.add_row("bounds", " … ".join(str([round(x, 6) for x in corner]) for corner in found.bounds))
    facts.add_row("volume", f"{found.volume:.6g} {unit}³")
    facts.add_row("area", f"{found.area:.6g} {unit}²")
    facts.add_row("triangles", f"{found.faces:,}")
    facts.add_row("closed", "yes" if found.watertight else "no")
    for problem in found.problems:
        facts.add_row("[yellow]note[/yellow]", problem)
    facets = Table(title='Facets; as a port: {"facet": index}', title_justify="left")
    for column in ("index", f"centre ({unit})", "normal", f"area ({unit}²)"):
        facets.add_column(column, justify="right")
    for f in found.facets:
        center, normal = (", ".join(f"{x:.5g}" for x in v) for v in (f.center, f.normal))
        facets.add_row(str(f.index), center, normal, f"{f.area:.6g}")
    return [facts, facets]


def findings_table(findings: list[Finding]) -> Table:
    """What ``dualms doctor`` prints."""
    table = Table(show_header=False)
    for f in findings:
        table.add_row(_MARKS[f.state], f.subject, f.found, f.advice)
    return table


class DesignProgress:
    """A progress bar over a whole design; on a pipe, one line a stage."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._last = ""
        self._bar = Progress(
            TextColumn("[progress.description]{task.description:<22}"),
            BarColumn(bar_width=40),
            TextColumn("{task.percentage:>3.0f} %"),
            TimeElapsedColumn(),
            TextColumn("[dim]{task.fields[note]}"),
            console=console,
            transient=False,
            disable=not console.is_terminal,
        )
        self._task = self._bar.add_task("queued", total=1.0, note="")

    def __enter__(self) -> DesignProgress:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def show(self, status: str, stage: str, fraction: float, note: str = "") -> None:
        """Move the bar."""
        what = stage if status == "running" and stage else status
        self._bar.update(self._task, description=what, completed=fraction, note=note)
        if not self._console.is_terminal and what != self._last:
            self._console.print(f"{fraction:4.0%} {what}", highlight=False)
        self._last = what


def progress_console() -> Console:
    """Where progress is shown: stderr, so that stdout stays for results."""
    return Console(stderr=True)
