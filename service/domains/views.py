"""A domain's row as clients see it."""

from __future__ import annotations

from dualms.spec import Unit
from service.domains.schemas import DomainOut, FacetOut
from service.times import iso
from worker.views import DomainRecord


def domain_view(row: DomainRecord) -> DomainOut:
    """The record of one domain."""
    found = row.inspection
    return DomainOut(
        id=row.id,
        name=row.name,
        format=row.suffix.removeprefix("."),
        size=row.size,
        sha256=row.sha256,
        units=Unit(row.units),
        vertices=found["vertices"],
        faces=found["faces"],
        bounds=found["bounds"],
        volume=found["volume"],
        area=found["area"],
        watertight=found["watertight"],
        facets=[FacetOut(**facet) for facet in found["facets"]],
        problems=list(found["problems"]),
        created_at=iso(row.created_at),
        href=f"/v1/domains/{row.id}",
        file=f"/v1/domains/{row.id}/file",
    )
