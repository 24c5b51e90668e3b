"""Which names are this machine's, whatever a name server says."""

from __future__ import annotations

import pytest

from service.loopback import asked_of_this_machine


@pytest.mark.parametrize(
    "header", ["localhost", "localhost:8000", "127.0.0.1:80", "127.9.9.9", "[::1]:8000", "[::1]", "a.localhost"]
)
def test_loopback_names(header: str) -> None:
    assert asked_of_this_machine(header)


@pytest.mark.parametrize(
    "header",
    [
        None,
        "",
        "evil.example",
        "localhost.evil.example",
        "127.0.0.1.evil.example:80",
        "10.0.0.1",
        "[::2]",
        "0.0.0.0",
        "][",
    ],
)
def test_other_names(header: str | None) -> None:
    assert not asked_of_this_machine(header)
