"""A second copy of an SQLite database, whole and checked, made while others go on writing; and the way back."""

import errno
import os
import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from datetime import UTC, datetime
from pathlib import Path

from sqlalchemy import create_engine, inspect, select
from sqlalchemy.pool import NullPool

from goniometer.errors import NotInStore, RawDamaged, StoreBusy, StoreError, StoreFull
from goniometer.storage import tables
from goniometer.storage.database import Database
from goniometer.storage.records import HASHED, exposure_hash
from goniometer.upkeep.integrity import damage, kept_inside

_PATIENCE = 10.0
"""Seconds that others may keep the database locked."""

_NO_ROOM = "cannot be made: there is no room left; make room there, or name a file in another folder"


def back_up(database: Database, target: Path) -> None:
    """Write all that is committed to the file `target`, which is there whole or not at all, however this ends.

    Raises `StoreError` where there is such a file or none can be, where the original is damaged, or is no SQLite file.
    """
    if os.path.exists(target):  # a folder that may not be looked into is told of below
        raise StoreError(f"{target} is there already; name a file that is not")
    with database.faults(), _copied(_file_of(database), target, database.where) as part:
        os.rename(part, target)


def restore(backup: Path, where: Path | str, *, replace: bool) -> Path | None:
    """Let the database `where` be what the file `backup` holds, once that is seen to be whole.

    Returns where the old one is kept, None where there was none. Raises `NotInStore` where there is no backup,
    `StoreError` where it is damaged or another program's, where there is a database and `replace` is not said, and
    `StoreBusy` while somebody uses it. Whenever this is interrupted, it is the old one or the new one, whole.
    """
    if not backup.is_file():
        raise NotInStore(f"There is no backup {backup}; name a file that goniometer db backup has written")
    place = Database.at(where)
    file = _file_of(place)
    there = file.exists()
    if there and not replace:
        raise StoreError(f"{place.where} is there already; name another file, or say --replace")
    with place.faults(), place.exclusive(everywhere=True), _copied(backup, file, str(backup)) as part:
        kept = None
        if there:
            kept = beside(file, "replaced")
            _settle(file, kept)
            os.link(file, kept)
        os.rename(part, file)
        return kept


def beside(file: Path, what: str) -> Path:
    """A name for a copy of `file` in its folder that no other copy has, however soon the next one is made."""
    return file.with_name(f"{file.name}.{what}-{datetime.now(UTC).strftime('%Y%m%dT%H%M%S.%fZ')}")


def _file_of(database: Database) -> Path:
    """The file of an SQLite database; raises `StoreError` where it is another, which has tools of its own."""
    if database.file is None:
        raise StoreError(
            f"{database.where} is not an SQLite file; copy it with pg_dump, and bring it back with pg_restore"
        )
    return database.file


@contextmanager
def _copied(source: Path, target: Path, called: str) -> Iterator[Path]:
    """A whole copy of an SQLite file beside `target`, on the disk; to be renamed in the block, or else it goes away."""
    part = _begun(target)
    try:
        try:
            _copy(source, part)
        except sqlite3.OperationalError as error:  # no room, no right: which is nobody's damage
            if "full" in str(error):
                raise StoreFull(f"{target} {_NO_ROOM}") from error
            raise
        except sqlite3.DatabaseError as error:
            raise StoreError(f"{called} cannot be copied, for it is not whole: {error}") from error
        _verify(part, called)
        flush(part)
        yield part
        flush(target.parent)
    finally:
        part.unlink(missing_ok=True)


def _begun(target: Path) -> Path:
    """An empty file beside `target`; raises `StoreError` where there can be none, before SQLite blames the original."""
    try:
        part = target.with_name(target.name + ".part")
        part.unlink(missing_ok=True)
        part.touch(0o644)  # as SQLite makes its files
    except (OSError, ValueError) as error:
        if isinstance(error, OSError) and error.errno == errno.ENOSPC:
            raise StoreFull(f"{target} {_NO_ROOM}") from None
        reason = (error.strerror if isinstance(error, OSError) else None) or error
        if isinstance(error, FileNotFoundError) and not os.path.lexists(target.parent):
            reason = f"the folder {target.parent} does not exist"
        raise StoreError(
            f"{target} cannot be made: {reason}; name a file in a folder where this account may write"
        ) from None
    return part


def _copy(source: Path, part: Path) -> None:
    address = f"file:{_escaped(source)}?mode=ro"
    with (
        closing(sqlite3.connect(address, uri=True, timeout=_PATIENCE)) as reading,
        closing(sqlite3.connect(part)) as copy,
    ):
        reading.backup(copy)  # in one step, so that who writes meanwhile does not make it begin again
        copy.execute("PRAGMA journal_mode=DELETE")  # so that it is one file


def _escaped(path: Path) -> str:
    """A path as SQLite reads it in an address."""
    return str(path.absolute()).replace("%", "%25").replace("?", "%3f").replace("#", "%23")


def _verify(part: Path, called: str) -> None:
    """Raise `StoreError` where a copy is not one of a whole database of this program, of whichever version."""
    engine = create_engine(f"sqlite:///{part}", poolclass=NullPool)
    with engine.connect() as connection:
        for fault in damage(connection):
            raise StoreError(f"{called} cannot be copied, for it is not whole: {fault[0].lower()}{fault[1:]}")
        tables.check_ours(connection, called)
        if "sha256" in {column["name"] for column in inspect(connection).get_columns("exposures")}:
            # an older version has not every column of today's
            query = select(*(tables.exposures.c[name] for name in ("id", "sha256", "counts", *HASHED)))
            if inspect(connection).has_table(tables.archives.name):
                query = query.where(kept_inside())
            for row in connection.execute(query.execution_options(yield_per=500)):
                if exposure_hash(row._mapping) != row.sha256:
                    raise RawDamaged(row.id)


def _settle(file: Path, kept: Path) -> None:
    """Have all of a database in its one file; raises `StoreBusy` while somebody has it open.

    What is too damaged for that keeps its journal, under the name that belongs to `kept`.
    """
    try:
        with closing(sqlite3.connect(file, timeout=0)) as connection:
            connection.execute("PRAGMA journal_mode=DELETE")
    except sqlite3.OperationalError as error:
        if "locked" in str(error):
            raise StoreBusy(
                f"{file} is in use; end what has it open, a service or a command, and restore then"
            ) from None
        raise
    except sqlite3.DatabaseError:
        journal = file.with_name(file.name + "-wal")
        if journal.exists():
            os.rename(journal, kept.with_name(kept.name + "-wal"))
        file.with_name(file.name + "-shm").unlink(missing_ok=True)


def flush(path: Path) -> None:
    """Return when a file, or the names in a folder, are on the disk."""
    number = os.open(path, os.O_RDONLY)
    try:
        os.fsync(number)
    finally:
        os.close(number)
