"""``dualms design``, ``submit`` and ``study``: designs made here, or by a service; and the verdict on their reports."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from service.commands.console import (
    EXIT_UNMET,
    DomainFile,
    Key,
    Require,
    Timeout,
    err,
    one_line_errors,
    out,
    read_json,
    refuse,
)

if TYPE_CHECKING:
    from dualms.spec import Spec

SpecFile = Annotated[Path, typer.Argument(help="Specification: a JSON file.", show_default=False)]


@one_line_errors
def design(
    domain: DomainFile,
    spec: SpecFile,
    out_dir: Annotated[Path, typer.Option("--out", help="Folder for meshes, report and pictures.", show_default=False)],
    require: Require = None,
) -> None:
    """Make a design in this process, without a server."""
    from service.offline import design_here

    wanted = _requirements(require)
    folder = design_here(domain, _read_spec(spec), out_dir)
    _judge(wanted, json.loads((folder / "report.json").read_text()))


@one_line_errors
def submit(
    domain: DomainFile,
    spec: SpecFile,
    url: Annotated[str, typer.Option(help="The service.", envvar="DUALMS_URL")] = "http://127.0.0.1:8000",
    wait: Annotated[bool, typer.Option("--wait", help="Follow the design until it ends.")] = False,
    out_dir: Annotated[
        Path | None, typer.Option("--out", help="Download everything to here; implies --wait, as --require does.")
    ] = None,
    require: Require = None,
    name: Annotated[str | None, typer.Option(help="A name for people.")] = None,
    key: Key = None,
    timeout: Timeout = None,
) -> None:
    """Send a design to a service; for scripts and CI."""
    from service.client import Client

    wanted = _requirements(require)
    document = read_json(spec)
    with _refusals_of(url), Client(url, key) as client:
        record = _send(client, domain, document, name)
        if not (wait or out_dir or wanted):
            out.print_json(data=record)
            return
        record = _follow(client, record, timeout or float("inf"))
        if record["status"] != "succeeded":
            problem = record["error"] or {"detail": f"The design was {record['status']}.", "advice": "", "code": ""}
            refuse(problem["detail"], problem["advice"], problem["code"])
        if out_dir is not None:
            for path in client.download(record, out_dir):
                out.print(str(path), highlight=False, soft_wrap=True)
        if wanted:
            _judge(wanted, client.artifact_json(record, "report.json"))


@one_line_errors
def study(
    file: Annotated[Path, typer.Argument(help="Study: a JSON file with domain, spec and grid.", show_default=False)],
    out_dir: Annotated[Path, typer.Option("--out", help="Folder for table and picture.", show_default=False)],
    domain: Annotated[Path | None, typer.Option(help="Envelope, instead of the file's.", show_default=False)] = None,
    url: Annotated[str | None, typer.Option(help="The service; without it, this process.", show_default=False)] = None,
    key: Key = None,
    timeout: Timeout = None,
) -> None:
    """Make designs over a grid of specification fields: a table, and a picture with the Pareto front. Resumable."""
    from service.problems import Problem
    from service.studies.command import front_table, read_plan, read_table, study_remote

    place, plan = read_plan(file, read_json(file), domain)
    try:
        if url is None:
            from service.studies.here import study_here

            if not isinstance(place, Path):
                refuse("The study names a domain by its id.", "Give --domain FILE, or --url of its service.")
            study_here(place, plan, file.stem, out_dir)
        else:
            from service.client import Client

            with _refusals_of(url), Client(url, key) as client:
                study_remote(client, place, plan, out_dir, err, timeout or float("inf"))
    except Problem as error:
        refuse(str(error.detail), error.advice, error.code)
    table = read_table(out_dir)
    out.print(front_table(table))
    for name in ("table.csv", "table.json", "table.html", "picture.png"):
        out.print(str(out_dir / name), highlight=False, soft_wrap=True)
    if not table.count("succeeded"):
        refuse("No point has succeeded.", "table.html says why.", "study-failed")


@contextmanager
def _refusals_of(url: str) -> Iterator[None]:
    """Turn what a service refuses, or its silence, into one clear line and exit code 2."""
    from service.client import ServiceError, Unreachable

    try:
        yield
    except ServiceError as error:
        fields = "".join(f"\n         {f['field']}: {f['message']}" for f in error.problem.get("errors", [])[1:])
        refuse(str(error.problem.get("detail", error)) + fields, error.advice, error.code)
    except Unreachable as error:
        refuse(str(error), f"Is the service running at {url}? Start one with: dualms serve", "unreachable")
    except TimeoutError as error:
        refuse(str(error), "It goes on in the service; give --timeout more seconds.", "timeout")


def _send(client: Any, domain: Path, document: dict[str, Any], name: str | None) -> dict[str, Any]:
    with err.status(f"uploading {domain.name}…"):
        uploaded = client.upload_domain(domain, document.get("units"))
        record: dict[str, Any] = client.submit(uploaded["id"], document, name=name or domain.stem)
    err.print(f"design {record['id']}", highlight=False)
    return record


def _follow(client: Any, record: dict[str, Any], timeout_s: float) -> dict[str, Any]:
    from service.tables import DesignProgress

    with DesignProgress(err) as progress:
        ended: dict[str, Any] = client.wait(
            record["id"], lambda r: progress.show(r["status"], r["stage"] or "", r["progress"]), timeout_s
        )
    return ended


def _requirements(expressions: list[str] | None) -> list[str]:
    from service.requirements import BadRequirement, parse

    for expression in expressions or []:
        try:
            parse(expression)
        except BadRequirement as error:
            refuse(str(error), "See dualms submit --help.", "bad-requirement")
    return expressions or []


def _judge(expressions: list[str], report: dict[str, Any]) -> None:
    from service.requirements import BadRequirement, check

    try:
        verdicts = [check(expression, report) for expression in expressions]
    except BadRequirement as error:
        refuse(str(error), "Look at report.json for the names.", "bad-requirement")
    for verdict in verdicts:
        out.print(
            str(verdict), highlight=False, markup=False, style="green" if verdict.met else "bold red", soft_wrap=True
        )
    if not all(v.met for v in verdicts):
        raise typer.Exit(EXIT_UNMET)


def _read_spec(path: Path) -> Spec:
    from pydantic import ValidationError

    from dualms.spec import Spec
    from service.problems import from_validation

    document = read_json(path)
    try:
        return Spec.model_validate(document)
    except ValidationError as error:
        problem = from_validation(error.errors(), document)
        lines = "\n".join(f"  {f.field}: {f.message}" for f in problem.errors)
        refuse(
            f"{path} is not a specification:\n{lines}",
            "README has an example; unknown keys are refused.",
            "invalid-request",
        )
