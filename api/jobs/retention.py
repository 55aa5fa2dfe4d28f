"""How long the service keeps what came of its jobs: rows, results, pages, and the files that they wrote.

It is the only place where any of that is deleted. Measurements, datasets, fits and the log are kept for ever; an export
whose file has gone says so, and can be written again.
"""

import shutil
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

from sqlalchemy import delete, select

from api.access.audit import record_done
from api.bodies.jobs import OPEN
from goniometer.storage.database import Database
from goniometer.storage.service_tables import jobs as table

JOBS = "jobs"
"""Folder of the files of jobs below that of all results; each has one of its own in it."""


@dataclass(frozen=True)
class Retention:
    """What is kept of jobs that are over."""

    newest: int = 1000
    """So many of the newest, however old they are."""
    days: float = 90.0
    """All that are younger."""


KEPT = Retention()


def prune(database: Database, output: Path, kept: Retention) -> list[int]:
    """Delete the jobs that are not `kept`, with their files below `output`, the folder of all results.

    Returns their ids, oldest first. What is waiting or running stays. Raises `StoreError`; whoever is interrupted
    between a job's files and its row deletes the row the next time.
    """
    oldest = (datetime.now(UTC) - timedelta(days=kept.days)).isoformat(timespec="milliseconds")
    over = select(table.c.id).where(table.c.state.not_in(OPEN))
    newest = over.order_by(table.c.id.desc()).limit(kept.newest)
    gone = [
        row.id
        for row in database.rows(over.where(table.c.id.not_in(newest), table.c.finished < oldest).order_by(table.c.id))
    ]
    for job_id in gone:
        shutil.rmtree(output / JOBS / str(job_id), ignore_errors=True)
        with database.writing() as connection:
            connection.execute(delete(table).where(table.c.id == job_id))
    if gone:
        record_done(database, "service", "delete old jobs", {"first": gone[0], "last": gone[-1], "number": len(gone)})
    return gone
