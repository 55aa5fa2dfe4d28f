"""How the database is opened, locked, read and written, whatever is in it."""

import errno
import glob
import os
import re
import sqlite3
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, Self

from filelock import FileLock, Timeout
from sqlalchemy import Connection, Engine, Row, Select, Table, create_engine, event, insert, text, update
from sqlalchemy.engine import URL, make_url
from sqlalchemy.exc import ArgumentError, DBAPIError, IntegrityError

import goniometer.storage.service_tables  # noqa: F401  (its tables are made with all others)
from goniometer.errors import InputError, NotInStore, StoreBusy, StoreError, StoreFull
from goniometer.storage import postgresql, tables
from goniometer.storage.filesystem import served_by

_WRITE, _RUN = postgresql.key("write"), postgresql.key("run")
"""Locks of a PostgreSQL database; every run shares the second one, and has one of its bench for itself."""
_BENCH_NAME = re.compile(r"[a-z0-9][a-z0-9-]{0,31}")

_NO_ROOM = "cannot grow: there is no room left; make room and resume"
_DAMAGED = "is damaged; bring back a backup with goniometer db restore"
_REFUSALS: tuple[tuple[str, type[StoreError], str], ...] = (
    ("full", StoreFull, _NO_ROOM),
    ("not a database", StoreError, "is not a database; name a new file or one of this program"),
    ("malformed", StoreError, _DAMAGED),
    ("Could not decode", StoreError, _DAMAGED),
    ("unable to open", StoreError, "cannot be made or opened; name a file in a folder where this account may write"),
    ("readonly", StoreError, "cannot be written by this account; give it the right to write the file and its folder"),
    ("locked", StoreBusy, "is locked by another program; close what has it open, and run the command again"),
    ("disk I/O", StoreError, "cannot be read or written: the disk refuses; see to the disk and its quota, and resume"),
)
"""What SQLite says, which error that is, and what is told of it."""

BUSY = 10
"""Seconds that is waited for another process that writes an SQLite file."""

_LOOKED_AT = 0.05
"""Seconds that is waited for who only looks whether an SQLite file is in use, and locks it for that moment."""

CONNECTIONS = 40
"""To a file, that are kept open once they were needed."""


