"""The command line ``dualms``. Each command imports what it needs, so that ``dualms --help`` is quick."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn, ParamSpec, TypeVar

import typer
from rich.console import Console

from service.administration import gc
from service.administration import keys as keys_commands

if TYPE_CHECKING:
    from dualms.spec import Spec, Unit

P = ParamSpec("P")
T = TypeVar("T")

EXIT_UNMET = 1  # a requirement on the report does not hold
EXIT_ERROR = 2  # usage, input, a failed design, or a service that cannot be reached

app = typer.Typer(
    name="dualms",
    help="Two-fluid heat exchangers whose separating surface belongs to the envelope.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
out = Console()
err = Console(stderr=True)

DomainFile = Annotated[Path, typer.Argument(help="Envelope: STL, OBJ, PLY, OFF, GLB, 3MF or STEP.", show_default=False)]
SpecFile = Annotated[Path, typer.Argument(help="Specification: a JSON file.", show_default=False)]
Data = Annotated[
    Path | None,
    typer.Option("--data", help="Folder of the store, artifacts and logs (or DUALMS_DATA_DIR).", show_default=False),
]


def main() -> None:
    """Run the command line."""
    app()


app.add_typer(keys_commands, name="keys")
app.command("gc")(gc)


def one_line_errors(command: Callable[P, T]) -> Callable[P, T]:
    """Turn what a user can cause into one clear line and exit code 2."""

    @wraps(command)
    def run(*args: P.args, **kwargs: P.kwargs) -> T:
        from dualms.errors import DualMSError

        try:
            return command(*args, **kwargs)
        except DualMSError as error:
            refuse(error.message, error.advice, error.code)
        except KeyboardInterrupt:
            refuse("Interrupted.")
        except (FileNotFoundError, PermissionError, IsADirectoryError, NotADirectoryError) as error:
            refuse(f"{error.filename}: {error.strerror}.")

    return run


def refuse(message: str, advice: str = "", code: str = "") -> NoReturn:
    """Print one clear error and leave with exit code 2."""
    tail = f" [dim]\\[{code}][/dim]" if code else ""
    from rich.markup import escape

    err.print(f"[bold red]error:[/bold red] {escape(message)}{tail}", highlight=False, soft_wrap=True)
    if advice:
        err.print(f"[cyan]try:[/cyan]   {escape(advice)}", highlight=False, soft_wrap=True)
    raise typer.Exit(EXIT_ERROR)


@app.command()
@one_line_errors
def serve(
    host: Annotated[str, typer.Option(help="Address to listen on.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(help="Port; 0 takes a free one.", min=0, max=65535)] = 8000,
    data: Data = None,
    queues: Annotated[
        str | None,
        typer.Option(help="Queues of this machine's worker, such as cpu,gpu (default: what the machine has)."),
    ] = None,
    allow_remote_without_keys: Annotated[
        bool, typer.Option("--allow-remote-without-keys", help="Listen on an address that others reach.")
    ] = False,
) -> None:
    """Run API, worker, broker and store on this machine, until Ctrl-C."""
    from service.administration import any_key
    from service.local import CannotServe, Plan, serve
    from service.settings import worker_settings

    settings = worker_settings(data)
    plan = Plan(
        data=settings.folder,
        host=host,
        port=port,
        redis_url=settings.redis_url or None,
        queues=_queues(queues) if queues else None,
        allow_remote=allow_remote_without_keys,
        keys=lambda: any_key(settings),
    )
    try:
        serve(plan, lambda text: out.print(text, highlight=False, markup=False, soft_wrap=True))
    except CannotServe as error:
        refuse(str(error))


@app.command()
@one_line_errors
def api(
    host: Annotated[str, typer.Option(help="Address to listen on.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(help="Port.", min=0, max=65535)] = 8000,
    allow_remote_without_keys: Annotated[
        bool, typer.Option("--allow-remote-without-keys", help="Listen on an address that others reach.")
    ] = False,
) -> None:
    """Run the API alone, for a team's cluster (DUALMS_REDIS_URL, DUALMS_DATABASE_URL, DUALMS_STORE_URL)."""
    from service.administration import any_key
    from service.listen import run
    from service.local import CannotServe, check_address, listen
    from service.settings import worker_settings

    settings = worker_settings()
    try:
        os.environ.update(check_address(host, allow_remote_without_keys, lambda: any_key(settings)))
        listener = listen(host, port)
    except CannotServe as error:
        refuse(str(error))
    run(listener)


