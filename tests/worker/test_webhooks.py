"""Webhooks: signed, repeated until taken, and never a way into the private network."""

from __future__ import annotations

import base64
import hashlib
import hmac
import json
import socket
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import pytest
from sqlalchemy import update

from tests.worker.conftest import small_spec
from worker import tables
from worker.database import Now
from worker.records import Records
from worker.rows import NewDesign
from worker.settings import Settings
from worker.views import DesignRecord, DomainRecord
from worker.webhooks import BadAddress, Deliverer, check_address, signature, webhook_secret


class Receiver(ThreadingHTTPServer):
    """Takes messages; answers with the codes that it is given, then 200."""

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), _Handler)
        self.got: list[tuple[dict[str, str], str]] = []
        self.answers: list[int] = []
        threading.Thread(target=self.serve_forever, daemon=True).start()

    @property
    def url(self) -> str:
        return f"http://localhost:{self.server_address[1]}/hook?x=1"


class _Handler(BaseHTTPRequestHandler):
    def do_POST(self) -> None:
        assert isinstance(self.server, Receiver)
        body = self.rfile.read(int(self.headers["content-length"])).decode()
        self.server.got.append(({k.lower(): v for k, v in self.headers.items()} | {"path": self.path}, body))
        code = self.server.answers.pop(0) if self.server.answers else 200
        self.send_response(code)
        if 300 <= code < 400:
            self.send_header("location", "/elsewhere")
        self.send_header("content-length", "0")
        self.end_headers()

    def log_message(self, format: str, *args: object) -> None:
        pass


@pytest.fixture
def receiver() -> Iterator[Receiver]:
    receiver = Receiver()
    yield receiver
    receiver.shutdown()
    receiver.server_close()


@pytest.fixture
def deliverer(records: Records) -> Deliverer:
    return Deliverer(records.database, Settings(webhook_private=True))


def ended(records: Records, domain: DomainRecord, url: str | None) -> DesignRecord:
    made, _ = records.create_design(NewDesign(domain.id, small_spec(), name="n", webhook=url))
    records.cancel(made.id)
    return made


def make_due(records: Records) -> None:
    with records.database.write() as session:
        session.execute(update(tables.Delivery).values(next_at=Now() - 1))


def test_the_ending_is_told_once_and_signed(
    records: Records, domain: DomainRecord, receiver: Receiver, deliverer: Deliverer
) -> None:
    made = ended(records, domain, receiver.url)
    ended(records, domain, None)
    records.cancel(made.id)
    assert deliverer.run_once() == 1
    make_due(records)
    assert deliverer.run_once() == 0
    ((headers, body),) = receiver.got
    document = json.loads(body)
    assert document["type"] == "design.cancelled"
    assert document["data"]["id"] == made.id
    assert headers["path"] == "/hook?x=1"
    assert headers["host"].startswith("localhost:")
    key = base64.b64decode(webhook_secret(records.database).removeprefix("whsec_"))
    signed = f"{headers['webhook-id']}.{headers['webhook-timestamp']}.{body}".encode()
    expected = base64.b64encode(hmac.new(key, signed, hashlib.sha256).digest()).decode()
    assert headers["webhook-signature"] == f"v1,{expected}"


def test_the_signature_is_that_of_the_standards_example() -> None:
    secret = "whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw"
    made = signature(secret, "msg_p5jXN8AQM9LWM0D4loKWxJek", 1614265330, '{"test": 2432232314}')
    assert made == "v1,g0hM9SsE+OTPJTGt/tmIKtSyZlE3uFJELVlNIOLJ1OE="


def test_a_refused_message_comes_again_with_the_same_id(
    records: Records, domain: DomainRecord, receiver: Receiver, deliverer: Deliverer
) -> None:
    receiver.answers = [500, 302]
    ended(records, domain, receiver.url)
    assert [deliverer.run_once(), deliverer.run_once()] == [0, 0]
    make_due(records)
    assert deliverer.run_once() == 0, "a redirect is not followed"
    make_due(records)
    assert deliverer.run_once() == 1
    assert len({headers["webhook-id"] for headers, _ in receiver.got}) == 1
    assert [headers["path"] for headers, _ in receiver.got] == ["/hook?x=1"] * 3


def test_a_message_is_given_up_in_the_end(
    records: Records, domain: DomainRecord, receiver: Receiver, deliverer: Deliverer
) -> None:
    receiver.answers = [500] * 100
    ended(records, domain, receiver.url)
    for _ in range(20):
        deliverer.run_once()
        make_due(records)
    assert len(receiver.got) == 10


@pytest.mark.parametrize(
    "url",
    [
        "http://localhost/x",
        "http://127.0.0.1:80/",
        "http://[::1]/",
        "http://[::ffff:10.0.0.1]/",
        "http://169.254.169.254/latest/meta-data",
        "http://10.1.2.3/",
        "http://2130706433/",
        "http://0.0.0.0/",
        "http://user:pass@93.184.216.34/",
        "ftp://93.184.216.34/",
        "http://93.184.216.34:99999/",
        "file:///etc/passwd",
        "nonsense",
    ],
)
def test_private_and_odd_addresses_are_refused(url: str) -> None:
    with pytest.raises(BadAddress):
        check_address(url, allow_private=False)


def test_public_addresses_are_allowed() -> None:
    assert check_address("https://93.184.216.34/x", allow_private=False).port == 443


def test_a_private_address_is_not_connected_to(records: Records, domain: DomainRecord, receiver: Receiver) -> None:
    ended(records, domain, receiver.url)
    assert Deliverer(records.database, Settings()).run_once() == 0
    assert receiver.got == []


def test_a_name_is_resolved_once_and_what_was_checked_is_connected_to(
    records: Records, domain: DomainRecord, receiver: Receiver, deliverer: Deliverer, monkeypatch: pytest.MonkeyPatch
) -> None:
    real, port = socket.getaddrinfo, receiver.server_address[1]
    asked: list[str] = []

    def rebinding(host: str, *args: Any, **options: Any) -> Any:
        """The first answer leads to the receiver; every later one elsewhere, as an attacker's server would say."""
        if host != "hooks.example":
            return real(host, *args, **options)
        asked.append(host)
        return real("127.0.0.1" if len(asked) == 1 else "127.0.0.2", *args, **options)

    monkeypatch.setattr(socket, "getaddrinfo", rebinding)
    ended(records, domain, f"http://hooks.example:{port}/hook")
    assert deliverer.run_once() == 1
    assert asked == ["hooks.example"]
    ((headers, _),) = receiver.got
    assert headers["host"] == f"hooks.example:{port}"


def test_a_name_that_leads_inside_later_is_refused_then(
    records: Records, domain: DomainRecord, monkeypatch: pytest.MonkeyPatch, receiver: Receiver
) -> None:
    url = f"http://hooks.example:{receiver.server_address[1]}/hook"
    real = socket.getaddrinfo
    leads_to = "93.184.216.34"
    monkeypatch.setattr(socket, "getaddrinfo", lambda host, *a, **k: real(leads_to, *a, **k))
    check_address(url, allow_private=False)  # as at submission
    leads_to = "127.0.0.1"
    ended(records, domain, url)
    assert Deliverer(records.database, Settings()).run_once() == 0
    assert receiver.got == []
