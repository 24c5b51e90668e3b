"""Who calls, and what they may: API keys, scopes, owners, quotas.

Open as long as no key was ever made (``dualms serve`` then listens on the loopback only). From the first key on every
call under /v1 needs one; an owner sees nothing of another's, and an id of another's is answered like one that is not
there. ``admin`` keys see all.
"""

from __future__ import annotations

import hashlib
import time
from dataclasses import dataclass
from typing import Annotated, Any
from urllib.parse import urlsplit

from fastapi import Depends, Request
from fastapi.concurrency import run_in_threadpool
from sqlalchemy import select

from service.backend import Backend, design_not_found
from service.loopback import asked_of_this_machine
from service.problems import Problem
from worker import tables
from worker.keys import KeyRecord, Keys, Scope, exceeded
from worker.records import Records

REMEMBERED_S = 5.0  # a revoked key works at most so much longer
MOST_REMEMBERED = 4096
READING = ("GET", "HEAD")


@dataclass(frozen=True)
class Caller:
    """Who calls; without a key the service is open, and the caller may do all."""

    key: KeyRecord | None

    @property
    def owner(self) -> str | None:
        """Whose things this caller makes."""
        return self.key.owner if self.key is not None else None

    @property
    def only(self) -> str | None:
        """The owner whose things alone this caller sees; None: all."""
        return None if self.key is None or self.key.allows("admin") else self.key.owner


class Access:
    """What is known of keys and owners, remembered for a short while.

    Parameters
    ----------
    records
        The records.
    required
        Ask for a key even if there is none.
    loopback_only
        As long as none is asked for, answer only requests that name this machine.
    """

    def __init__(self, records: Records, required: bool, loopback_only: bool) -> None:
        self.keys, self._records, self._required = Keys(records.database), records, required
        self._loopback_only = loopback_only
        self._looked = float("-inf")
        self._known: dict[str, tuple[float, KeyRecord]] = {}
        self._owners: dict[tuple[str, str], str | None] = {}

    async def caller(self, secret: str | None, scope: Scope) -> Caller:
        """Who shows this secret, and whether they may do what needs ``scope``.

        Raises
        ------
        Problem
            ``key-required``, ``key-invalid`` or ``scope-missing``.
        """
        if not await self.needed():
            return Caller(None)
        if secret is None:
            raise _unauthorized("key-required", "This service asks for an API key.")
        key = await self._key(secret)
        if key is None:
            raise _unauthorized("key-invalid", "The API key is unknown, expired or revoked.")
        if not key.allows(scope):
            raise Problem("scope-missing", f"The key '{key.name}' has no scope '{scope}'.", "Use a key that has it.")
        return Caller(key)

    async def owner_of(self, kind: str, thing: str) -> str | None:
        """Owner of a design, study or domain; owners never change, so each is looked up once."""
        if (kind, thing) not in self._owners:
            found = await run_in_threadpool(self._owner, kind, thing)
            if found is None:
                return None
            if len(self._owners) >= 16 * MOST_REMEMBERED:
                self._owners.clear()
            self._owners[kind, thing] = found[0]
        return self._owners[kind, thing]

    async def needed(self) -> bool:
        """Whether keys are asked for; once a key was made they are for ever."""
        if not self._required and time.monotonic() - self._looked > 1.0:
            self._required = await run_in_threadpool(lambda: bool(self.keys.all()))
            self._looked = time.monotonic()
        return self._required

    async def open_to(self, request: Request) -> bool:
        """Whether this request may be answered at all: without keys, only one that names this machine, if so set."""
        named = request.headers.get("host")
        return not self._loopback_only or asked_of_this_machine(named) or await self.needed()

    async def _key(self, secret: str) -> KeyRecord | None:
        name, now = hashlib.sha256(secret.encode()).hexdigest(), time.monotonic()
        known = self._known.get(name)
        if known is not None and now - known[0] < REMEMBERED_S:
            return known[1]
        key = await run_in_threadpool(self.keys.check, secret)
        if len(self._known) >= MOST_REMEMBERED:
            self._known.clear()
        if key is not None:
            self._known[name] = (now, key)
        return key

    def _owner(self, kind: str, thing: str) -> tuple[str | None] | None:
        table: Any = {"design": tables.Design, "study": tables.Study, "domain": tables.Domain}[kind]
        with self._records.database.read() as session:
            row = session.execute(select(table.owner).where(table.id == thing)).first()
        return (row[0],) if row is not None else None


