"""``python -m worker.healthy``: exit code 0 while a worker of this machine (or container) gives signs of life."""

from __future__ import annotations

import sys

from sqlalchemy import func, select

from worker import tables
from worker.database import Database, Now
from worker.host import this_host
from worker.settings import Settings


def healthy(database: Database, gone_s: float) -> bool:
    """Whether a worker of this machine has beaten within ``gone_s`` seconds."""
    w = tables.Worker
    alive = select(func.count()).where(w.host == this_host(), w.heartbeat_at > Now() - gone_s)
    with database.read() as session:
        return session.execute(alive).scalar_one() > 0


def main() -> int:
    """Look once."""
    settings = Settings()
    database = Database(settings.database)
    try:
        return 0 if healthy(database, settings.worker_gone_s) else 1
    finally:
        database.close()


if __name__ == "__main__":
    sys.exit(main())
