"""The process that drives the bench: it holds the lease, runs the queue, and obeys one service.

It ends when its service does. Whatever ends it, the stages are stopped and the shutter is closed before.
"""

import asyncio
import logging
import os
import signal
import socket
import threading
import time
import uuid
from collections.abc import Coroutine
from contextlib import AsyncExitStack, suppress
from functools import partial
from multiprocessing.connection import Connection
from queue import SimpleQueue
from typing import Any

from api.bench import queue
from api.bench.lease import (
    BEAT,
    EXPIRY,
    GIVE_UP,
    Lease,
    Watcher,
    read_lease,
    release_lease,
    renew_lease,
    take_lease,
    take_up_stop,
)
from api.bench.messages import Answer, Call, Doing, Done, Message, Refusal, Told
from api.bench.operated import POSSIBLE, OperatedBench, set_point
from api.bench.runner import PATIENCE_WITH_DISK, Runner, Task
from api.bodies.bench import BenchState, Driver
from api.bodies.events import Notice, Reset
from api.errors import Conflict
from api.logs import log_to_stderr
from drivers.errors import DriverError
from goniometer.errors import GoniometerError, StoreBusy, StoreError
from goniometer.storage.records import now
from goniometer.storage.store import Store

UNHEARD = 1000
"""Messages that may wait for the service to hear them; more are dropped, and it is told so once it hears again."""
LOOK = 0.2
"""Seconds between two looks at the devices."""
AGAIN = 0.1
"""Seconds between two looks at the queue."""

BEHIND = 1
"""Campaigns whose fits may still be made when the next one begins."""

RESTARTED = "The service has ended meanwhile; start it again to go on where it stood."
HELD = "The service was started anew; look at the bench, then start it again."
STOPPED = "The bench was stopped; look at it, then start it again."

log = logging.getLogger(__name__)


