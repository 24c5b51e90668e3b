"""The query behind a list of designs: filters that the indices serve, however many designs there are."""

from __future__ import annotations

from typing import Any

from sqlalchemy import Select, select

from worker import tables
from worker.rows import id_at
from worker.views import Status

DAY_S = 86400


def newest_first(
    *,
    cursor: str | None,
    status: Status | None,
    label: str | None,
    created_after: float | None,
    created_before: float | None,
    owner: str | None,
    study_id: str | None,
) -> Select[Any]:
    """Designs, newest first; every filter that is given must hold. ``cursor`` is the id of the last one seen."""
    d = tables.Design
    order = d.id if label is None else tables.DesignLabel.design_id  # the index of labels has that order
    query = select(d).order_by(order.desc())
    if label is not None:
        query = query.join(tables.DesignLabel, tables.DesignLabel.design_id == d.id)
        query = query.where(tables.DesignLabel.label == label)
    if cursor is not None:
        query = query.where(order < cursor)
    if status is not None:
        query = query.where(d.status == status)
    # Ids begin with the time of their maker's clock: a day either side is generous, and lets the index do the rest.
    if created_after is not None:
        query = query.where(d.created_at >= created_after, order >= id_at(created_after - DAY_S))
    if created_before is not None:
        query = query.where(d.created_at < created_before, order < id_at(created_before + DAY_S))
    if owner is not None:
        query = query.where(d.owner == owner)
    if study_id is not None:
        query = query.where(d.study_id == study_id)
    return query