async def guard(request: Request) -> Caller:
    """Who calls; refuses those without a right to do so, and hides what is another owner's.

    It has no dependencies of its own: each would add about a tenth to the cost of a status poll.
    """
    access: Access = request.app.state.access
    scope: Scope = "read" if request.method in READING else "write"
    if scope == "write" and _from_another_site(request):
        raise Problem("cross-site", "A page of another site asked for this.", "Call the service from a program.")
    if not await access.open_to(request):
        detail = "Without keys this service answers to names of its own machine only."
        raise Problem("cross-site", detail, "Ask http://127.0.0.1 or http://localhost, or make a key.")
    caller = await access.caller(bearer(request.headers.get("authorization")), scope)
    request.state.caller = caller  # for the log
    if caller.only is not None:
        for name, thing in request.path_params.items():
            kind = name.removesuffix("_id")
            if kind in _HIDDEN and await access.owner_of(kind, str(thing)) != caller.only:
                raise _HIDDEN[kind](str(thing))
    return caller


def bearer(header: str | None) -> str | None:
    """The secret in an Authorization header; None where it shows none (RFC 6750)."""
    kind, _, secret = (header or "").partition(" ")
    return secret if kind.lower() == "bearer" and secret else None


async def open_to_all(request: Request) -> bool:
    """Whether no keys are asked for, and the request names this machine where that matters."""
    access: Access = request.app.state.access
    return not await access.needed() and await access.open_to(request)


def _from_another_site(request: Request) -> bool:
    """What browsers say of where a request comes from; older ones send its origin only."""
    site, origin = request.headers.get("sec-fetch-site"), request.headers.get("origin")
    if site is not None or origin is None:
        return site == "cross-site"
    return urlsplit(origin).netloc != request.headers.get("host")


OpenDep = Annotated[bool, Depends(open_to_all)]
CallerDep = Annotated[Caller, Depends(guard)]


def may_use_domain(caller: Caller, owner: str | None, domain_id: str) -> None:
    """Refuse another owner's domain as if it were not there.

    Raises
    ------
    Problem
        ``domain-not-found``.
    """
    if caller.only is not None and owner != caller.only:
        raise domain_not_found(domain_id)


def within_quota(backend: Backend, caller: Caller, *, designs: int = 0, stored: int = 0, uploads: int = 0) -> None:
    """Refuse what exceeds the key's quotas.

    Call it within ``Turns.of`` the owner. Turns are those of one API process: two may both give the last free place.

    Raises
    ------
    Problem
        ``quota-exceeded``.
    """
    key = caller.key
    if key is None or not any(vars(key.quotas).values()):
        return
    usage = Keys(backend.records.database).usage(key.owner)
    if (what := exceeded(key.quotas, usage, designs=designs, stored=stored, uploads=uploads)) is not None:
        advice = "Wait for designs to end, or delete some."
        raise Problem("quota-exceeded", f"That would be {what}.", advice, headers={"Retry-After": "30"})


def note(backend: Backend, caller: Caller, action: str, subject: str, **detail: Any) -> None:
    """Write a line of the audit log, where keys tell who did it."""
    if caller.key is not None:
        keys = Keys(backend.records.database)
        keys.note(action, subject, owner=caller.key.owner, key_id=caller.key.id, **detail)


def domain_not_found(domain_id: str) -> Problem:
    """The refusal for an id that names no domain."""
    return Problem("domain-not-found", f"There is no domain {domain_id}.", "Upload it: POST /v1/domains.")


def _study_not_found(study_id: str) -> Problem:
    advice = "It may have been deleted; GET /v1/studies lists those that are."
    return Problem("study-not-found", f"There is no study {study_id}.", advice)


def _unauthorized(code: str, detail: str) -> Problem:
    advice = "Send the header Authorization: Bearer KEY; whoever runs the service makes keys: dualms keys create."
    return Problem(code, detail, advice, headers={"WWW-Authenticate": "Bearer"})


_HIDDEN = {"design": design_not_found, "domain": domain_not_found, "study": _study_not_found}
