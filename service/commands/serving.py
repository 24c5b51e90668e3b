"""``dualms serve``, ``api`` and ``worker``: what runs until it is stopped."""

from __future__ import annotations

import os
from typing import Annotated

import typer

from service.commands.console import Data, one_line_errors, out, refuse

Host = Annotated[str, typer.Option(help="Address to listen on.")]
AllowRemote = Annotated[
    bool, typer.Option("--allow-remote-without-keys", help="Listen on an address that others reach.")
]


@one_line_errors
def serve(
    host: Host = "127.0.0.1",
    port: Annotated[int, typer.Option(help="Port; 0 takes a free one.", min=0, max=65535)] = 8000,
    data: Data = None,
    queues: Annotated[
        str | None,
        typer.Option(help="Queues of this machine's worker, such as cpu,gpu (default: what the machine has)."),
    ] = None,
    allow_remote_without_keys: AllowRemote = False,
) -> None:
    """Run API, worker, broker and store on this machine, until Ctrl-C."""
    from service.commands.administration import any_key
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


@one_line_errors
def api(
    host: Host = "127.0.0.1",
    port: Annotated[int, typer.Option(help="Port.", min=0, max=65535)] = 8000,
    allow_remote_without_keys: AllowRemote = False,
) -> None:
    """Run the API alone, for a team's cluster (DUALMS_REDIS_URL, DUALMS_DATABASE_URL, DUALMS_STORE_URL)."""
    from service.commands.administration import any_key
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


def _queues(text: str) -> tuple[str, ...]:
    from service.settings import UnknownQueue, queue_names

    try:
        return queue_names(text)
    except UnknownQueue as error:
        refuse(f"{error}.", "Queues are cpu, gpu and cfd; put commas between them.")
