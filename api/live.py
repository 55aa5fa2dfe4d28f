"""What the service consists of while it runs: one object that every endpoint is given."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from api.events import Events
from api.settings import InstrumentSettings
from goniometer.store import Store


@dataclass(frozen=True)
class Live:
    """The running service."""

    store: Store
    """Measurements, and what was derived from them."""
    database: Path | str
    """Where `store` is, for processes and tables of their own."""
    settings: InstrumentSettings | None
    """Of the bench; None for the simulated one."""
    events: Events
    output: Path
    """Folder below which the files of campaigns, exports and jobs are written."""


@contextmanager
def open_live(database: Path | str, output: Path, settings: InstrumentSettings | None = None) -> Iterator[Live]:
    """The service on `database`, until the context ends. Raises `StoreError` where the database cannot be opened."""
    store = Store.open(database)
    events = Events()
    try:
        yield Live(store, database, settings, events, output)
    finally:
        events.close()
        store.close()
