"""Webhooks: a signed message to the sender's address when a design ends, repeated until it is taken.

The message is recorded in the transaction that ends the design, so none is lost; it may come twice, with the same id.
Signatures follow Standard Webhooks (github.com/standard-webhooks, version 1): HMAC-SHA256 over id, time and body.
Addresses that are not public are refused unless the settings allow them, redirects are not followed, and the address
that was checked is the one that is connected to.
"""

from __future__ import annotations

import base64
import contextlib
import hashlib
import hmac
import ipaddress
import logging
import secrets
import socket
import time
from dataclasses import dataclass
from typing import Any
from urllib.parse import urlsplit

import httpx
from sqlalchemy import select, update
from sqlalchemy.exc import IntegrityError

from worker import tables
from worker.database import Database, Now
from worker.settings import Settings

# Seconds after each failed try, as Standard Webhooks recommends; then it is given up.
BACKOFF_S = (5, 300, 1800, 7200, 18_000, 36_000, 50_400, 72_000, 86_400)
TIMEOUT_S = 10.0
_CLAIM_S = 60.0
_SECRET = "webhook"
log = logging.getLogger(__name__)


class BadAddress(ValueError):
    """The address cannot be a webhook's; the message says why."""


@dataclass(frozen=True)
class Target:
    """Where to connect, and which name to ask for there."""

    host: str
    address: str
    port: int


def check_address(url: str, allow_private: bool) -> Target:
    """Resolve a webhook's address.

    Raises
    ------
    BadAddress
        If it is not HTTP(S), carries credentials, does not resolve, or leads to a host that is not public.
    """
    parts = urlsplit(url)
    try:
        port = parts.port or (443 if parts.scheme == "https" else 80)
    except ValueError:
        raise BadAddress("the port is not a number up to 65535") from None
    if parts.scheme not in ("http", "https") or not parts.hostname:
        raise BadAddress("a webhook is an http or https address")
    if parts.username or parts.password:
        raise BadAddress("a webhook's address must not carry a user or password")
    try:
        found = socket.getaddrinfo(parts.hostname, port, type=socket.SOCK_STREAM)
    except (OSError, UnicodeError):
        raise BadAddress(f"{parts.hostname} does not resolve") from None
    addresses = [str(item[4][0]) for item in found]
    # All of them must be public: which one is used is not for the sender to choose.
    if not allow_private and not all(_is_public(address) for address in addresses):
        raise BadAddress(f"{parts.hostname} is not a public address; DUALMS_WEBHOOK_PRIVATE=1 would allow it")
    return Target(parts.hostname, addresses[0], port)


def signature(secret: str, message_id: str, timestamp: int, body: str) -> str:
    """The header ``webhook-signature``; ``secret`` is ``whsec_`` and base64."""
    key = base64.b64decode(secret.removeprefix("whsec_"))
    digest = hmac.new(key, f"{message_id}.{timestamp}.{body}".encode(), hashlib.sha256).digest()
    return "v1," + base64.b64encode(digest).decode()


def webhook_secret(database: Database) -> str:
    """The cluster's secret for signing, made at its first use."""
    with database.read() as session:
        row = session.get(tables.Secret, _SECRET)
    if row is not None:
        return row.value
    value = "whsec_" + base64.b64encode(secrets.token_bytes(32)).decode()
    with contextlib.suppress(IntegrityError), database.write() as session:  # another process may have been as fast
        session.add(tables.Secret(name=_SECRET, value=value, created_at=time.time()))
    with database.read() as session:
        return session.get_one(tables.Secret, _SECRET).value


class Deliverer:
    """Sends what is due; any number may run, each message is claimed before it is sent."""

    def __init__(self, database: Database, settings: Settings) -> None:
        self._database = database
        self._private = settings.webhook_private

    def run_once(self) -> int:
        """Send what is due now; returns how many messages were taken."""
        taken = 0
        while (delivery := self._claim()) is not None:
            error = self._send(delivery)
            taken += error is None
            self._record(delivery, error)
        return taken

    def _claim(self) -> tables.Delivery | None:
        v = tables.Delivery
        with self._database.write() as session:
            due = select(v).where(v.done_at.is_(None), v.next_at <= Now()).order_by(v.next_at).limit(1)
            row = session.scalars(due.with_for_update(skip_locked=True)).first()
            if row is not None:
                row.tries += 1
                row.next_at = session.execute(select(Now() + _CLAIM_S)).scalar_one()
            return row

    def _send(self, delivery: tables.Delivery) -> str | None:
        """Why it was not taken; None if it was."""
        try:
            target = check_address(delivery.url, self._private)
        except BadAddress as error:
            return str(error)
        moment = int(time.time())
        headers = {
            "host": _host_header(delivery.url),
            "content-type": "application/json",
            "user-agent": "DualMS-Webhooks/1",
            "webhook-id": delivery.id,
            "webhook-timestamp": str(moment),
            "webhook-signature": signature(webhook_secret(self._database), delivery.id, moment, delivery.body),
        }
        url = httpx.URL(delivery.url).copy_with(host=target.address, port=target.port)
        try:
            with httpx.Client(timeout=TIMEOUT_S, follow_redirects=False, trust_env=False) as client:
                request = client.build_request("POST", url, content=delivery.body, headers=headers)
                request.extensions["sni_hostname"] = target.host
                answer = client.send(request, stream=True)  # the body does not matter, and may be endless
                answer.close()
        except httpx.HTTPError as error:
            return f"{type(error).__name__}: {error}"
        return None if 200 <= answer.status_code < 300 else f"the receiver answered {answer.status_code}"

    def _record(self, delivery: tables.Delivery, error: str | None) -> None:
        over = delivery.tries > len(BACKOFF_S)
        values: dict[str, Any] = {"error": error}
        if error is None or over:
            values["done_at"] = Now()
        else:
            values["next_at"] = Now() + BACKOFF_S[delivery.tries - 1]
        if error is not None:
            job = {"job_id": delivery.design_id}
            log.warning("webhook %s, try %d: %s", delivery.id, delivery.tries, error, extra=job)
        with self._database.write() as session:
            session.execute(update(tables.Delivery).where(tables.Delivery.id == delivery.id).values(**values))


def _is_public(address: str) -> bool:
    ip = ipaddress.ip_address(address.split("%")[0])
    inside = getattr(ip, "ipv4_mapped", None)
    return (inside or ip).is_global and not ip.is_multicast


def _host_header(url: str) -> str:
    return urlsplit(url).netloc
