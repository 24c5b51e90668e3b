"""A refusal is read whole by a client that is still sending, however slowly it sends and reads."""

from __future__ import annotations

import socket
import time
from urllib.parse import urlsplit

import pytest

from tests.service.conftest import Served

CHUNK = b"%x\r\n" % 65536 + b"x" * 65536 + b"\r\n"


def post(served: Served, length: str) -> tuple[socket.socket, bytes]:
    """A connection, and the head of a request on it."""
    address = urlsplit(served.url)
    lines = ("POST /v1/designs HTTP/1.1", f"Host: {address.netloc}", "Content-Type: application/json", length, "", "")
    return socket.create_connection((address.hostname, address.port), timeout=30), "\r\n".join(lines).encode()


@pytest.mark.parametrize("pause_s", [0.0, 0.02])
def test_a_refusal_is_read_after_all_was_sent(served: Served, pause_s: float) -> None:
    connection, head = post(served, "Transfer-Encoding: chunked")
    answer = b""
    with connection:
        connection.sendall(head)
        for _ in range(64):
            connection.sendall(CHUNK)
            time.sleep(pause_s)
        connection.sendall(b"0\r\n\r\n")
        time.sleep(0.2)  # a reset would have come by now, and taken the answer along
        while more := connection.recv(65536):
            answer += more
    assert answer.startswith(b"HTTP/1.1 413 ")
    assert b"too-large" in answer


def test_a_client_that_stops_sending_does_not_hold_the_connection(served: Served) -> None:
    connection, head = post(served, "Content-Length: 9000000")
    began = time.monotonic()
    with connection:
        connection.sendall(head + b"x" * 1000)
        answer = connection.recv(65536)
        assert time.monotonic() - began < 4, "the answer does not wait for the body"
        while more := connection.recv(65536):
            answer += more
    assert b" 413 " in answer
    assert time.monotonic() - began < 20
