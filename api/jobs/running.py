"""Heavy work of the service: each job in a process of its own, a few at a time, none of them lost from sight.

A job is written down before it begins and again when it ends (`api.jobs.rows`), so it is known after a restart. It runs
through an executor of its own with one process, the leader of a group: to cancel the job ends the whole group, with all
that the job has started, and nothing else.
"""

import json
import logging
import os
import signal
import threading
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path
from time import monotonic

from pydantic import BaseModel

from analysis.strict_json import strict_json
from api.bench.link import Link
from api.bodies.jobs import OPEN, State
from api.errors import Conflict
from api.events import Events
from api.jobs import rows as job_rows
from api.jobs.kinds import KINDS
from api.jobs.retention import KEPT, Retention, prune
from api.jobs.rows import BEAT, Job
from api.jobs.view import job_view
from api.jobs.worker import Ended, begin_worker, work
from api.named_errors import name_of
from api.prepared import PREPARED, prepare
from drivers.errors import DriverError
from goniometer.errors import GoniometerError, StoreError
from goniometer.storage.store import Store

log = logging.getLogger(__name__)

LONG, SHORT = 1, max(1, (os.cpu_count() or 2) - 1)
"""Jobs of either sort that run at once, at a lower priority than the bench."""

PRUNE_EVERY = 3600.0
"""Seconds between two looks for jobs that are to be deleted."""
AGAIN = 5.0
"""Seconds until a database that refused is tried again."""

_TOLD = 0.5
"""Seconds between two notes of how far a job is."""


