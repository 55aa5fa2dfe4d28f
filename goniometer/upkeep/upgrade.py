"""An older database becomes one of this version of the program."""

from dataclasses import dataclass
from pathlib import Path

from sqlalchemy import Connection, inspect, text

from goniometer.errors import StoreError
from goniometer.storage import migrations, tables
from goniometer.storage.database import Database
from goniometer.storage.only_added import VERBS
from goniometer.upkeep.backup import back_up, beside


@dataclass(frozen=True)
class Upgraded:
    """What was done to a database."""

    steps: list[str]
    """Revisions, in words; empty where it was of this version already."""
    backup: Path | None
    """The database as it was before; None where nothing was done, and where the server keeps backups."""


def upgrade(where: Path | str) -> Upgraded:
    """Bring a database to the tables of this program: all steps, or none.

    An SQLite file is backed up beside itself first. Raises `StoreBusy` while somebody uses it, `StoreError` where it is
    damaged, of another program or of a newer version of this one.
    """
    database = Database.as_it_is(where)
    try:
        with database.reading() as connection:
            revision = migrations.revision_of(connection)
        if revision == migrations.head():
            return Upgraded([], None)
        if revision is not None and revision not in migrations.known():
            raise StoreError(
                f"{database.where} was written by a newer version of this program, which calls its tables {revision}; "
                f"install that version"
            )
        with database.exclusive(everywhere=True):
            backup = None
            if database.file is not None:
                backup = beside(database.file, f"before-{migrations.head()}")
                back_up(database, backup)
            with database.alone(references_checked=False) as connection:
                steps = migrations.upgrade(connection)
                _check(connection, database.where)
        return Upgraded(steps, backup)
    finally:
        database.close()


def _check(connection: Connection, where: str) -> None:
    """Raise `StoreError`, so that nothing of the upgrade stays, where it has lost a reference or a trigger."""
    if connection.dialect.name != "sqlite":
        return
    for table, row, parent, _ in connection.execute(text("PRAGMA foreign_key_check")):
        raise StoreError(
            f"{where} cannot be upgraded: row {row} of {table} refers to a row of {parent} that is not there"
        )
    there = set(connection.execute(text("SELECT name FROM sqlite_master WHERE type = 'trigger'")).scalars())
    names = set(inspect(connection).get_table_names())
    for table in tables.protected():
        missing = {f"{table.name}_no_{verb.lower()}" for verb in VERBS} - there
        if missing or table.name not in names:
            raise StoreError(f"{where} cannot be upgraded: a step lost what protects the rows of {table.name}")
