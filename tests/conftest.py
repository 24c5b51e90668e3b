"""Servers that a team's cluster shares, real and started once a run; and which tests share them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from xdist.scheduler import LoadFileScheduling

from tests.postgres import Postgres
from tests.s3 import S3

TOGETHER = ("service", "worker")  # folders whose files share a running service, its cache of designs, or servers


class ByServers(LoadFileScheduling):  # type: ignore[misc]
    """One process runs all tests of a file, and of the folders whose files share servers."""

    def _split_scope(self, nodeid: str) -> str:
        file = str(super()._split_scope(nodeid))
        folder = file.split("/")[1]
        return folder if folder in TOGETHER else file


def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> ByServers | None:
    return ByServers(config, log) if config.getvalue("dist") == "loadfile" else None


@pytest.fixture(scope="session")
def postgres() -> Iterator[Postgres]:
    """A PostgreSQL whose databases tests may break."""
    server = Postgres()
    server.start()
    yield server
    server.close()


@pytest.fixture(scope="session")
def s3() -> Iterator[S3]:
    """An S3 server."""
    server = S3()
    server.start()
    yield server
    server.close()