@app.command()
@one_line_errors
def worker(
    queues: Annotated[str, typer.Option(help="Queues to serve: cpu, gpu, cfd, with commas between.")] = "cpu",
) -> None:
    """Join a team's cluster as a worker (DUALMS_REDIS_URL, DUALMS_DATABASE_URL, DUALMS_STORE_URL)."""
    from service.settings import worker_settings
    from worker.main import run

    names = _queues(queues)
    settings = worker_settings()
    if not settings.redis_url:
        refuse("No broker is known.", "Set DUALMS_REDIS_URL, or run everything on this machine: dualms serve.")
    raise typer.Exit(run(names, settings))


@app.command()
@one_line_errors
def design(
    domain: DomainFile,
    spec: SpecFile,
    out_dir: Annotated[Path, typer.Option("--out", help="Folder for meshes, report and pictures.", show_default=False)],
    require: Annotated[
        list[str] | None, typer.Option("--require", help="Requirement on the report; exit code 1 where it fails.")
    ] = None,
) -> None:
    """Make a design in this process, without a server."""
    from service.offline import design_here

    wanted = _requirements(require)
    folder = design_here(domain, _read_spec(spec), out_dir)
    _judge(wanted, json.loads((folder / "report.json").read_text()))


@app.command()
@one_line_errors
def submit(
    domain: DomainFile,
    spec: SpecFile,
    url: Annotated[str, typer.Option(help="The service.", envvar="DUALMS_URL")] = "http://127.0.0.1:8000",
    wait: Annotated[bool, typer.Option("--wait", help="Follow the design until it ends.")] = False,
    out_dir: Annotated[Path | None, typer.Option("--out", help="Download everything to here; implies --wait.")] = None,
    require: Annotated[
        list[str] | None,
        typer.Option(
            "--require",
            help="Requirement on the report, such as 'leak_free and wall.thickness_min_m > 4e-4'; may be repeated; "
            "implies --wait; exit code 1 where one fails.",
        ),
    ] = None,
    name: Annotated[str | None, typer.Option(help="A name for people.")] = None,
    key: Annotated[str | None, typer.Option(help="API key.", envvar="DUALMS_API_KEY", show_envvar=True)] = None,
    timeout: Annotated[float | None, typer.Option(help="Give up waiting after so many seconds.", min=1)] = None,
) -> None:
    """Send a design to a service; for scripts and CI."""
    from service.client import Client

    wanted = _requirements(require)
    document = _read_json(spec)
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


@app.command()
@one_line_errors
def study(
    file: Annotated[Path, typer.Argument(help="Study: a JSON file with domain, spec and grid.", show_default=False)],
    out_dir: Annotated[Path, typer.Option("--out", help="Folder for table and picture.", show_default=False)],
    domain: Annotated[Path | None, typer.Option(help="Envelope, instead of the file's.", show_default=False)] = None,
    url: Annotated[str | None, typer.Option(help="The service; without it, this process.", show_default=False)] = None,
    key: Annotated[str | None, typer.Option(help="API key.", envvar="DUALMS_API_KEY", show_envvar=True)] = None,
    timeout: Annotated[float | None, typer.Option(help="Give up waiting after so many seconds.", min=1)] = None,
) -> None:
    """Make designs over a grid of specification fields: a table, and a picture with the Pareto front. Resumable."""
    from service.problems import Problem
    from service.studies.command import front_table, read_plan, read_table, study_remote

    place, plan = read_plan(file, _read_json(file), domain)
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


@app.command()
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


@app.command()
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


def _read_json(path: Path) -> dict[str, Any]:
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        refuse(f"{path} is not JSON: {error}.", "", "malformed-request")
    if not isinstance(document, dict):
        refuse(f"{path} does not hold a JSON object.", "", "malformed-request")
    return document


def _read_spec(path: Path) -> Spec:
    from pydantic import ValidationError

    from dualms.spec import Spec
    from service.problems import from_validation

    try:
        return Spec.model_validate(_read_json(path))
    except ValidationError as error:
        problem = from_validation(error.errors())
        lines = "\n".join(f"  {f.field}: {f.message}" for f in problem.errors)
        refuse(
            f"{path} is not a specification:\n{lines}",
            "README has an example; unknown keys are refused.",
            "invalid-request",
        )


def _queues(text: str) -> tuple[str, ...]:
    from service.settings import UnknownQueue, queue_names

    try:
        return queue_names(text)
    except UnknownQueue as error:
        refuse(f"{error}.", "Queues are cpu, gpu and cfd; put commas between them.")


def _unit(text: str | None) -> Unit | None:
    from dualms.spec import Unit

    if text is None:
        return None
    if text not in list(Unit):
        refuse(f"'{text}' is not a unit.", "Use m, cm, mm or in.", "missing-units")
    return Unit(text)


if __name__ == "__main__":
    main()
