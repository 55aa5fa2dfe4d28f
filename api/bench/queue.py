"""What the bench shall measure, in which order: entries of the database that survive whatever ends the service.

    idle ── start ──> queued ── its turn, its time ──> running ──> finished (completed, aborted or failed: why)
      ^                  │                                │            │
      └── stop, restart ─┴────────────────────────────────┘            │ start: it goes on where it stood
                         ^─────────────────────────────────────────────┘ (unless it is completed)

Nothing moves after a restart or a stop before somebody has looked: whatever was queued or running is idle then, with
the reason. Every bench has a queue of its own; a handle of the database sees that of its bench.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any, Literal

from sqlalchemy import ColumnElement, Connection, Row, delete, func, select, update

from api.errors import Conflict
from goniometer.campaigns.campaign import Campaign
from goniometer.errors import NotInStore
from goniometer.states import Outcome
from goniometer.storage.database import Database, insert_row
from goniometer.storage.records import Scan, now
from goniometer.storage.service_tables import queue as table
from goniometer.storage.store import Store

EntryPhase = Literal["idle", "queued", "running", "finished"]

FITS_ABORTED = "Its fits were aborted; what was measured is kept, and starting it again makes them."


@dataclass(frozen=True)
class Entry:
    """A campaign in the queue."""

    id: int
    position: int
    """Place in the queue, counted from 1; finished entries have none, and 0."""
    name: str
    """Of the campaign."""
    json: str
    """The campaign as it was ordered, see `campaign`."""
    campaign_id: int | None
    """In the database; None until it was begun."""
    phase: EntryPhase
    outcome: Outcome | None
    """How it ended; None while it has not."""
    reason: str
    """Why it ended so, or why it is idle again; a sentence, or empty."""
    who: str
    """Who ordered it."""
    start_after: str | None
    """ISO 8601 in UTC before which it does not begin; None for no such moment."""
    created: str
    ordered: str | None
    """When somebody started it last; None while nobody did."""
    started: str | None
    """When it ran first."""
    finished: str | None
    bench: str
    """Which is to measure it."""

    @property
    def campaign(self) -> Campaign:
        """What is to be measured."""
        return Campaign.model_validate_json(self.json)


def entries(database: Database) -> list[Entry]:
    """All that is not finished, in its order."""
    query = select(table).where(_of(database), table.c.phase != "finished").order_by(table.c.position)
    return [_entry(row) for row in database.rows(query)]


def finished_entries(database: Database, before: int | None, limit: int) -> list[Entry]:
    """The newest `limit` finished entries with ids below `before`, newest first."""
    query = select(table).where(_of(database), table.c.phase == "finished").order_by(table.c.id.desc()).limit(limit)
    if before is not None:
        query = query.where(table.c.id < before)
    return [_entry(row) for row in database.rows(query)]


def entry(database: Database, entry_id: int) -> Entry:
    """One entry; raises `NotInStore`."""
    with database.reading() as connection:
        return _one(database, connection, entry_id)


def add_entry(database: Database, campaign: Campaign, who: str, start_after: datetime | None = None) -> Entry:
    """Append a campaign; one with a moment to begin at is started, and waits for it.

    Raises `Conflict` where a campaign of this name is in the queue of any bench.
    """
    with database.alone() as connection:
        same = table.c.name == campaign.name, table.c.phase != "finished"
        known = connection.execute(select(table.c.id, table.c.bench).where(*same)).first()
        if known is not None:
            elsewhere = "" if known.bench == database.bench else f" of the bench {known.bench}"
            raise Conflict(
                f'The campaign "{campaign.name}" is in the queue{elsewhere} as entry {known.id}; remove that, or give '
                f"this one another name"
            )
        added = insert_row(
            connection,
            table,
            bench=database.bench,
            position=_last(database, connection) + 1,
            name=campaign.name,
            json=campaign.canonical_json,
            phase="idle" if start_after is None else "queued",
            who=who,
            start_after=None if start_after is None else start_after.astimezone(UTC).isoformat(timespec="milliseconds"),
            created=now(),
            ordered=None if start_after is None else now(),
        )
        return _one(database, connection, added)


def move_entry(database: Database, entry_id: int, position: int) -> Entry:
    """Put an entry at a place, counted from 1; others make room. Raises `NotInStore` and `Conflict`."""
    with database.alone() as connection:
        moved = _one(database, connection, entry_id)
        if moved.phase == "finished":
            raise Conflict(f"Entry {entry_id} is finished and has no place in the queue any more; start it again first")
        order = list(
            connection.execute(
                select(table.c.id).where(_of(database), table.c.phase != "finished").order_by(table.c.position)
            )
            .scalars()
            .all()
        )
        order.remove(entry_id)
        order.insert(min(position, len(order) + 1) - 1, entry_id)
        for place, each in enumerate(order, start=1):
            connection.execute(update(table).where(table.c.id == each).values(position=place))
        return _one(database, connection, entry_id)


def remove_entry(database: Database, entry_id: int) -> None:
    """Forget an entry; what was measured stays. Raises `NotInStore`, and `Conflict` for one that is running."""
    with database.alone() as connection:
        gone = _one(database, connection, entry_id)
        if gone.phase == "running":
            raise Conflict(f'Entry {entry_id}, "{gone.name}", is running; abort it first, then remove it')
        connection.execute(delete(table).where(table.c.id == entry_id))


def start_entry(database: Database, entry_id: int) -> Entry:
    """Let an entry run when its turn comes; harmless when it is queued. Raises `NotInStore` and `Conflict`."""
    with database.alone() as connection:
        wanted = _one(database, connection, entry_id)
        if wanted.phase == "running":
            raise Conflict(f'Entry {entry_id}, "{wanted.name}", is running; it can be paused, resumed or aborted')
        if wanted.outcome == "completed":
            raise Conflict(
                f'Entry {entry_id}, "{wanted.name}", is completed; order a campaign of another name to measure again'
            )
        if wanted.phase == "queued":
            return wanted
        values: dict[str, Any] = {"phase": "queued", "outcome": None, "reason": "", "finished": None, "ordered": now()}
        if wanted.phase == "finished":
            values["position"] = _last(database, connection) + 1
        connection.execute(update(table).where(table.c.id == entry_id).values(**values))
        return _one(database, connection, entry_id)


def unqueue(database: Database, entry_id: int) -> Entry:
    """Let an entry that is queued wait for somebody to start it again. Raises `NotInStore` and `Conflict`."""
    with database.alone() as connection:
        wanted = _one(database, connection, entry_id)
        if wanted.phase != "queued":
            raise Conflict(f'Entry {entry_id}, "{wanted.name}", is {wanted.phase}, so there is nothing to abort')
        connection.execute(update(table).where(table.c.id == entry_id).values(phase="idle", reason="It was aborted."))
        return _one(database, connection, entry_id)


def next_entry(database: Database) -> Entry | None:
    """The first entry whose turn it is, which is running now; None where there is none."""
    moment = now()
    due = table.c.start_after.is_(None) | (table.c.start_after <= moment)
    mine = _of(database), table.c.phase == "queued", due
    wanted = select(table.c.id).where(*mine).order_by(table.c.position).limit(1)
    if not database.rows(wanted):  # to look is cheaper than to keep all others from writing
        return None
    with database.alone() as connection:
        found = connection.execute(wanted).scalar()
        if found is None:
            return None
        started = func.coalesce(table.c.started, moment)
        connection.execute(update(table).where(table.c.id == found).values(phase="running", started=started, reason=""))
        return _one(database, connection, found)


def begun(database: Database, entry_id: int, campaign_id: int) -> None:
    """Note which campaign of the database was made from an entry."""
    with database.writing() as connection:
        connection.execute(update(table).where(table.c.id == entry_id).values(campaign_id=campaign_id))


def finish_entry(database: Database, entry_id: int, outcome: Outcome, reason: str = "") -> None:
    """Note how a running entry ended."""
    with database.writing() as connection:
        connection.execute(
            update(table)
            .where(table.c.id == entry_id, table.c.phase == "running")
            .values(phase="finished", outcome=outcome, reason=reason, finished=now(), position=0)
        )


def is_fitting(entry: Entry, scans: Sequence[Scan]) -> bool:
    """Whether all of an entry is measured, which has these scans, and its fits are being made."""
    return entry.phase == "running" and bool(scans) and all(scan.outcome == "completed" for scan in scans)


def fitting_entries(store: Store, bench: str | None = None) -> list[Entry]:
    """Entries whose fits are being made now, of one bench or of all, those first that were ordered first."""
    query = select(table).where(table.c.phase == "running", table.c.campaign_id.is_not(None)).order_by(table.c.id)
    found = [entry for entry in map(_entry, store.rows(query)) if bench in {None, entry.bench}]
    return [entry for entry in found if is_fitting(entry, store.scans(entry.campaign_id)) and store.in_use(entry.bench)]


def abort_fits(database: Database, entry_id: int) -> None:
    """End an entry whose fits are being made; whoever makes them sees it in the database, and stops."""
    finish_entry(database, entry_id, "aborted", FITS_ABORTED)


def hold(database: Database, reason: str, since: str | None = None) -> None:
    """Let nothing begin by itself any more: what is queued is idle, for this reason.

    What somebody started after the moment `since`, ISO 8601 in UTC, stays queued.
    """
    meant = _of(database) & (table.c.phase == "queued")
    if since is not None:
        meant &= table.c.ordered < since
    with database.writing() as connection:
        connection.execute(update(table).where(meant).values(phase="idle", reason=reason))


def interrupt(database: Database, reason: str) -> None:
    """What was running is idle, for this reason; it has not ended, and goes on where it stood."""
    with database.writing() as connection:
        running = _of(database), table.c.phase == "running"
        connection.execute(update(table).where(*running).values(phase="idle", reason=reason))


def _of(database: Database) -> ColumnElement[bool]:
    return table.c.bench == database.bench


def _last(database: Database, connection: Connection) -> int:
    last = select(func.coalesce(func.max(table.c.position), 0)).where(_of(database))
    return int(connection.execute(last).scalar_one())


def _one(database: Database, connection: Connection, entry_id: int) -> Entry:
    row = connection.execute(select(table).where(table.c.id == entry_id)).first()
    if row is None:
        raise NotInStore(f"There is no entry {entry_id} in the queue; list what there is")
    if row.bench != database.bench:
        raise NotInStore(f"Entry {entry_id} is in the queue of the bench {row.bench}; ask the service that drives it")
    return _entry(row)


def _entry(row: Row[Any]) -> Entry:
    names = (column.name for column in table.columns)
    return Entry(**{name: getattr(row, name) for name in names})