def main(connection: Connection, task: Task) -> None:
    """Drive the bench until the service that started this process is gone or says so."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the service as well, which says when to end
    log_to_stderr()
    asyncio.run(_Worker(connection, task).serve())


class _Worker:
    def __init__(self, connection: Connection, task: Task) -> None:
        self.connection = connection
        self.task = task
        self.store = Store.open(task.database, task.bench)
        self.bench = OperatedBench(task.settings, self.tell_state, task.alarm)
        self.lease: Lease | None = None
        self.driving: Lease | None = None
        """Whoever drives, as last read."""
        self.ending = asyncio.Event()
        self.runner = Runner(self.store, self.bench, task, self.say, self.tell_state)
        self.halted = False
        """Whether nothing may begin, because the bench is being stopped or parked."""
        self.busy_elsewhere = False
        """Whether another process of this machine has locked the database."""
        self.told: BenchState | None = None
        self.spectrum: int | None = None
        self.outbox: SimpleQueue[Message] = SimpleQueue()
        self.unheard = False
        """Whether messages were dropped of which the service does not know yet."""

    async def serve(self) -> None:
        """Take the lease when it is free, and work until the service ends."""
        loop = asyncio.get_running_loop()
        loop.add_signal_handler(signal.SIGTERM, self.ending.set)
        calls: asyncio.Queue[Call] = asyncio.Queue()
        threading.Thread(target=self._listen, args=(loop, calls), daemon=True).start()
        threading.Thread(target=self._send, daemon=True).start()
        handler = _Telling(self)
        for floor in ("drivers", "goniometer", "api"):
            logging.getLogger(floor).addHandler(handler)
        self.tell_state()
        jobs = [asyncio.ensure_future(each) for each in (self._obey(calls), self._look(), self._drive())]
        ended = asyncio.ensure_future(self.ending.wait())
        try:
            await asyncio.wait({*jobs, ended}, return_when=asyncio.FIRST_COMPLETED)
        finally:
            failed = [job for job in jobs if job.done()]
            self.ending.set()
            for job in (*jobs, ended):
                job.cancel()
            await asyncio.wait({*jobs, ended})
        for job in failed:
            job.result()

    def _listen(self, loop: asyncio.AbstractEventLoop, calls: "asyncio.Queue[Call]") -> None:
        """Pass on what the service says; when it is gone, end."""
        with suppress(RuntimeError):  # the loop is closed
            try:
                while True:
                    loop.call_soon_threadsafe(calls.put_nowait, self.connection.recv())
            except (EOFError, OSError):
                loop.call_soon_threadsafe(self.ending.set)

    def say(self, message: Message) -> None:
        """Tell the service, from any thread; a service that does not listen holds nothing up."""
        if self.outbox.qsize() < UNHEARD or isinstance(message, Answer):
            self.outbox.put(message)
        else:
            self.unheard = True

    def _send(self) -> None:
        with suppress(OSError):  # the service is gone
            while True:
                self.connection.send(self.outbox.get())

    # The lease

    async def _drive(self) -> None:
        """Take the lease whenever it can be had, and drive as long as it holds."""
        watcher = Watcher()
        holder = uuid.uuid4().hex
        since: str | None = self.task.since
        while True:
            try:
                async with AsyncExitStack() as held:
                    try:
                        held.enter_context(self.store.exclusive())
                    except StoreBusy:  # another process drives this bench, or runs a campaign from its command line
                        if not self.busy_elsewhere:
                            self.busy_elsewhere, self.driving = True, read_lease(self.store)
                            log.warning("This service does not drive the bench: %s", self._elsewhere())
                    else:
                        self.busy_elsewhere = False
                        seen = read_lease(self.store)
                        dead = seen is not None and (
                            seen.holder == holder or self._is_gone(seen) or watcher.silent_for(seen) > EXPIRY
                        )
                        self.lease = take_lease(self.store, holder, self.task.url, seen if dead else None)
                    if self.lease is not None:
                        await self._hold_lease(self.lease, since)
                since = None  # whatever was started meanwhile was not meant for this service
                self._see_driver()
            except StoreError as error:  # a server that restarts is back in a while
                log.error("%s", error)
                await asyncio.sleep(PATIENCE_WITH_DISK)
            await asyncio.sleep(BEAT / 2)

    def _is_gone(self, lease: Lease) -> bool:
        """Whether who holds a lease has ended, as far as this machine, whose process has `exclusive`, can tell."""
        if lease.host != socket.gethostname():
            return False
        if self.store.file is not None:  # its lock ends with the process only
            return True
        try:
            os.kill(lease.process, 0)
        except ProcessLookupError:
            return True
        except PermissionError:  # of another account, and alive
            return False
        return lease.process == os.getpid()

    async def _hold_lease(self, lease: Lease, since: str | None) -> None:
        """Run the queue, and show signs of life; returns when the lease is lost, with the bench parked.

        What was started after the moment `since` stays queued.
        """
        log.info("Drives the bench, term %d", lease.term)
        self.store.end_stale_scans()
        queue.interrupt(self.store, RESTARTED)
        queue.hold(self.store, HELD, since)
        self.halted = self.runner.leaving = False
        self.runner.tell_queue()
        self._see_driver()
        work, beats = (asyncio.ensure_future(each) for each in (self._work(), self._beat(lease)))
        try:
            await asyncio.wait({work, beats}, return_when=asyncio.FIRST_COMPLETED)
        finally:
            self.halted = self.runner.leaving = True
            await self.bench.park()
            work.cancel()
            beats.cancel()
            await asyncio.wait({work, beats})
            await self.runner.leave()
            self.lease = None
            with suppress(StoreError):  # then it expires
                queue.interrupt(self.store, RESTARTED)
                release_lease(self.store, lease)
            self.runner.tell_queue()
        for each in (work, beats):
            if not each.cancelled():
                each.result()

    async def _beat(self, lease: Lease) -> None:
        """Renew the lease in time; returns when it is lost."""
        renewed = time.monotonic()
        while True:
            await asyncio.sleep(BEAT)
            asked = time.monotonic()
            try:
                held = await asyncio.to_thread(renew_lease, self.store, lease)
            except StoreError as error:
                log.warning("The lease of the bench cannot be renewed: %s", error)
                if time.monotonic() - renewed > GIVE_UP:
                    log.error("The lease of the bench could not be renewed for %g s; it is parked", GIVE_UP)
                    return
                continue
            if held is None:
                log.error("Another service has taken the lease of the bench; it is parked")
                return
            renewed = asked

    def _see_driver(self) -> None:
        self.driving = read_lease(self.store)
        self.tell_state()

    # The queue

    async def _work(self) -> None:
        """Run what is queued, one after the other, and take up what other services pass on."""
        while True:
            lease = self.lease
            assert lease is not None  # it works only while it is held
            try:
                if take_up_stop(self.store, lease):
                    await self._stop()
                free = self.bench.phase in {"disconnected", "ready"} and not self.halted
                free = free and len(self.runner.fitting) <= BEHIND
                entry = queue.next_entry(self.store) if free else None
                if entry is not None:
                    watching = asyncio.ensure_future(self._watch_for_stop(lease))
                    try:
                        await self.runner.run(entry)
                    finally:
                        watching.cancel()
            except StoreError as error:
                log.error("%s", error)
                await asyncio.sleep(PATIENCE_WITH_DISK)
                with suppress(StoreError):  # then it is tried again
                    queue.interrupt(self.store, str(error))
            await asyncio.sleep(AGAIN)

    async def _watch_for_stop(self, lease: Lease) -> None:
        while True:
            await asyncio.sleep(AGAIN)
            with suppress(StoreError):  # it is asked again
                if take_up_stop(self.store, lease):
                    await self._stop()

    # Commands of the service

    async def _obey(self, calls: "asyncio.Queue[Call]") -> None:
        """Answer every call; a slow one keeps nobody from pressing stop."""
        async with asyncio.TaskGroup() as group:
            while True:
                group.create_task(self._answer(await calls.get()))

    async def _answer(self, call: Call) -> None:
        try:
            value = await self._command(call)
            await self._look_once()  # who reads the state after the answer sees what came of it
        except (GoniometerError, DriverError) as error:
            self.say(Refusal(call.number, type(error).__name__, str(error)))
        else:
            self.say(Done(call.number, value))

    def _command(self, call: Call) -> Coroutine[Any, Any, Any]:
        name, arguments = call.name, call.arguments
        if name == "end":
            return self._end()
        if self.lease is None:
            raise Conflict(self._elsewhere())
        if name == "stop":
            return self._stop()
        commands: dict[str, Any] = {
            "mounted": self.runner.confirm,
            "connect": self.bench.connect,
            "disconnect": self.bench.disconnect,
            "home": self.bench.home,
            "jog": self.bench.jog,
            "expose": self.bench.expose,
            "doctor": partial(self.bench.doctor, tell=lambda *far: self.say(Doing(call.number, *far))),
        }
        work: Coroutine[Any, Any, Any] = commands[name](**arguments)
        return work

    async def _end(self) -> None:
        self.ending.set()

    def _elsewhere(self) -> str:
        """Why this service does not drive."""
        driving = self.driving
        if driving is not None and driving.holder is not None:
            return f"The bench is driven by {driving}; ask that one"
        if self.busy_elsewhere:
            return "Another process runs a campaign on this database, without a service; wait for its end, or abort it"
        return "Nobody drives the bench just now; try again in a moment"

    async def _stop(self) -> None:
        """Stop the bench, and let nothing begin before somebody has looked."""
        log.warning("Somebody pressed stop")
        self.halted = True
        try:
            await self.bench.stop()
        finally:
            queue.hold(self.store, STOPPED)
            self.halted = self.runner.leaving
            self.runner.tell_queue()

    # What the service is told

    async def _look(self) -> None:
        """Tell what the devices do, as long as this process lives."""
        # a cancellation may come in the same moment as a reply, which Python 3.11 then takes for the end of the matter
        while not self.ending.is_set():
            await self._look_once()
            await asyncio.sleep(LOOK)

    async def _look_once(self) -> None:
        await self.bench.look()
        missed = self.unheard and self.outbox.empty()
        if missed:
            self.unheard = False
            self.told = self.spectrum = None  # it may have been them
        spectrum = self.bench.snapshot()
        if spectrum is not None and spectrum.number != self.spectrum:
            self.spectrum = spectrum.number
            self.say(spectrum)
        self.tell_state()
        if missed:  # the last, so that who reads everything anew finds it as it is now
            self.say(Told("reset", Reset()))

    def tell_state(self) -> None:
        """Say what the bench is at, where that has changed."""
        state = self.state()
        if state != self.told:
            self.told = state
            self.say(state)

    def state(self) -> BenchState:
        """What the bench is and does now."""
        bench, instrument, driving = self.bench, self.bench.instrument, self.driving
        standing = bench.standing
        here = self.lease is not None
        driver = None
        if driving is not None and driving.holder is not None:
            where = {"url": driving.url, "host": driving.host, "process": driving.process, "since": driving.taken}
            driver = Driver.model_validate(where | {"here": here})
        spectrum = None if instrument is None else instrument.last_spectrum
        lamp = -1.0 if instrument is None else instrument.lamp_on_for
        return BenchState(
            name=self.task.bench,
            phase=bench.phase,
            doing=bench.doing if here else self._elsewhere() + ".",
            possible=POSSIBLE[bench.phase] if here else ("stop",),
            driver=driver,
            simulated=self.task.settings is None,
            stages=bench.stages,
            theta_in=None if standing is None else standing.theta_in,
            theta_out=None if standing is None else standing.theta_out,
            detector_temperature=bench.temperature,
            cooler_set_point=set_point(self.task.settings),
            lamp_on_for=lamp // 10 * 10 if 0 <= lamp < float("inf") else None,  # else it would change all the time
            shutter=bench.shutter,
            integration_time=None if spectrum is None else spectrum.integration_time,
            integration_limits=None if instrument is None else instrument.integration_limits,
            spectrum=None if spectrum is None else spectrum.count,
            running=self.runner.running,
            prompt=self.runner.prompt,
            # who drives in its stead tells its own
            alarms=() if self.bench.alarm is None or (driver is not None and not here) else (self.bench.alarm,),
        )


class _Telling(logging.Handler):
    """Passes warnings of the drivers and of scans on to whoever listens."""

    def __init__(self, worker: _Worker) -> None:
        super().__init__(logging.WARNING)
        self.worker = worker

    def emit(self, record: logging.LogRecord) -> None:
        notice = Notice(level=record.levelname.lower(), message=record.getMessage(), moment=now())
        self.worker.say(Told("alarm" if record.levelno >= logging.ERROR else "log", notice))
