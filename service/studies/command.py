"""What ``dualms study`` does: reads the file, runs the study here or in a service, and leaves table and picture."""

from __future__ import annotations

import hashlib
import json
import re
from pathlib import Path
from typing import Any

from pydantic import ValidationError
from rich.console import Console
from rich.table import Table as RichTable

from dualms.errors import InvalidSpec
from dualms.study.table import Table, table_of
from service.client import Client, ServiceError
from service.problems import from_validation
from service.studies.schemas import StudyPlan
from service.tables import DesignProgress

REMEMBERED = "study.json"  # which study of which service a folder belongs to
_ID = re.compile("[0-9a-f]{64}")


def read_plan(path: Path, document: dict[str, Any], domain: Path | None) -> tuple[str | Path, StudyPlan]:
    """The domain (an id, or a file) and the plan.

    Parameters
    ----------
    path
        Of the study's file; a domain in it is found from there.
    document
        Its contents.
    domain
        Of the command line; goes before the file's.

    Raises
    ------
    DualMSError
        If it is no study.
    """
    document = dict(document)
    named = document.pop("domain", None)
    try:
        plan = StudyPlan.model_validate(document)
    except ValidationError as error:
        lines = "; ".join(f"{f.field}: {f.message}" for f in from_validation(error.errors(), document).errors)
        raise InvalidSpec(
            f"{path} is not a study: {lines}.", advice='It holds {"domain", "spec", "grid"}; README has an example.'
        ) from None
    if domain is not None:
        return domain, plan
    if not isinstance(named, str):
        raise InvalidSpec(f"{path} names no domain.", advice='Add "domain": "envelope.stl", or give --domain.')
    return (named, plan) if _ID.fullmatch(named) else (path.parent / named, plan)


def study_remote(client: Client, domain: str | Path, plan: StudyPlan, folder: Path, console: Console,
                 timeout_s: float) -> dict[str, Any]:  # fmt: skip
    """Send a study, follow it, download its tables; a folder that has sent the same study before follows that one."""
    document = plan.model_dump(mode="json", exclude_none=True)
    if isinstance(domain, Path):
        units = plan.spec.get("units")
        with console.status(f"uploading {domain.name}…"):
            domain = str(client.upload_domain(domain, units if isinstance(units, str) else None)["id"])
    record = _remembered(client, domain, document, folder)
    console.print(f"study {record['id']}", highlight=False)
    with DesignProgress(console) as bar:
        record = client.wait_study(record["id"], lambda r: _show(bar, r), timeout_s)
    client.download_study(record, folder)
    return record


def _show(bar: DesignProgress, record: dict[str, Any]) -> None:
    counts = record["counts"]
    ended = counts["succeeded"] + counts["failed"] + counts["cancelled"]
    note = f"{counts['failed']} failed" if counts["failed"] else ""
    bar.show("running", f"{ended}/{len(record['rows'])} ended", record["progress"], note)


def _remembered(client: Client, domain: str, document: dict[str, Any], folder: Path) -> dict[str, Any]:
    digest = hashlib.sha256(json.dumps([domain, document]).encode()).hexdigest()
    note = folder / REMEMBERED
    if note.exists():
        known = json.loads(note.read_text(encoding="utf-8"))
        if known["sha256"] == digest:
            try:
                record, _ = client.study(known["id"])
            except ServiceError as error:
                if error.status != 404:
                    raise
            else:
                if record is not None and record["status"] != "cancelled":
                    return record
    record = client.submit_study(domain, document)
    folder.mkdir(parents=True, exist_ok=True)
    note.write_text(json.dumps({"id": record["id"], "sha256": digest}) + "\n", encoding="utf-8")
    return record


def front_table(table: Table) -> RichTable:
    """The front, for people."""
    front = sorted((row for row in table.rows if row.front), key=lambda row: table.place(row) or (0.0, 0.0))
    shown = RichTable(title=f"on the front: {len(front)} of {len(table.rows)} points", title_justify="left")
    for column in (*table.axes, table.objectives.small, table.objectives.large):
        shown.add_column(column, justify="right", overflow="fold")
    for row in front:
        small, large = table.place(row) or (0.0, 0.0)
        shown.add_row(*(json.dumps(row.values[a]) for a in table.axes), f"{small:.4g}", f"{large:.4g}")
    return shown


def read_table(folder: Path) -> Table:
    """The table that a study has left."""
    return table_of(json.loads((folder / "table.json").read_text(encoding="utf-8")))
