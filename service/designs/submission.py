"""From a request to a queued design."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from sqlalchemy.exc import IntegrityError

from dualms.spec import Unit
from service.access import Caller, domain_not_found, note, within_quota
from service.backend import Backend
from service.designs.checks import check_against_domain
from service.designs.requests import Wanted
from service.designs.resolve import resolved
from service.problems import Problem
from worker.idempotency import IdempotencyConflict
from worker.rows import NewDesign
from worker.views import DesignRecord

MAX_KEY = 255
T = TypeVar("T")


def submit(backend: Backend, caller: Caller, wanted: Wanted, key: str | None) -> DesignRecord:
    """Check, resolve, record and announce a design; the same key gives the same design.

    Raises
    ------
    Problem
        ``idempotency-key-reused``, ``malformed-request``, ``webhook-refused`` or ``quota-exceeded``.
    DualMSError
        If the specification does not fit the domain, or asks for what no worker can do.
    """
    if key is not None and not (0 < len(key) <= MAX_KEY and key.isprintable()):
        advice = "Use a random UUID."
        raise Problem("malformed-request", f"An Idempotency-Key has 1 to {MAX_KEY} printable characters.", advice)
    units = Unit(wanted.domain.units)
    found = wanted.domain.inspection
    low, high = found["bounds"]
    check_against_domain(wanted.spec, units, (tuple(low), tuple(high)), len(found["facets"]))
    spec = resolved(wanted.spec, units, backend.records.live_queues())
    new = NewDesign(
        domain_id=wanted.domain.id,
        spec=spec,
        name=wanted.options.name,
        labels=wanted.options.labels,
        deadline_s=wanted.options.deadline_s,
        priority=wanted.options.priority,
        webhook=wanted.options.webhook,
        owner=caller.owner,
        trace=backend.tracing.context(),
    )
    _check_webhook(backend, new.webhook)
    row, made = admitted(
        backend,
        caller,
        new.domain_id,
        lambda: backend.records.create_design(
            new,
            (key, wanted.sha256) if key is not None else None,
            admit=lambda: within_quota(backend, caller, designs=1),
        ),
    )
    if made:
        backend.wakeups.send(row)
        note(backend, caller, "design.create", row.id)
    return row


def admitted(backend: Backend, caller: Caller, domain_id: str, create: Callable[[], T]) -> T:
    """What ``create`` makes of a domain, while nobody else of the same owner makes anything.

    Raises
    ------
    Problem
        ``idempotency-key-reused``, ``domain-not-found``, or what ``create`` raises.
    """
    with backend.turns.of(caller.owner):
        try:
            return create()
        except IdempotencyConflict:
            raise Problem(
                "idempotency-key-reused",
                "This Idempotency-Key was used before with another body.",
                "Send the first body again, or use a new key.",
            ) from None
        except IntegrityError:  # in this very moment the domain was deleted
            raise domain_not_found(domain_id) from None


def _check_webhook(backend: Backend, url: str | None) -> None:
    if url is None:
        return
    from worker.webhooks import BadAddress, check_address

    try:
        check_address(url, backend.worker_settings.webhook_private)
    except BadAddress as error:
        raise Problem("webhook-refused", f"webhook: {error}.", "Give an address that the public reaches.") from None