class Database:
    """An open database; `Database.open` makes one."""

    def __init__(self, engine: Engine, where: str, file: Path | None, bench: str) -> None:
        self._engine = engine
        # a server would be asked to begin and to end a transaction around each question
        self._asking = engine.execution_options(isolation_level="AUTOCOMMIT") if self._postgresql else engine
        self.bench = bench
        """The bench that is run through this handle; what was measured on any is seen."""
        self.where = where
        """What messages call it; no password is in it."""
        self.file = file
        """Of an SQLite database that is not in memory only."""
        self._keeper: int | None = None
        """The process of the server that keeps `exclusive` for this one; None where there is none."""
        self._watching: sqlite3.Connection | None = None

    @classmethod
    def open(cls, where: Path | str, bench: str = tables.BENCH) -> Self:
        """Open the SQLite file or the URL `where`, of SQLite or PostgreSQL, creating the tables when there are none.

        `bench` is the one that is to be run. Raises `StoreError` where it cannot be opened or is not ours,
        `StoreOutdated` where an older version of this program made it, `StoreFull` where there is no room, and
        `InputError` for what cannot be the name of a bench.
        """
        if not _BENCH_NAME.fullmatch(bench):
            told = "take up to 32 lower-case letters, digits and hyphens, no hyphen first"
            raise InputError(f'"{bench[:64]}" cannot be the name of a bench; {told}')
        database = cls.at(where, bench)
        with database.faults():
            tables.prepare(database._engine, database.where)
        return database

    @classmethod
    def as_it_is(cls, where: Path | str) -> Self:
        """Open a database that is there, whichever version of this program made it; nothing in it is changed.

        Raises `StoreError` where it cannot be opened or is not ours.
        """
        database = cls.at(where)
        if database.file is not None and not database.file.exists():
            raise NotInStore(f"There is no database {database.where}; name one that is there")
        with database.reading() as connection:
            tables.check_ours(connection, database.where)
        return database

    @classmethod
    def at(cls, where: Path | str, bench: str = tables.BENCH) -> Self:
        """The database at `where`, which need not be there; it is neither read nor made yet.

        Raises `StoreError` where there can be none.
        """
        url, shown = _url(where), shown_place(where)
        if url.get_backend_name() == "postgresql":
            return cls(postgresql.connected(url), shown, None, bench)
        file = None
        if _is_file(url):
            file = Path(os.path.realpath(shown))  # one file has one lock, whichever link leads to it
            url = url.set(database=str(file))
        if file and not file.parent.is_dir():
            raise StoreError(f"{shown} cannot be created: the folder {file.parent} does not exist; create it first")
        served = None if file is None else served_by(file)
        if served:
            raise StoreError(
                f"{shown} lies on a network file system ({served}), where SQLite cannot keep it whole; "
                f"name a file on a local disk, or a PostgreSQL database"
            )
        # a server asks from as many threads; what is above the size of the pool is opened anew each time
        size = {"pool_size": CONNECTIONS} if file else {}
        engine = create_engine(url, hide_parameters=True, **size)
        if file:
            event.listen(engine, "connect", _configure_sqlite)
        return cls(engine, shown, file, bench)

    def close(self) -> None:
        """Let go of the database."""
        self._engine.dispose()
        if self._watching is not None:
            self._watching.close()
            self._watching = None

    def version(self) -> int | None:
        """A number that is another one after every change, whoever makes it; None where the database tells of none.

        That takes some microseconds and waits for nobody; only one thread may ask.
        """
        if self.file is None:
            return None
        try:
            if self._watching is None:
                where = f"{self.file.as_uri()}?mode=ro"
                self._watching = sqlite3.connect(where, uri=True, timeout=0, check_same_thread=False)
            # it tells of changes by other connections only, and this one changes nothing
            return int(self._watching.execute("PRAGMA data_version").fetchone()[0])
        except sqlite3.DatabaseError:  # somebody has locked it, or it is none any more: who reads it is told
            return None

    @contextmanager
    def exclusive(self, *, everywhere: bool = False) -> Iterator[None]:
        """Be the only process that runs this bench on this database; the lock ends with the process, however it ends.

        `everywhere` keeps all other benches from running as well. Raises `StoreBusy` when another process holds it.
        """
        with ExitStack() as held:
            with self.faults():
                if self._postgresql:
                    wanted = [(_RUN, False)] if everywhere else [(_RUN, True), (_bench_key(self.bench), False)]
                    keeper = held.enter_context(postgresql.session_locks(self._engine, wanted))
                    self._keeper, taken = keeper, keeper is not None
                else:
                    taken = all(_lock_file(lock, held) for lock in self._lock_files(everywhere=everywhere))
            if not taken:
                bench = "" if self.bench == tables.BENCH or everywhere else f", on the bench {self.bench}"
                raise StoreBusy(
                    f"{self.where} is in use by another run, or by a service{bench}; wait for its end, abort it, "
                    f"queue the campaign there, or name another database"
                )
            try:
                yield
            finally:
                self._keeper = None

    def _lock_files(self, *, everywhere: bool) -> list[Path]:
        if self.file is None:
            raise StoreError(f"{self.where} cannot be locked; name an SQLite file, or a PostgreSQL database")
        own = _lock_of(self.file, self.bench)
        return sorted({own, *self.file.parent.glob(f"{glob.escape(self.file.name)}.lock*")}) if everywhere else [own]

    def in_use(self, bench: str | None = None) -> bool:
        """Whether some process holds `exclusive` now for a bench, which is that of this handle unless it is named."""
        bench = self.bench if bench is None else bench
        if self._postgresql:
            with self.reading() as connection:
                return postgresql.is_held(connection, _bench_key(bench))
        with self.faults(), ExitStack() as held:
            return self.file is not None and not _lock_file(_lock_of(self.file, bench), held)

    def clock(self) -> float:
        """Seconds since 1970 on the clock that all who use this database have in common."""
        if not self._postgresql:
            return time.time()
        with self.reading() as connection:
            return float(connection.execute(text("SELECT extract(epoch FROM clock_timestamp())")).scalar_one())

    @property
    def _postgresql(self) -> bool:
        return self._engine.dialect.name == "postgresql"

    @contextmanager
    def faults(self) -> Iterator[None]:
        """Turn what the database or the disk refuses into a `StoreError`, e.g. `StoreBusy` or `StoreFull`."""
        try:
            yield
        except IntegrityError as error:
            told = str(error.orig).splitlines()[0]
            raise StoreError(f"{self.where} refuses contradictory data: {told}") from error
        except (DBAPIError, sqlite3.Error) as error:
            if self._postgresql and isinstance(error, DBAPIError):
                raise postgresql.refusal(error, self.where) from error
            message = str(error.orig if isinstance(error, DBAPIError) else error)
            for part, kind, words in _REFUSALS:
                if part in message:
                    raise kind(f"{self.where} {words}") from error
            raise StoreError(f"{self.where} cannot be used: {message}") from error
        except UnicodeDecodeError as error:  # what tells of a damaged table may itself be no text
            raise StoreError(f"{self.where} {_DAMAGED}") from error
        except OSError as error:
            if error.errno == errno.ENOSPC:
                raise StoreFull(f"{self.where} {_NO_ROOM}") from error
            raise StoreError(f"{self.where} cannot be used: {error.strerror or error}") from error

    @contextmanager
    def writing(self) -> Iterator[Connection]:
        """A transaction that is on the disk when the block ends, or has not happened.

        Raises `StoreError` where `exclusive` was lost, with the connection that held it, to whoever may have it now.
        """
        with self.faults(), self._engine.begin() as connection:
            if self._postgresql:
                self._lock_writing(connection, shared=True)
            yield connection

    @contextmanager
    def alone(self, *, references_checked: bool = True) -> Iterator[Connection]:
        """Like `writing`, and nobody else writes between what is read in the block and its end; others wait.

        Without `references_checked`, SQLite lets rows refer to what is not there: who writes tables anew checks it.
        """
        if self._postgresql:
            with self.faults(), self._engine.begin() as connection:
                # A block cannot be repeated by who wrote it, as serialisable transactions ask for; so others wait.
                self._lock_writing(connection, shared=False)
                yield connection
            return
        # Python's driver would begin with the first change, after what was read; so it is told to keep out of it.
        with self.faults(), self._engine.connect().execution_options(isolation_level="AUTOCOMMIT") as connection:
            if not references_checked:
                connection.exec_driver_sql("PRAGMA foreign_keys=OFF")
            connection.exec_driver_sql("BEGIN IMMEDIATE")
            try:
                yield connection
            except BaseException:
                connection.exec_driver_sql("ROLLBACK")
                raise
            else:
                connection.exec_driver_sql("COMMIT")
            finally:
                connection.exec_driver_sql("PRAGMA foreign_keys=ON")

    def _lock_writing(self, connection: Connection, *, shared: bool) -> None:
        postgresql.lock_transaction(connection, _WRITE, shared=shared)
        if self._keeper is not None and not postgresql.is_held(connection, _RUN, self._keeper):
            raise StoreError(
                f"{self.where} has ended the connection that kept others from running here; see that no other run has "
                f"begun, then run the campaign again"
            )

    @contextmanager
    def reading(self) -> Iterator[Connection]:
        """A connection to read from."""
        with self.faults(), self._engine.connect() as connection:
            yield connection

    def rows(self, query: Select[Any], values: Mapping[str, object] | None = None) -> Sequence[Row[Any]]:
        """What a query finds, with `values` for its parameters."""
        with self.faults(), self._asking.connect() as connection:
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


