"""Several machines on one: network namespaces on a bridge, any of which can be cut off (Linux, root, iproute2)."""

from __future__ import annotations

import os
import secrets
import subprocess
from collections.abc import Sequence


class Machines:
    """Named namespaces with addresses 10.77.0.1, 10.77.0.2, …

    Parameters
    ----------
    names
        One for each machine.

    Raises
    ------
    PermissionError
        If this user or this machine has no namespaces.
    """

    def __init__(self, names: Sequence[str]) -> None:
        self._mark = secrets.token_hex(2)
        self._names = list(names)
        self._switch = f"dms{self._mark}"
        self._made: list[str] = []
        try:
            self._build()
        except (FileNotFoundError, subprocess.CalledProcessError) as error:
            self.close()
            raise PermissionError("network namespaces need root and iproute2 on Linux") from error

    def address(self, name: str) -> str:
        return f"10.77.0.{self._names.index(name) + 1}"

    def on(self, name: str) -> tuple[str, ...]:
        """Words to put before a command that is to run there."""
        return ("ip", "netns", "exec", self._space(name))

    def cut(self, name: str) -> None:
        """Take a machine off the network: what is sent is lost, and no connection is closed."""
        _ip("-n", self._switch, "link", "set", f"p-{name}", "down")

    def join(self, name: str) -> None:
        """Bring it back."""
        _ip("-n", self._switch, "link", "set", f"p-{name}", "up")

    def close(self) -> None:
        for space in self._made:
            subprocess.run(["ip", "netns", "delete", space], check=False)
        self._made = []

    def _space(self, name: str) -> str:
        return f"{self._switch}-{name}"

    def _build(self) -> None:
        if os.geteuid() != 0:
            raise FileNotFoundError("not root")
        for space in (self._switch, *map(self._space, self._names)):
            _ip("netns", "add", space)
            self._made.append(space)
            _ip("-n", space, "link", "set", "lo", "up")
        _ip("-n", self._switch, "link", "add", "br0", "type", "bridge")
        _ip("-n", self._switch, "link", "set", "br0", "up")
        for name in self._names:
            space = self._space(name)
            port = ("name", f"p-{name}")
            _ip("-n", self._switch, "link", "add", *port, "type", "veth", "peer", "name", "eth0", "netns", space)
            _ip("-n", self._switch, "link", "set", f"p-{name}", "master", "br0", "up")
            _ip("-n", space, "address", "add", f"{self.address(name)}/24", "dev", "eth0")
            _ip("-n", space, "link", "set", "eth0", "up")


def _ip(*words: str) -> None:
    subprocess.run(["ip", *words], check=True, capture_output=True)
