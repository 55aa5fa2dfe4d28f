"""What PostgreSQL has of its own: connections that may be lost, locks that end with them, and its refusals in words.

A lock is an advisory one, so it is bound to one database of the server, and to a session or a transaction: whatever
ends the process that holds it, also the loss of its machine or of the network, ends the lock. The server must be
reached directly, or through a pool that leaves a session its connection.
"""

import hashlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Any

from sqlalchemy import Connection, Engine, create_engine, event, text
from sqlalchemy.engine import URL
from sqlalchemy.exc import DBAPIError

from goniometer.errors import StoreError, StoreFull

_PATIENCE = {
    "application_name": "goniometer",
    "connect_timeout": "10",
    "keepalives_idle": "10",
    "keepalives_interval": "5",
    "keepalives_count": "3",
    "tcp_user_timeout": "25000",
}
"""What is asked of a connection unless its address says otherwise: seconds, but for the last one, milliseconds."""

_SESSION = (
    "SET lock_timeout = '10s'",  # as long as an SQLite file is waited for
    # a server that is not told so holds the locks of a machine that lost its power for two hours
    "SET tcp_keepalives_idle = 10",
    "SET tcp_keepalives_interval = 5",
    "SET tcp_keepalives_count = 3",
)

_SECRETS = {"password", "sslpassword"}

_HELD = (
    "SELECT count(*) FROM pg_locks WHERE locktype = 'advisory' AND granted AND objsubid = 1 "
    "AND database = (SELECT oid FROM pg_database WHERE datname = current_database()) "
    "AND (classid::bigint << 32 | objid::bigint) = :key"
)


def connected(url: URL) -> Engine:
    """An engine for the PostgreSQL database `url`; raises `StoreError` where the driver is not installed."""
    unsaid = {name: value for name, value in _PATIENCE.items() if name not in url.query}
    try:
        # A connection that was lost while nobody used it is replaced, and not found out by who needs it.
        engine = create_engine(
            url.set(drivername="postgresql+psycopg").update_query_dict(unsaid),
            pool_pre_ping=True,
            hide_parameters=True,
        )
    except ModuleNotFoundError:
        raise StoreError(f"{shown(url)} needs the package psycopg; install goniometer[scale]") from None
    event.listen(engine, "connect", _configure)
    return engine


def _configure(connection: Any, _: object) -> None:
    connection.autocommit = True
    for setting in _SESSION:
        connection.execute(setting)
    connection.autocommit = False


def shown(url: URL) -> str:
    """An address without its passwords."""
    return url.difference_update_query(_SECRETS).render_as_string(hide_password=True)


def key(what: str) -> int:
    """The number of a lock, of 63 bits."""
    return int.from_bytes(hashlib.sha256(f"goniometer: {what}".encode()).digest()[:8]) >> 1


@contextmanager
def session_locks(engine: Engine, numbers: Sequence[tuple[int, bool]]) -> Iterator[int | None]:
    """Hold locks by a connection of their own; with each stands whether it is shared with who shares it, too.

    Yields the process of the server that keeps them, None where one of them is held by somebody else.
    """
    with engine.connect().execution_options(isolation_level="AUTOCOMMIT") as connection:
        connection.detach()  # it is closed in the end, and with it the locks, and never lent to anybody else
        taken = all(
            connection.execute(text(f"SELECT pg_try_advisory_lock{'_shared' if shared else ''}(:key)"), {"key": number})
            .scalars()
            .one()
            for number, shared in numbers
        )
        try:
            yield int(connection.execute(text("SELECT pg_backend_pid()")).scalar_one()) if taken else None
        finally:
            with suppress(DBAPIError):  # the connection was lost, and with it the locks
                connection.execute(text("SELECT pg_advisory_unlock_all()"))


def is_held(connection: Connection, number: int, process: int | None = None) -> bool:
    """Whether anybody holds a lock, or the `process` of the server that `session_locks` told."""
    by = "" if process is None else " AND pid = :process"
    return bool(connection.execute(text(_HELD + by), {"key": number, "process": process}).scalar_one())


def lock_transaction(connection: Connection, number: int, *, shared: bool) -> None:
    """Wait for a lock that ends with the transaction; those that are `shared` keep only the others out."""
    name = "pg_advisory_xact_lock_shared" if shared else "pg_advisory_xact_lock"
    connection.execute(text(f"SELECT {name}(:key)"), {"key": number})


def refusal(error: DBAPIError, where: str) -> StoreError:
    """What the server or the way to it refuses, in one sentence; `where` names the database."""
    told = str(error.orig).strip().splitlines()[0]
    state = getattr(error.orig, "sqlstate", None)
    if state == "53100":
        return StoreFull(f"{where} cannot grow: there is no room left on its server; make room and resume")
    if error.connection_invalidated or state is None or state[:2] == "08" or state[:3] == "57P":
        return StoreError(
            f"{where} cannot be reached: {told}; see that the server runs and lets you in, then do it again"
        )
    if state in {"55P03", "40P01"}:
        return StoreError(f"{where} is kept locked by somebody else: {told}; try again when that has ended")
    if state == "25006":
        return StoreError(f"{where} can only be read; name the server that takes changes")
    if state == "42501":
        return StoreError(f"{where} does not allow this: {told}; have its owner grant it, or name another user")
    return StoreError(f"{where} cannot be used: {told}")
