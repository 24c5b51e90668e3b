"""The message that a design has ended, recorded together with the ending; :mod:`worker.webhooks` sends it."""

from __future__ import annotations

import json
import secrets
from datetime import UTC, datetime

from sqlalchemy import select
from sqlalchemy.orm import Session

from worker import tables


def record_ending(session: Session, design_id: str, status: str) -> None:
    """Record the message that a design has ended, if its sender wants one; part of the ending's transaction."""
    d = tables.Design
    row = session.execute(
        select(d.webhook, d.name, d.labels, d.error, d.created_at, d.finished_at).where(d.id == design_id)
    ).one()
    if row.webhook is None:
        return
    data = {
        "id": design_id,
        "status": status,
        "name": row.name,
        "labels": row.labels,
        "error": row.error,
        "href": f"/v1/designs/{design_id}",
    }
    body = {"type": f"design.{status}", "timestamp": _iso(row.finished_at), "data": data}
    session.add(
        tables.Delivery(
            id="msg_" + secrets.token_hex(16),
            design_id=design_id,
            url=row.webhook,
            body=json.dumps(body),
            tries=0,
            next_at=row.finished_at,
            done_at=None,
            error=None,
        )
    )


def _iso(seconds: float) -> str:
    return datetime.fromtimestamp(seconds, UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
