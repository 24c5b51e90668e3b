"""The command line ``dualms``. Each command imports what it needs, so that ``dualms --help`` is quick."""

from __future__ import annotations

import typer

from service.commands.administration import gc, keys
from service.commands.designing import design, study, submit
from service.commands.looking import doctor, inspect
from service.commands.serving import api, serve, worker

app = typer.Typer(
    name="dualms",
    help="Two-fluid heat exchangers whose separating surface belongs to the envelope.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
for command in (serve, api, worker, design, submit, study, inspect, doctor, gc):
    app.command()(command)
app.add_typer(keys, name="keys")


def main() -> None:
    """Run the command line."""
    app()


if __name__ == "__main__":
    main()
