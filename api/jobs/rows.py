"""Jobs in the database: what was asked for, who answers for it, how far it is, and what came of it.

waiting -> running -> done | failed; waiting or running -> cancelled, by a person, or interrupted, where the service
that answered for it ended first. A job that has ended stays as it is; whoever wants it again asks for a new one.
"""

import os
import secrets
import socket
from dataclasses import dataclass, fields
from typing import Any

from sqlalchemy import Row, Select, select, update

from api.bodies.jobs import OPEN, State
from goniometer.storage.database import Database, insert_row
from goniometer.storage.records import now
from goniometer.storage.service_tables import jobs as table

BEAT = 3.0
"""Seconds between two signs of life of a service."""
SILENT = 30.0
"""Seconds without a sign of life after which a service is taken for dead."""

INTERRUPTED = "The service that ran it ended before it did; run it again."


@dataclass(frozen=True)
class Job:
    """A piece of work that takes longer than an answer may."""

    id: int
    kind: str
    """One of `api.jobs.kinds.KINDS`."""
    who: str
    """Who asked for it."""
    state: State
    share: float | None
    """How much of it is done, 0 to 1; None where nobody can tell."""
    words: str
    """What it does now."""
    reason: str
    """Why it did not come to its end, as a sentence; empty else."""
    fault: str | None
    """What a program calls that, as "not-in-store", where it failed; None else."""
    arguments: str
    """What was asked for, as JSON."""
    created: str
    """ISO 8601, UTC, as all times here."""
    started: str | None
    finished: str | None
    has_result: bool
    has_page: bool
    """Whether it made an HTML page."""


_LIFE = secrets.token_hex(4)  # a number of a process comes again, in a container the same after every start


def runner() -> str:
    """The name of this process for others: its machine, its number, and what tells it from one before it."""
    return f"{socket.gethostname()}:{os.getpid()}:{_LIFE}"


def add_job(database: Database, kind: str, arguments: str, who: str, by: str) -> Job:
    """Write down a job that waits; `by` is the runner that answers for it."""
    with database.writing() as connection:
        job_id = insert_row(
            connection,
            table,
            kind=kind,
            who=who,
            state="waiting",
            runner=by,
            beat=database.clock(),
            created=now(),
            arguments=arguments,
        )
    return job(database, job_id)


def job(database: Database, job_id: int) -> Job:
    """One job; raises `NotInStore`."""
    return _job(database.row(_jobs().where(table.c.id == job_id), f"job {job_id}"))


def all_jobs(
    database: Database,
    limit: int,
    before: int | None = None,
    states: tuple[State, ...] = (),
    kind: str | None = None,
    by: str | None = None,
) -> list[Job]:
    """At most `limit` jobs, newest first: those older than the job `before`, in one of the `states`, of one kind.

    `by` is the runner that answers for them; None of any.
    """
    query = _jobs().order_by(table.c.id.desc()).limit(limit)
    if before is not None:
        query = query.where(table.c.id < before)
    if states:
        query = query.where(table.c.state.in_(states))
    if kind is not None:
        query = query.where(table.c.kind == kind)
    if by is not None:
        query = query.where(table.c.runner == by)
    return [_job(row) for row in database.rows(query)]


def result_of(database: Database, job_id: int) -> str | None:
    """The result of a job as JSON; None where there is none. Raises `NotInStore`."""
    text: str | None = database.row(select(table.c.result).where(table.c.id == job_id), f"job {job_id}").result
    return text


def page_of(database: Database, job_id: int) -> str | None:
    """The HTML page that a job made; None where it made none. Raises `NotInStore`."""
    text: str | None = database.row(select(table.c.page).where(table.c.id == job_id), f"job {job_id}").page
    return text


def begin(database: Database, job_id: int) -> bool:
    """Note that a job that waits runs now; False where it waits no more."""
    return _changed(database, job_id, ("waiting",), state="running", started=now())


def tell(database: Database, job_id: int, share: float | None, words: str) -> None:
    """Note how far a running job is."""
    _changed(database, job_id, ("running",), share=share, words=words)


def finish(
    database: Database,
    job_id: int,
    state: State,
    reason: str = "",
    result: str | None = None,
    page: str | None = None,
    fault: str | None = None,
) -> bool:
    """Note how an open job ended; False where it has ended already."""
    share = {"share": 1.0} if state == "done" else {}
    ended = {"finished": now(), "words": "", "reason": reason, "result": result, "page": page, "fault": fault}
    return _changed(database, job_id, OPEN, state=state, **ended, **share)


def beat(database: Database, by: str) -> None:
    """Tell others that the runner `by` lives, where it answers for any job."""
    mine = table.c.state.in_(OPEN), table.c.runner == by
    if database.rows(select(table.c.id).where(*mine).limit(1)):
        with database.writing() as connection:
            connection.execute(update(table).where(*mine).values(beat=database.clock()))


def interrupt_orphans(database: Database, by: str) -> list[int]:
    """Note that jobs are interrupted whose runner is gone, and return their ids; `by` is who looks.

    A runner of this machine is gone when no process has its number, any when it has been silent for `SILENT` seconds.
    """
    columns = table.c.id, table.c.runner, table.c.beat
    open_jobs = database.rows(select(*columns).where(table.c.state.in_(OPEN), table.c.runner != by))
    clock = database.clock() if open_jobs else 0.0
    orphans = [row.id for row in open_jobs if clock - row.beat > SILENT or _is_gone(row.runner)]
    return [job_id for job_id in orphans if finish(database, job_id, "interrupted", INTERRUPTED)]


def _is_gone(other: str) -> bool:
    machine, number, _ = other.rsplit(":", 2)
    if machine != socket.gethostname():
        return False  # nobody can look from here
    if int(number) == os.getpid():  # it had the number that is ours now
        return True
    try:
        os.kill(int(number), 0)
    except ProcessLookupError:
        return True
    except PermissionError:  # of another account, and alive
        return False
    return False


def _changed(database: Database, job_id: int, states: tuple[State, ...], **values: object) -> bool:
    with database.writing() as connection:
        changed = connection.execute(
            update(table).where(table.c.id == job_id, table.c.state.in_(states)).values(**values)
        )
    return changed.rowcount > 0


_COMPUTED = {"has_result": table.c.result, "has_page": table.c.page}


def _jobs() -> Select[Any]:
    own = [table.c[field.name] for field in fields(Job) if field.name not in _COMPUTED]
    return select(*own, *(column.is_not(None).label(name) for name, column in _COMPUTED.items()))


def _job(row: Row[Any]) -> Job:
    return Job(**{field.name: getattr(row, field.name) for field in fields(Job)})
