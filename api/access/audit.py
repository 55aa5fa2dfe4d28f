"""The log of who did what: rows that are only ever added, each sealed with the hash of the one before it.

The hash of a row is the SHA-256 of the canonical JSON of all its other columns: keys in alphabetical order, no spaces,
in ASCII; `about` is the text that the row holds. So nobody can change, remove or insert a row without every later hash
being wrong; only rows at the end can be cut off unnoticed, and not from who has noted the last hash before.
"""

import hashlib
import json
import logging
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

from sqlalchemy import Connection, Row, insert, select, text

from api.bodies.access import Via
from goniometer.errors import StoreError
from goniometer.storage.database import Database
from goniometer.storage.records import now
from goniometer.storage.service_tables import log as table

FIRST = "0" * 64
"""What the first row has for the hash of the one before it."""
_SECRET = ("password", "token", "secret")
log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Entry:
    """One row of the log."""

    sequence: int
    """Counted from 1 without gaps."""
    time: str
    """ISO 8601, UTC."""
    who: str
    """Name of a user, of an account of the machine where `via` is "cli", or of a part of the service."""
    via: Via
    action: str
    about: str
    """What with and with which outcome, as JSON."""
    previous: str
    hash: str


@dataclass(frozen=True)
class Verdict:
    """Whether the log is as it was written."""

    rows: int
    head: str
    """Hash of the last row; who notes it elsewhere can tell later that nothing before it was cut off or rewritten."""
    fault: str | None
    """The first thing that is wrong, as a sentence; None where nothing is."""


def record(database: Database, who: str, action: str, about: Mapping[str, Any], via: Via = "service") -> Entry:
    """Add a row, which is on the disk when this returns; values of keys such as "password" are left out of `about`."""
    told = _canonical(without_secrets(about))
    with database.alone() as connection:
        last = connection.execute(select(table).order_by(table.c.sequence.desc()).limit(1)).first()
        sequence, previous = (1, FIRST) if last is None else (last.sequence + 1, last.hash)
        unsealed = Entry(sequence, now(), who, via, action, told, previous, "")
        entry = replace(unsealed, hash=sealed(asdict(unsealed)))
        connection.execute(insert(table).values(**asdict(entry)))
    # The journal of the machine thus keeps the hashes where who can write the database may be unable to.
    log.info("Log row %s has the hash %s", sequence, entry.hash)
    return entry


def record_done(database: Database, who: str, action: str, about: Mapping[str, Any], via: Via = "service") -> None:
    """Like `record`, of what nothing can undo: where no row can be added, the journal of the machine tells of it."""
    try:
        record(database, who, action, about, via)
    except StoreError:
        log.exception("What %s did is not in the log: %s %s", who, action, _canonical(without_secrets(about)))


def sealed(row: Mapping[str, Any]) -> str:
    """The hash of a row from its other columns."""
    return hashlib.sha256(_canonical({key: row[key] for key in row if key != "hash"}).encode()).hexdigest()


def entries(database: Database, before: int | None = None, limit: int = 50) -> list[Entry]:
    """The newest rows (of those before a number), newest first."""
    query = select(table).order_by(table.c.sequence.desc()).limit(limit)
    return [_entry(row) for row in database.rows(query if before is None else query.where(table.c.sequence < before))]


def head(database: Database) -> str:
    """Hash of the last row."""
    last = entries(database, limit=1)
    return last[0].hash if last else FIRST


def verify(database: Database, known_head: str | None = None) -> Verdict:
    """Compute every hash anew; `known_head` is a hash that was the last one once, and must still be among them."""
    previous, rows, fault, met = FIRST, 0, None, known_head in {None, FIRST}
    with database.reading() as connection:
        for row in connection.execution_options(yield_per=1000).execute(select(table).order_by(table.c.sequence)):
            rows += 1
            fault = fault or _fault(row, rows, previous)
            previous = row.hash
            met = met or row.hash == known_head
        fault = fault or _cut(connection, rows)
    if fault is None and not met:
        fault = f"No row has the hash {known_head}, which was the last one once: rows were cut off or rewritten"
    return Verdict(rows, previous, fault)


def _fault(row: Row[Any], number: int, previous: str) -> str | None:
    if row.sequence != number:
        return f"Row {number} of the log is missing"
    if row.previous != previous:
        return f"Row {number} of the log does not follow the row before it: one of them was replaced"
    if row.hash != sealed(asdict(_entry(row))):
        return f"Row {number} of the log was changed after it was written"
    return None


def _cut(connection: Connection, rows: int) -> str | None:
    """SQLite remembers the highest number there ever was, for who cuts off rows and does not know that."""
    if connection.dialect.name != "sqlite":
        return None
    ever = connection.execute(text("SELECT seq FROM sqlite_sequence WHERE name = :name"), {"name": table.name}).scalar()
    return f"Rows {rows + 1} to {ever} of the log were cut off" if (ever or 0) > rows else None


def without_secrets(value: Any) -> Any:
    """The same as JSON can hold it, with "***" for the values of keys that name a secret."""
    if isinstance(value, Mapping):
        return {
            key: "***" if any(part in str(key).lower() for part in _SECRET) else without_secrets(each)
            for key, each in value.items()
        }
    if isinstance(value, list | tuple):
        return [without_secrets(each) for each in value]
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)  # JSON has no such number
    return value


def _canonical(value: Mapping[str, Any]) -> str:
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False, default=str)


def _entry(row: Row[Any]) -> Entry:
    return Entry(**row._mapping)
