"""``dualms keys`` and ``dualms gc``: what the administrator of a team's service does."""

from __future__ import annotations

import os
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.markup import escape
from rich.table import Table

from service.commands.console import Data, err, out

if TYPE_CHECKING:
    from worker.keys import KeyRecord, Keys
    from worker.settings import Settings

keys = typer.Typer(
    help="API keys of a team's service (in the data folder, or at DUALMS_DATABASE_URL).", no_args_is_help=True
)


@keys.callback()
def where(data: Data = None) -> None:
    """API keys of a team's service (in the data folder, or at DUALMS_DATABASE_URL)."""
    _use(data)


def any_key(settings: Settings) -> bool:
    """Whether there is a key that could be used now."""
    return _keys(settings).any_valid()


@keys.command("create")
def create(
    owner: Annotated[str, typer.Argument(help="Whose designs the key reaches; several keys may have one owner.")],
    name: Annotated[str, typer.Option(help="For people, such as the program that uses it.")] = "",
    scopes: Annotated[str, typer.Option(help="read, write, admin; with commas between.")] = "read,write",
    days: Annotated[float | None, typer.Option(help="Days until it expires (default: never).", min=0)] = None,
    max_live_designs: Annotated[int | None, typer.Option(help="Designs that have not ended, at once.", min=0)] = None,
    max_stored_bytes: Annotated[int | None, typer.Option(help="Bytes of domains and artifacts.", min=0)] = None,
    max_uploads_a_day: Annotated[int | None, typer.Option(help="Uploads in 24 hours.", min=0)] = None,
) -> None:
    """Make a key, and show it once. From the first key on, every call needs one."""
    from worker.keys import Quotas

    quotas = Quotas(max_live_designs, max_stored_bytes, max_uploads_a_day)
    wanted = tuple(part.strip() for part in scopes.split(",") if part.strip())
    try:
        made = _keys()
        key, secret = made.create(owner, name or owner, wanted, quotas, days)  # type: ignore[arg-type]
        made.note("key.create", key.id, owner=owner, key_id=None, scopes=",".join(wanted))
    except ValueError as error:
        err.print(f"[bold red]error:[/bold red] {escape(str(error))}", highlight=False)
        raise typer.Exit(2) from None
    err.print(f"key {key.id} of {escape(key.owner)}; this is the only time that it is shown:", highlight=False)
    out.print(secret, highlight=False, soft_wrap=True)


@keys.command("list")
def list_keys() -> None:
    """Show all keys, without their secrets."""
    table = Table()
    for column in ("id", "owner", "name", "scopes", "quotas", "made", "expires", "last used", ""):
        table.add_column(column)
    for key in _keys().all():
        table.add_row(*_row(key))
    out.print(table)


@keys.command("revoke")
def revoke(key_id: Annotated[str, typer.Argument(help="Id of the key, as `dualms keys list` shows it.")]) -> None:
    """Make a key invalid for ever; takes a few seconds to reach every API process."""
    known = _keys()
    if not known.revoke(key_id):
        err.print(f"[bold red]error:[/bold red] There is no valid key {escape(key_id)}.", highlight=False)
        raise typer.Exit(2)
    known.note("key.revoke", key_id, owner=None, key_id=None)
    out.print(f"{key_id} is revoked.", highlight=False)


@keys.command("audit")
def audit(limit: Annotated[int, typer.Option(help="Lines.", min=1, max=10_000)] = 50) -> None:
    """Show who did what, newest first."""
    table = Table()
    for column in ("time", "owner", "key", "action", "subject", "detail"):
        table.add_column(column)
    for line in _keys().audit(limit):
        detail = " ".join(f"{k}={v}" for k, v in line.detail.items())
        table.add_row(
            _day(line.at, seconds=True), line.owner or "", line.key_id or "", line.action, line.subject, detail
        )
    out.print(table)


@keys.command("webhook-secret")
def show_webhook_secret() -> None:
    """Show the secret by which receivers check webhooks (Standard Webhooks)."""
    from service.settings import worker_settings
    from worker.records import Records
    from worker.webhooks import webhook_secret

    records = Records.open(worker_settings())
    out.print(webhook_secret(records.database), highlight=False)
    records.close()


def gc(data: Data = None) -> None:
    """Remove what no living record points to, and what is past its retention."""
    _use(data)
    from service.settings import worker_settings
    from worker.garbage import collect
    from worker.records import Records
    from worker.stores import open_store

    settings = worker_settings()
    records = Records.open(settings)
    with err.status("collecting…"):
        found = collect(records, open_store(settings))
    records.close()
    out.print(
        f"removed: {found.designs} designs, {found.results} cached results, {found.blobs} files, {found.bytes:,} bytes",
        highlight=False,
    )


def _use(data: Path | None) -> None:
    if data is not None:
        os.environ["DUALMS_DATA_DIR"] = str(data)


def _keys(settings: Settings | None = None) -> Keys:
    from service.settings import worker_settings
    from worker.keys import Keys
    from worker.records import Records

    return Keys(Records.open(settings or worker_settings()).database)


def _row(key: KeyRecord) -> list[str]:
    limits = {"designs": key.quotas.max_live_designs, "bytes": key.quotas.max_stored_bytes,
              "uploads/day": key.quotas.max_uploads_a_day}  # fmt: skip
    return [
        key.id,
        key.owner,
        key.name,
        ", ".join(key.scopes),
        ", ".join(f"{k} {v:,}" for k, v in limits.items() if v is not None) or "none",
        _day(key.created_at),
        _day(key.expires_at) if key.expires_at is not None else "never",
        _day(key.last_used_at) if key.last_used_at is not None else "never",
        "revoked" if key.revoked_at is not None else "",
    ]


def _day(when: float, *, seconds: bool = False) -> str:
    return datetime.fromtimestamp(when, UTC).strftime("%Y-%m-%d %H:%M:%S" if seconds else "%Y-%m-%d")
