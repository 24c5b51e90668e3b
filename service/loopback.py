"""Names of this machine that no other machine's name can be made to mean."""

from __future__ import annotations

import ipaddress
from functools import lru_cache
from urllib.parse import urlsplit


@lru_cache(maxsize=256)
def asked_of_this_machine(header: str | None) -> bool:
    """Whether a Host header, with or without a port, names this machine."""
    try:
        return names_this_machine(urlsplit(f"//{header or ''}").hostname)
    except ValueError:
        return False


def names_this_machine(host: str | None) -> bool:
    """Whether a host name or address is a loopback one, without asking anybody: ``localhost`` and 127.0.0.0/8, ::1.

    A page on another site may let its own name lead to 127.0.0.1 (DNS rebinding), and a browser then counts this
    service as part of that site; but it still sends the site's name.
    """
    if host is None:
        return False
    if host == "localhost" or host.endswith(".localhost"):
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
