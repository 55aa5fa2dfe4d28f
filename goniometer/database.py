"""How the database is opened, locked, read and written, whatever is in it."""

import errno
import os
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Self

from filelock import FileLock, Timeout
from sqlalchemy import Connection, Engine, Row, Select, Table, create_engine, event, insert, update
from sqlalchemy.engine import URL, make_url
from sqlalchemy.exc import ArgumentError, DBAPIError, IntegrityError

import goniometer.service_tables  # noqa: F401  (its tables are made with all others)
from goniometer import tables
from goniometer.errors import NotInStore, StoreBusy, StoreError, StoreFull


class Database:
    """An open database; `Database.open` makes one."""

    def __init__(self, engine: Engine, where: str, file: Path | None) -> None:
        self._engine = engine
        self.where = where
        """What messages call it; no password is in it."""
        self.file = file
        """Of an SQLite database that is not in memory only."""

    @classmethod
    def open(cls, where: Path | str) -> Self:
        """Open the SQLite file or SQLAlchemy URL `where`, creating the tables when there are none.

        Raises `StoreError` where it cannot be opened or is not ours, `StoreOutdated` where an older version of this
        program made it, `StoreFull` where there is no room.
        """
        database = cls._reach(where)
        with database.faults():
            tables.prepare(database._engine, database.where)
        return database

    @classmethod
    def as_it_is(cls, where: Path | str) -> Self:
        """Open a database that is there, whichever version of this program made it; nothing in it is changed.

        Raises `StoreError` where it cannot be opened or is not ours.
        """
        database = cls._reach(where)
        if database.file is not None and not database.file.exists():
            raise NotInStore(f"There is no database {database.where}; name one that is there")
        with database.reading() as connection:
            tables.check_ours(connection, database.where)
        return database

    @classmethod
    def _reach(cls, where: Path | str) -> Self:
        url = _url(where)
        file = None
        shown = url.render_as_string(hide_password=True)
        if url.get_backend_name() == "sqlite" and url.database not in {None, "", ":memory:"}:
            shown = str(url.database)
            file = Path(os.path.realpath(shown))  # one file has one lock, whichever link leads to it
            url = url.set(database=str(file))
        if file and not file.parent.is_dir():
            raise StoreError(f"{shown} cannot be created: the folder {file.parent} does not exist; create it first")
        engine = create_engine(url)
        if file:
            event.listen(engine, "connect", _configure_sqlite)
        return cls(engine, shown, file)

    def close(self) -> None:
        """Let go of the database."""
        self._engine.dispose()

    @contextmanager
    def exclusive(self) -> Iterator[None]:
        """Be the only process that runs a campaign on this database; the lock ends with the process, however it ends.

        Raises `StoreBusy` when another process holds it.
        """
        if self.file is None:
            raise StoreError(f"{self.where} cannot be locked; only an SQLite file can be run on so far")
        lock = FileLock(self.file.with_name(self.file.name + ".lock"))
        with self.faults():
            try:
                lock.acquire(timeout=0)
            except Timeout:
                raise StoreBusy(
                    f"{self.where} is in use by another run, or by a service; wait for its end, abort it, "
                    f"queue the campaign there, or name another file"
                ) from None
        try:
            yield
        finally:
            lock.release()

    def in_use(self) -> bool:
        """Whether some process holds `exclusive` now."""
        try:
            with self.exclusive():
                return False
        except StoreBusy:
            return True

    @contextmanager
    def faults(self) -> Iterator[None]:
        """Turn what the database or the disk refuses into this floor's errors."""
        try:
            yield
        except IntegrityError as error:
            raise StoreError(f"{self.where} refuses contradictory data: {error.orig}") from error
        except (DBAPIError, sqlite3.Error) as error:
            message = str(error.orig if isinstance(error, DBAPIError) else error)
            if "full" in message:
                raise StoreFull(f"{self.where} cannot grow: there is no room left; make room and resume") from error
            if "not a database" in message:
                raise StoreError(f"{self.where} is not a database; name a new file or one of this program") from error
            raise StoreError(f"{self.where} cannot be used: {message}") from error
        except OSError as error:
            if error.errno == errno.ENOSPC:
                raise StoreFull(f"{self.where} cannot grow: there is no room left; make room and resume") from error
            raise StoreError(f"{self.where} cannot be used: {error.strerror or error}") from error

    @contextmanager
    def writing(self) -> Iterator[Connection]:
        """A transaction that is on the disk when the block ends, or has not happened."""
        with self.faults(), self._engine.begin() as connection:
            yield connection

    @contextmanager
    def alone(self, *, references_checked: bool = True) -> Iterator[Connection]:
        """Like `writing`, and nobody else writes between what is read in the block and its end; others wait.

        Without `references_checked`, SQLite lets rows refer to what is not there: who writes tables anew checks it.
        """
        # Python's driver would begin with the first change, after what was read; so it is told to keep out of it.
        with self.faults(), self._engine.connect().execution_options(isolation_level="AUTOCOMMIT") as connection:
            sqlite = connection.dialect.name == "sqlite"
            if sqlite and not references_checked:
                connection.exec_driver_sql("PRAGMA foreign_keys=OFF")
            connection.exec_driver_sql("BEGIN IMMEDIATE" if sqlite else "BEGIN ISOLATION LEVEL SERIALIZABLE")
            try:
                yield connection
            except BaseException:
                connection.exec_driver_sql("ROLLBACK")
                raise
            else:
                connection.exec_driver_sql("COMMIT")
            finally:
                if sqlite:
                    connection.exec_driver_sql("PRAGMA foreign_keys=ON")

    @contextmanager
    def reading(self) -> Iterator[Connection]:
        """A connection to read from."""
        with self.faults(), self._engine.connect() as connection:
            yield connection

    def rows(self, query: Select[Any], values: Mapping[str, object] | None = None) -> Sequence[Row[Any]]:
        """What a query finds, with `values` for its parameters."""
        with self.reading() as connection:
            return connection.execute(query, values).all()

    def row(self, query: Select[Any], what: str) -> Row[Any]:
        """The first that a query finds; raises `NotInStore`, in which `what` was looked for."""
        rows = self.rows(query)
        if not rows:
            raise NotInStore(f"There is no {what} in {self.where}; list what there is with the status command")
        return rows[0]

    def _update(self, table: Table, row_id: int, **values: object) -> None:
        with self.writing() as connection:
            connection.execute(update(table).where(table.c.id == row_id).values(**values))


def _url(where: Path | str) -> URL:
    if isinstance(where, str) and "://" in where:
        try:
            return make_url(where)
        except ArgumentError:
            raise StoreError(f'"{where}" is not the address of a database; give a file or sqlite:///file') from None
    return URL.create("sqlite", database=str(where))


def _configure_sqlite(connection: Any, _: object) -> None:
    """Keep what is committed through a power cut, let others read meanwhile, and check references."""
    cursor = connection.cursor()
    for pragma in ("busy_timeout=10000", "journal_mode=WAL", "synchronous=FULL", "foreign_keys=ON"):
        cursor.execute(f"PRAGMA {pragma}")
    cursor.close()


def insert_row(connection: Connection, table: Table, **values: object) -> int:
    """Add a row to a table that numbers its rows, and return its number."""
    key = connection.execute(insert(table).values(**values)).inserted_primary_key
    assert key is not None  # every table but "about" numbers its rows
    return int(key[0])
