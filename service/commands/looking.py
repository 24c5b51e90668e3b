"""``dualms inspect`` and ``doctor``: what a file holds, and what this machine has."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from service.commands.console import EXIT_UNMET, Data, DomainFile, err, one_line_errors, out, refuse

if TYPE_CHECKING:
    from dualms.spec import Unit


@one_line_errors
def inspect(
    domain: DomainFile,
    units: Annotated[str | None, typer.Option(help="m, cm, mm or in, where the file does not say.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Look at a domain file: size, volume, the planar facets that ports can name, problems."""
    from dualms.reading import inspect_file
    from service.tables import inspection_tables

    with err.status("reading…"):
        found = inspect_file(domain, _unit(units))
    if as_json:
        out.print_json(found.model_dump_json())
    else:
        for table in inspection_tables(domain.name, found):
            out.print(table)


@one_line_errors
def doctor(data: Data = None) -> None:
    """Say what this machine has: devices, OpenFOAM, broker, store, libraries; and how to get what is missing."""
    from service.doctor import examine
    from service.settings import worker_settings
    from service.tables import findings_table

    settings = worker_settings(data)
    with err.status("looking…"):
        findings = examine(settings)
    out.print(findings_table(findings))
    if any(f.state == "missing" for f in findings):
        raise typer.Exit(EXIT_UNMET)


def _unit(text: str | None) -> Unit | None:
    from dualms.spec import Unit

    if text is None:
        return None
    if text not in list(Unit):
        refuse(f"'{text}' is not a unit.", "Use m, cm, mm or in.", "missing-units")
    return Unit(text)
