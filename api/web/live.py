"""What the service consists of while it runs: one object that every endpoint is given."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from api.access.callers import Callers
from api.bench.link import Link
from api.bench.runner import Task
from api.events import Events
from api.jobs.retention import KEPT, Retention
from api.jobs.running import Jobs
from api.settings import InstrumentSettings
from api.views.newest import Newest
from api.views.opened import Datasets
from api.web.filling import fill_apart
from goniometer.storage.store import Store
from goniometer.storage.tables import BENCH


@dataclass(frozen=True)
class Live:
    """The running service."""

    store: Store
    """Measurements, what was derived from them, and the tables of the service."""
    database: Path | str
    """Where `store` is, for processes of their own."""
    settings: InstrumentSettings | None
    """Of the bench; None for the simulated one."""
    events: Events
    worker: Link
    """The process that drives the bench; the application starts and ends it."""
    output: Path
    """Folder below which the files of campaigns, exports and jobs are written."""
    jobs: Jobs
    """Heavy work in processes of its own."""
    datasets: Datasets
    """Datasets as they are looked at."""
    newest: Newest
    """What was measured last, calibrated for those who look on."""
    callers: Callers
    """Who asks for something."""
    files: Path
    """Folder of what campaigns name: certificates, materials and weights of scenes."""


@contextmanager
def open_live(
    database: Path | str,
    output: Path,
    settings: InstrumentSettings | None = None,
    *,
    url: str = "http://127.0.0.1:8000",
    mounts_by_itself: bool = False,
    bench: str = BENCH,
    cluster: str | None = None,
    kept: Retention = KEPT,
) -> Iterator[Live]:
    """The service on `database`, until the context ends; nothing moves before an application is made of it.

    `settings` of None are the simulated bench, on which samples are laid without asking anybody if `mounts_by_itself`.
    `url` is where the service answers, `bench` the name of the bench, `cluster` the Dask scheduler that does heavy
    work, None for this machine. Of jobs that are over, so many are `kept`. Raises `StoreError` where the database
    cannot be opened.
    """
    store = Store.open(database, bench)
    events = Events()
    worker = Link(Task(database, output, settings, url, mounts_by_itself, bench, cluster), store, events)
    jobs = Jobs(store, database, output, events, cluster, worker, kept)
    datasets = Datasets(store, output / "cache", partial(fill_apart, database))
    try:
        yield Live(
            store,
            database,
            settings,
            events,
            worker,
            output,
            jobs,
            datasets,
            Newest(store),
            Callers(store),
            Path.cwd(),
        )
    finally:
        jobs.close()
        events.close()
        store.close()
