"""A second copy of an SQLite database, whole and checked, made while others go on writing."""

import os
import sqlite3
from contextlib import closing
from pathlib import Path

from goniometer.database import Database
from goniometer.errors import StoreError
from goniometer.integrity import damage


def file_of(database: Database) -> Path:
    """The file of an SQLite database; raises `StoreError` where it is another, which has tools of its own."""
    if database.file is None:
        raise StoreError(
            f"{database.where} is not an SQLite file; copy it with pg_dump, and bring it back with pg_restore"
        )
    return database.file


def back_up(database: Database, target: Path) -> None:
    """Write all that is committed to the file `target`, which is there whole or not at all, however this ends.

    Raises `StoreError` where there is such a file, or where the copy is damaged as its original then is.
    """
    source_file = file_of(database)
    if target.exists():
        raise StoreError(f"{target} is there already; name a file that is not")
    part = target.with_name(target.name + ".part")
    with database.faults():
        part.unlink(missing_ok=True)
        try:
            with closing(sqlite3.connect(source_file, timeout=10)) as source, closing(sqlite3.connect(part)) as copy:
                source.backup(copy)  # in one step, so that who writes meanwhile does not make it begin again
                copy.execute("PRAGMA journal_mode=DELETE")  # so that it is one file
                faults = list(damage(copy))
            if faults:
                raise StoreError(f"{database.where} cannot be backed up, for it is damaged: {faults[0]}")
            flush(part)
            os.rename(part, target)
            flush(target.parent)
        finally:
            part.unlink(missing_ok=True)


def flush(path: Path) -> None:
    """Return when a file, or the names in a folder, are on the disk."""
    number = os.open(path, os.O_RDONLY)
    try:
        os.fsync(number)
    finally:
        os.close(number)
