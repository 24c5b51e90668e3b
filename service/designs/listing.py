"""Pages of designs, newest first."""

from __future__ import annotations

import re
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Annotated
from urllib.parse import urlencode

from fastapi import Query
from pydantic import AwareDatetime, BeforeValidator

from service.backend import Backend
from service.designs.schemas import DesignPage, Label, Status
from service.designs.views import design_summary


def _no_number(value: object) -> object:
    """Refuse seconds since 1970, which pydantic would take and the document does not promise."""
    if isinstance(value, str) and re.fullmatch(r"[-+]?[\d.eE+-]+", value) and value.count("-") < 2:
        raise ValueError("a time is ISO 8601 with a time zone, such as 2026-01-31T12:00:00Z")
    return value


Time = Annotated[AwareDatetime, BeforeValidator(_no_number)]


@dataclass(frozen=True)
class Filters:
    """Which designs; all that are given must hold."""

    limit: Annotated[int, Query(ge=1, le=200, description="Designs a page.")] = 50
    cursor: Annotated[str | None, Query(pattern="^[0-9a-f]{32}$", description="From the page before.")] = None
    status: Annotated[Status | None, Query(description="Only these.")] = None
    label: Annotated[Label | None, Query(description="Only those with this label.")] = None
    created_after: Annotated[Time | None, Query(description="ISO 8601, with a time zone; included.")] = None
    created_before: Annotated[Time | None, Query(description="ISO 8601, with a time zone; excluded.")] = None


def list_page(backend: Backend, filters: Filters, owner: str | None) -> DesignPage:
    """One page; of one owner's designs if one is given."""
    page = backend.records.designs(
        limit=filters.limit,
        cursor=filters.cursor,
        status=filters.status.value if filters.status else None,
        label=filters.label,
        created_after=_seconds(filters.created_after),
        created_before=_seconds(filters.created_before),
        owner=owner,
    )
    items = [design_summary(row, backend.domain_name(row.domain_id)) for row in page.items]
    return DesignPage(items=items, next=_next(filters, page.next))


def _next(filters: Filters, cursor: str | None) -> str | None:
    if cursor is None:
        return None
    given = {
        "limit": str(filters.limit),
        "status": filters.status.value if filters.status else None,
        "label": filters.label,
        "created_after": _text(filters.created_after),
        "created_before": _text(filters.created_before),
        "cursor": cursor,
    }
    return "/v1/designs?" + urlencode({k: v for k, v in given.items() if v is not None})


def _seconds(when: datetime | None) -> float | None:
    return when.timestamp() if when else None


def _text(when: datetime | None) -> str | None:
    return when.astimezone(UTC).isoformat().replace("+00:00", "Z") if when else None
