"""Who drives a bench: one service at a time, as the database says. Every bench on a database has a lease of its own.

The holder of the lease raises its beat every `BEAT` seconds. Whoever wants to take it over must have seen the same beat
for `EXPIRY` seconds of its own monotonic clock, so that clocks of two machines are never compared; a holder that could
not raise its beat for `GIVE_UP` seconds lets go of the bench before that. Every taking raises the term, and what a
former holder still writes under its old term changes nothing.
"""

import os
import socket
import time
from dataclasses import dataclass
from typing import Any

from sqlalchemy import ColumnElement, Row, insert, select, update

from goniometer.storage.database import Database
from goniometer.storage.records import now
from goniometer.storage.service_tables import lease as table

BEAT = 2.0
"""Seconds between two signs of life."""
GIVE_UP = 15.0
"""Seconds without a beat after which the holder stops the bench and lets go."""
EXPIRY = 30.0
"""Seconds without a beat after which another service may take over."""


@dataclass(frozen=True)
class Lease:
    """Who drives, as it was read."""

    term: int
    beat: int
    holder: str | None
    """None where nobody does."""
    host: str
    process: int
    url: str
    """Where the service of the holder answers."""
    taken: str
    """ISO 8601, UTC."""
    stop: bool
    """Whether another service passes on that somebody pressed stop."""

    def __str__(self) -> str:
        """The holder in words."""
        return f"the service at {self.url} (process {self.process} on {self.host}, since {self.taken})"


def read_lease(database: Database) -> Lease | None:
    """The lease; None where nobody ever drove."""
    rows = database.rows(select(table).where(_of(database)))
    return _lease(rows[0]) if rows else None


def take_lease(database: Database, holder: str, url: str, over: Lease | None) -> Lease | None:
    """The lease for `holder`, where it is free or still is what was read as `over`; None where somebody was faster."""
    mine = {
        "holder": holder,
        "host": socket.gethostname(),
        "process": os.getpid(),
        "url": url,
        "taken": now(),
        "stop": False,
        "beat": 0,
    }
    with database.alone() as connection:
        row = connection.execute(select(table).where(_of(database))).first()
        if row is None:
            connection.execute(insert(table).values(bench=database.bench, term=1, **mine))
        elif row.holder is None or (over is not None and (row.term, row.beat) == (over.term, over.beat)):
            connection.execute(update(table).where(_of(database)).values(term=row.term + 1, **mine))
        else:
            return None
        return _lease(connection.execute(select(table).where(_of(database))).one())


def renew_lease(database: Database, lease: Lease) -> Lease | None:
    """The lease with its next beat; None where another has taken it."""
    mine = _of(database) & (table.c.term == lease.term) & (table.c.holder == lease.holder)
    with database.alone() as connection:
        if connection.execute(update(table).where(mine).values(beat=table.c.beat + 1)).rowcount == 0:
            return None
        return _lease(connection.execute(select(table).where(_of(database))).one())


def release_lease(database: Database, lease: Lease) -> None:
    """Let go, so that others need not wait; harmless where another has taken it."""
    mine = _of(database) & (table.c.term == lease.term) & (table.c.holder == lease.holder)
    with database.writing() as connection:
        connection.execute(update(table).where(mine).values(holder=None, stop=False))


def pass_on_stop(database: Database) -> None:
    """Tell whoever drives this bench that somebody pressed stop."""
    with database.writing() as connection:
        connection.execute(update(table).where(_of(database)).values(stop=True))


def take_up_stop(database: Database, lease: Lease) -> bool:
    """Whether somebody pressed stop elsewhere since this was asked before."""
    if not database.rows(select(table.c.id).where(_of(database), table.c.stop, table.c.term == lease.term)):
        return False
    with database.writing() as connection:
        connection.execute(update(table).where(_of(database)).values(stop=False))
    return True


class Watcher:
    """Sees by its own clock for how long a lease has shown no sign of life."""

    def __init__(self) -> None:
        self._seen: tuple[int, int] | None = None
        self._since = 0.0

    def silent_for(self, lease: Lease) -> float:
        """Seconds since the beat of `lease` was seen to change."""
        beat = lease.term, lease.beat
        if beat != self._seen:
            self._seen, self._since = beat, time.monotonic()
        return time.monotonic() - self._since


def _of(database: Database) -> ColumnElement[bool]:
    return table.c.bench == database.bench


def _lease(row: Row[Any]) -> Lease:
    return Lease(row.term, row.beat, row.holder, row.host, row.process, row.url, row.taken, row.stop)
