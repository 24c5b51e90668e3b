"""What all commands share: where they print, how they refuse, what their exit codes mean."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Annotated, Any, NoReturn, ParamSpec, TypeVar

import typer
from rich.console import Console

P = ParamSpec("P")
T = TypeVar("T")

EXIT_UNMET = 1  # a requirement on the report does not hold
EXIT_ERROR = 2  # usage, input, a failed design, or a service that cannot be reached

out = Console()
err = Console(stderr=True)

DomainFile = Annotated[Path, typer.Argument(help="Envelope: STL, OBJ, PLY, OFF, GLB, 3MF or STEP.", show_default=False)]
Data = Annotated[
    Path | None,
    typer.Option("--data", help="Folder of the store, artifacts and logs (or DUALMS_DATA_DIR).", show_default=False),
]
Key = Annotated[str | None, typer.Option(help="API key.", envvar="DUALMS_API_KEY", show_envvar=True)]
Require = Annotated[
    list[str] | None,
    typer.Option(
        "--require",
        help="Requirement on the report, such as 'leak_free and wall.thickness_min_m > 4e-4'; may be repeated; "
        "exit code 1 where one fails.",
    ),
]
Timeout = Annotated[float | None, typer.Option(help="Give up waiting after so many seconds.", min=1)]


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


def read_json(path: Path) -> dict[str, Any]:
    """The JSON object in a file; anything else is refused."""
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        refuse(f"{path} is not JSON: {error}.", "", "malformed-request")
    if not isinstance(document, dict):
        refuse(f"{path} does not hold a JSON object.", "", "malformed-request")
    return document