class Jobs:
    """The jobs that this process answers for; `close` ends it."""

    def __init__(
        self,
        store: Store,
        database: Path | str,
        output: Path,
        events: Events,
        cluster: str | None = None,
        bench: Link | None = None,
        kept: Retention = KEPT,
    ) -> None:
        """`database` is where `store` is, and `output` the folder of all results.

        `bench` is the process that obeys what is a command of the bench, and `cluster` the address of the Dask
        scheduler to which jobs send heavy work, None for this machine. Of jobs that are over, so many are `kept`.
        """
        self._store = store
        self._database = str(database)
        self._output = output
        self._events = events
        self._cluster = cluster
        self._bench = bench
        self._kept = kept
        self._at_bench: set[int] = set()
        self._me = job_rows.runner()
        self._groups: dict[int, int] = {}
        self._cancelled: set[int] = set()
        self._lock = threading.Lock()
        self._closed = threading.Event()
        self._long, self._short = ThreadPoolExecutor(LONG), ThreadPoolExecutor(SHORT)
        prepare()
        self._look_after()
        self._beating = threading.Thread(target=self._beat, name="jobs", daemon=True)
        self._beating.start()

    def submit(self, kind: str, arguments: BaseModel, who: str) -> Job:
        """Have something done for somebody; it may have to wait for its turn."""
        return self._start(kind, arguments.model_dump_json(), who)

    def again(self, job_id: int, who: str) -> Job:
        """The same anew; raises `NotInStore`, and `Conflict` while it is not over."""
        old = job_rows.job(self._store, job_id)
        if old.state in OPEN:
            raise Conflict(f"Job {job_id} is {old.state}; wait for its end, or cancel it first")
        return self._start(old.kind, old.arguments, who)

    def cancel(self, job_id: int) -> Job:
        """End a job, whatever it is doing; raises `NotInStore`, and `Conflict` where it is over or another's."""
        with self._lock:
            job = job_rows.job(self._store, job_id)
            if job.state not in OPEN:
                raise Conflict(f"Job {job_id} is over: it is {job.state}")
            if job_id not in self._groups and job_id not in self._at_bench and job.state == "running":
                raise Conflict(f"Job {job_id} runs in another service on this database; cancel it there")
            self._cancelled.add(job_id)
            job_rows.finish(self._store, job_id, "cancelled", "Somebody cancelled it.")
            self._end(job_id)
        self._publish(job_id)
        return job_rows.job(self._store, job_id)

    def close(self) -> None:
        """End all jobs; those that were not over are interrupted, and can be run again. Harmless when repeated."""
        self._closed.set()
        with self._lock:
            for job_id in (*self._groups, *self._at_bench):
                self._end(job_id)
        for slots in (self._long, self._short):
            slots.shutdown(wait=True, cancel_futures=True)
        self._beating.join()
        for job in job_rows.all_jobs(self._store, limit=1000, states=OPEN, by=self._me):
            job_rows.finish(self._store, job.id, "interrupted", job_rows.INTERRUPTED)

    def _start(self, kind: str, arguments: str, who: str) -> Job:
        if self._closed.is_set():
            raise Conflict("The service is ending; ask again when it is back")
        job = job_rows.add_job(self._store, kind, arguments, who, self._me)
        self._publish(job.id)
        slots = self._long if KINDS[kind].long else self._short
        run = self._run if KINDS[kind].run is not None else self._command
        slots.submit(run, job.id, kind, arguments).add_done_callback(partial(self._tell_fault, job.id))
        return job

    def _run(self, job_id: int, kind: str, arguments: str) -> None:
        """Do a job in this thread: start its process, follow it, and write down how it ended."""
        if self._closed.is_set():
            return
        heard, told = PREPARED.Pipe(duplex=False)
        begun = ProcessPoolExecutor(1, mp_context=PREPARED, initializer=begin_worker, initargs=(told,))
        with heard, begun as executor:
            with told, self._lock:
                if not job_rows.begin(self._store, job_id):  # cancelled while it waited
                    self._cancelled.discard(job_id)
                    return
                self._groups[job_id] = 0
                future = executor.submit(
                    work, self._database, str(self._output), self._cluster, job_id, kind, arguments
                )
            self._publish(job_id)
            self._follow(job_id, future, heard)
        with self._lock:
            del self._groups[job_id]
            self._cancelled.discard(job_id)
        self._conclude(job_id, future)
        self._publish(job_id)

    def _command(self, job_id: int, kind: str, arguments: str) -> None:
        """Have the bench do a job, follow it in this thread, and write down how it ended."""
        assert self._bench is not None  # there is one where there is a service
        with self._lock:
            if self._closed.is_set() or not job_rows.begin(self._store, job_id):
                self._cancelled.discard(job_id)
                return
            self._at_bench.add(job_id)
        self._publish(job_id)

        def tell(share: float, words: str) -> None:
            with suppress(StoreError):  # the next one tells more
                job_rows.tell(self._store, job_id, share, words)
                self._publish(job_id)

        try:
            found = self._bench.ask(kind, tell, **json.loads(arguments)).result()
        except (GoniometerError, DriverError) as error:
            self._write_down(job_id, "failed", str(error), fault=name_of(type(error)))
        else:
            self._write_down(job_id, "done", "", strict_json(found))
        finally:
            with self._lock:
                self._at_bench.discard(job_id)
                self._cancelled.discard(job_id)
        self._publish(job_id)

    def _follow(self, job_id: int, future: "Future[Ended]", heard: Connection) -> None:
        """Pass on what a job tells, until it is over."""
        last = monotonic() - _TOLD
        while not future.done():
            try:
                message = heard.recv() if heard.poll(0.1) else None
            except (EOFError, OSError):  # its process is gone
                break
            if isinstance(message, int):
                with self._lock:
                    self._groups[job_id] = message
                    if job_id in self._cancelled or self._closed.is_set():
                        self._end(job_id)
            elif message is not None and monotonic() - last >= _TOLD:
                last = monotonic()
                with suppress(StoreError):  # the next one tells more
                    job_rows.tell(self._store, job_id, *message)
                    self._publish(job_id)

    def _conclude(self, job_id: int, future: "Future[Ended]") -> None:
        fault = future.exception()
        if fault is None:
            ended = future.result()
            state: State = "failed" if ended.fault else "done"
            self._write_down(job_id, state, ended.reason, ended.result, ended.page, ended.fault)
        elif isinstance(fault, BrokenProcessPool):
            if self._closed.is_set():
                return  # `close` has ended it, and says so
            reason = "Its process was ended from outside, perhaps for want of memory; run it again."
            self._write_down(job_id, "failed", reason, fault="killed")
        else:
            self._write_fault(job_id, fault)

    def _tell_fault(self, job_id: int, followed: "Future[None]") -> None:
        """Write down that a job could not be followed, where that is so."""
        if not followed.cancelled() and (fault := followed.exception()) is not None:
            self._write_fault(job_id, fault)
            self._publish(job_id)

    def _write_fault(self, job_id: int, fault: BaseException) -> None:
        log.error("Job %s failed", job_id, exc_info=fault)
        reason = "It met a fault of its own; the log says which."
        self._write_down(job_id, "failed", reason, fault="internal")

    def _end(self, job_id: int) -> None:
        """Kill the group of a job, if its process has begun; else `_follow` does as soon as it has.

        What the bench does is stopped.
        """
        if job_id in self._at_bench and self._bench is not None:
            with suppress(Conflict):  # it has ended
                self._bench.ask("stop", lambda *_: None)
        group = self._groups.get(job_id)
        if group:
            with suppress(ProcessLookupError):
                os.killpg(group, signal.SIGKILL)

    def _beat(self) -> None:
        """Show signs of life, and delete what is old."""
        pruned = -PRUNE_EVERY
        while not self._closed.wait(BEAT):
            try:
                job_rows.beat(self._store, self._me)
                self._look_after()
                if monotonic() - pruned >= PRUNE_EVERY:
                    pruned = monotonic()
                    prune(self._store, self._output, self._kept)
            except StoreError as error:
                log.warning("Jobs are not looked after: %s", error)

    def _write_down(
        self,
        job_id: int,
        state: State,
        reason: str,
        result: str | None = None,
        page: str | None = None,
        fault: str | None = None,
    ) -> None:
        """Put down how a job ended, as `job_rows.finish`, as soon as the database lets it."""
        while True:
            try:
                job_rows.finish(self._store, job_id, state, reason, result, page, fault)
                return
            except StoreError as error:
                log.error("The end of job %s cannot be written: %s", job_id, error)
                if self._closed.wait(AGAIN):
                    return

    def _look_after(self) -> None:
        for job_id in job_rows.interrupt_orphans(self._store, self._me):
            self._publish(job_id)

    def _publish(self, job_id: int) -> None:
        self._events.publish("job", job_view(job_rows.job(self._store, job_id)))
