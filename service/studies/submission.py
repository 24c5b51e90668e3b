"""From a request to a queued study."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from dualms.errors import DualMSError
from dualms.spec import Spec, Unit
from dualms.study.figures import default_metrics
from dualms.study.grid import InvalidPoint, Point, grid_points
from service.access import Caller, may_use_domain, note, within_quota
from service.backend import Backend
from service.designs.checks import check_against_domain
from service.designs.resolve import resolved
from service.designs.submission import MAX_KEY, admitted
from service.problems import FieldProblem, Problem, from_dualms
from service.studies.schemas import StudyIn
from worker.rows import NewDesign
from worker.studies import NewStudy, Studies, StudyRecord
from worker.views import DomainRecord


def submit_study(backend: Backend, caller: Caller, wanted: StudyIn, key: str | None) -> StudyRecord:
    """Check every point, record the study with its designs, and announce them; the same key gives the same study.

    Raises
    ------
    Problem
        ``study-too-large``, ``invalid-request`` with the paths that do not fit, or what a design is refused for.
    """
    if key is not None and not (0 < len(key) <= MAX_KEY and key.isprintable()):
        advice = "Use a random UUID."
        raise Problem("malformed-request", f"An Idempotency-Key has 1 to {MAX_KEY} printable characters.", advice)
    domain = backend.domain(wanted.domain)
    may_use_domain(caller, domain.owner, domain.id)
    points = study_points(wanted.spec, wanted.grid)
    queues = backend.records.live_queues()
    points = tuple(replace(p, spec=_resolved(p, domain, queues)) for p in points)
    new = NewStudy(
        domain_id=domain.id,
        spec=dict(wanted.spec),
        grid={path: list(values) for path, values in wanted.grid.items()},
        metrics=wanted.metrics or default_metrics(p.spec for p in points),
        points=tuple((p.values, _design(p, domain, wanted, caller.owner, backend.tracing.context())) for p in points),
        name=wanted.name,
        labels=wanted.labels,
        owner=caller.owner,
    )
    digest = hashlib.sha256(("study" + wanted.model_dump_json()).encode()).hexdigest()
    study, made = admitted(
        backend,
        caller,
        domain.id,
        lambda: Studies(backend.records).create(
            new,
            (key, digest) if key is not None else None,
            admit=lambda: within_quota(backend, caller, designs=len(points)),
        ),
    )
    if made:
        note(backend, caller, "study.create", study.id, points=len(points))
        designs = [point.design for point in study.points if point.design is not None]
        all(map(backend.wakeups.send, designs))  # to the first that fails: where the broker is away, the reaper sends
    return study


def study_points(spec: Mapping[str, Any], grid: Mapping[str, list[Any]]) -> tuple[Point, ...]:
    """All points of a grid.

    Raises
    ------
    Problem
        ``invalid-request`` with the paths that do not fit; ``study-too-large``.
    """
    try:
        return grid_points(spec, grid)
    except InvalidPoint as error:
        fields = [FieldProblem(field=field, message=message) for field, message in error.errors]
        detail = f"{fields[0].field}: {fields[0].message}, {where(error.values)}"
        advice = "Unknown paths are refused: check the spelling. GET /openapi.json has the specification's schema."
        raise Problem("invalid-request", detail, advice, errors=fields) from None
    except DualMSError as error:
        raise from_dualms(error) from None


def where(values: Mapping[str, Any]) -> str:
    """A point of the grid, for messages."""
    shown = ", ".join(f"{path} = {json.dumps(value)[:80]}" for path, value in values.items())
    return f"at {shown}"


def _resolved(point: Point, domain: DomainRecord, queues: frozenset[str]) -> Spec:
    units, found = Unit(domain.units), domain.inspection
    low, high = found["bounds"]
    try:
        check_against_domain(point.spec, units, (tuple(low), tuple(high)), len(found["facets"]))
        return resolved(point.spec, units, queues)
    except DualMSError as error:
        problem = from_dualms(error)
        detail = f"{error.message} ({where(point.values)})"
        raise Problem(problem.code, detail, error.advice, measured=error.measured) from None


def _design(point: Point, domain: DomainRecord, wanted: StudyIn, owner: str | None, trace: str | None) -> NewDesign:
    name = ", ".join(f"{path.rpartition('.')[2]}={json.dumps(v)}" for path, v in point.values.items())
    name = f"{wanted.name}: {name}" if wanted.name else name
    # One below a single design's: whoever sends one while their study runs does not wait for all of it.
    return NewDesign(
        domain_id=domain.id,
        spec=point.spec,
        name=name[:200],
        labels=wanted.labels,
        owner=owner,
        priority=-1,
        trace=trace,
    )