def shown_place(where: Path | str) -> str:
    """What people call the database at `where`, without any password; raises `StoreError` for what is no address."""
    url = _url(where)
    return str(url.database) if _is_file(url) else postgresql.shown(url)


def _is_file(url: URL) -> bool:
    return url.get_backend_name() == "sqlite"


def _bench_key(bench: str) -> int:
    return postgresql.key(f"run {bench}")


def _lock_of(file: Path, bench: str) -> Path:
    return file.with_name(f"{file.name}.lock" + ("" if bench == tables.BENCH else f"-{bench}"))


def _lock_file(lock_file: Path, held: ExitStack) -> bool:
    """Lock a file until `held` ends, unless another process has it for longer than to look at it."""
    lock = FileLock(lock_file)
    try:
        lock.acquire(timeout=_LOOKED_AT, poll_interval=_LOOKED_AT / 10)
    except Timeout:
        return False
    held.callback(lock.release)
    return True


def _url(where: Path | str) -> URL:
    is_address = isinstance(where, str) and "://" in where
    url = _address(str(where)) if is_address else URL.create("sqlite", database=str(where))
    if url.get_backend_name() == "sqlite" and url.database in {None, "", ":memory:"}:
        # SQLite takes these, and forgets with the process what was kept there
        raise StoreError(f'"{where}" is not the name of a database; give a file, or an address')
    return url


def _address(where: str) -> URL:
    try:
        url = make_url(where)
    except (ArgumentError, ValueError):  # the latter for a port that is no number
        url = None
    kind = None if url is None else url.drivername.partition("+")[0]
    if url is None or kind not in {"sqlite", "postgresql", "postgres"}:
        told = re.sub("(?<=://).*@", "***@", where)  # there may be a password
        raise StoreError(
            f'"{told}" is not the address of a database; give a file, sqlite:///file, or postgresql://user@host/name'
        )
    return url.set(drivername="postgresql") if kind == "postgres" else url


def _configure_sqlite(connection: Any, _: object) -> None:
    """Keep what is committed through a power cut, let others read meanwhile, and check references."""
    cursor = connection.cursor()
    end = time.monotonic() + BUSY

    def ask(pragma: str) -> Any:
        while True:
            try:
                return cursor.execute(f"PRAGMA {pragma}").fetchone()
            except sqlite3.OperationalError as error:
                # of several that open a new file at once, SQLite lets none wait for who changes its journal
                if error.sqlite_errorcode != sqlite3.SQLITE_BUSY or time.monotonic() > end:
                    raise
                time.sleep(0.01)

    if ask("page_count") == (0,):  # in a file that has something this would change nothing, but wait for who writes
        ask("auto_vacuum=INCREMENTAL")  # the room that an archive leaves can be given back to the disk
    for setting in (f"busy_timeout={1000 * BUSY}", "journal_mode=WAL", "synchronous=FULL", "foreign_keys=ON"):
        ask(setting)
    cursor.close()


def insert_row(connection: Connection, table: Table, **values: object) -> int:
    """Add a row to a table that numbers its rows, and return its number."""
    key = connection.execute(insert(table).values(**values)).inserted_primary_key
    assert key is not None  # every table but "about" numbers its rows
    return int(key[0])
