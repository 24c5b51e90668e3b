"""Bringing the tables to the newest version, at every start.

A look at the version costs a millisecond; an empty database gets the newest tables at once, and Alembic is imported
only where there are older ones (it costs a fifth of a second, and a first start should be as quick as any). Processes
that start at once take turns: SQLite by a lock on a file beside the database, PostgreSQL by an advisory lock.
"""

from __future__ import annotations

import fcntl
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from sqlalchemy import Column, Engine, MetaData, PrimaryKeyConstraint, String, Table, insert, inspect, text

from worker.tables import Base

HEAD = "0004"
# As Alembic makes it.
_VERSION = Table(
    "alembic_version",
    MetaData(),
    Column("version_num", String(32), nullable=False),
    PrimaryKeyConstraint("version_num", name="alembic_version_pkc"),
)
_LOCK = 7_011_874_523_117  # any number that nothing else in the database uses


class NewerDatabase(Exception):
    """The database was written by a newer version of DualMS."""


def migrate(engine: Engine) -> None:
    """Create or upgrade the tables.

    Raises
    ------
    NewerDatabase
        If the database's version is unknown to this code.
    """
    if _version(engine) == HEAD:
        return
    with _alone(engine):
        found = _version(engine)
        if found == HEAD:
            return
        if not inspect(engine).get_table_names():
            _make(engine)
            return
        from alembic import command
        from alembic.config import Config
        from alembic.script import ScriptDirectory

        config = Config()
        config.set_main_option("script_location", str(Path(__file__).parent))
        known = {script.revision for script in ScriptDirectory.from_config(config).walk_revisions()}
        if found is not None and found not in known:
            raise NewerDatabase(
                f"The database has version {found}; this DualMS knows up to {HEAD}. Start the newer version."
            )
        with engine.connect() as connection:
            config.attributes["connection"] = connection
            command.upgrade(config, "head")


def _make(engine: Engine) -> None:
    """All tables, and the version that they have; all or nothing where the database can undo making tables."""
    with engine.begin() as connection:
        Base.metadata.create_all(connection)
        _VERSION.create(connection)
        connection.execute(insert(_VERSION).values(version_num=HEAD))


def _version(engine: Engine) -> str | None:
    with engine.connect() as connection:
        if not inspect(connection).has_table("alembic_version"):
            return None
        return connection.execute(text("SELECT version_num FROM alembic_version")).scalar_one_or_none()


@contextmanager
def _alone(engine: Engine) -> Iterator[None]:
    path = engine.url.database
    if engine.dialect.name == "sqlite" and path and path != ":memory:":
        with Path(f"{path}.migrating").open("a") as file:
            fcntl.flock(file, fcntl.LOCK_EX)
            yield
    elif engine.dialect.name == "postgresql":
        with engine.connect() as connection:
            connection.execute(text("SELECT pg_advisory_lock(:key)"), {"key": _LOCK})
            try:
                yield
            finally:
                connection.execute(text("SELECT pg_advisory_unlock(:key)"), {"key": _LOCK})
    else:
        yield
