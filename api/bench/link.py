"""The service's end of the process that drives the bench: it starts it, listens to it and asks it."""

import asyncio
import itertools
import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from typing import Any

from api.access.audit import record_done
from api.bench.lease import pass_on_stop
from api.bench.messages import Call, Doing, Done, Message, Refusal, Snapshot, Told
from api.bench.operated import set_point
from api.bench.runner import Task
from api.bench.worker import main
from api.bodies.bench import Alarm, BenchState
from api.bodies.events import Notice, SpectrumRead
from api.errors import BenchEnded, Conflict
from api.events import Events
from api.named_errors import error_named
from api.prepared import PREPARED, prepare
from goniometer.errors import GoniometerError
from goniometer.storage.database import Database
from goniometer.storage.records import now

HISTORY = 720
"""Moments of the past that are kept."""
HISTORY_EVERY = 5.0
"""Seconds between two of them."""
PATIENCE = 30.0
"""Seconds in which the process must have parked the bench when the service ends."""
RESTART = 2.0
"""Seconds after which a process that ended by itself is started anew."""

_ENDED = "The process that drives the bench has ended; try again in a moment"

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Past:
    """What was read of the bench at some moment."""

    moment: str
    """ISO 8601, UTC."""
    detector_temperature: float | None
    """Degrees Celsius."""
    lamp_on_for: float | None
    """Seconds."""


class Link:
    """The process that drives the bench, as its service sees it."""

    def __init__(self, task: Task, database: Database, events: Events) -> None:
        self._task = task
        self._database = database
        self._events = events
        self._numbers = itertools.count(1)
        self._waiting: dict[int, tuple[Future[Any], Callable[[float, str], None]]] = {}
        self._lock = threading.Lock()
        self._connection: Connection | None = None
        self._closing = False
        self._thread: threading.Thread | None = None
        self._past: deque[Past] = deque(maxlen=HISTORY)
        self._past_told = -HISTORY_EVERY
        self._state = _unknown(task)
        self.shown = self._state.model_dump_json()
        """`state` as JSON, made once for all who ask."""
        self.lives = False
        """Whether the process has told of the bench, and has not ended since."""
        self.snapshot: Snapshot | None = None
        """The last spectrum; None where there is none yet."""

    @property
    def state(self) -> BenchState:
        """What the bench is and does."""
        return self._state

    @property
    def past(self) -> list[Past]:
        """What was read of the bench in the last hour, oldest first."""
        return list(self._past)

    def start(self) -> None:
        """Start the process, and start it anew where it ends by itself."""
        prepare()
        self._thread = threading.Thread(target=self._supervise, name="bench", daemon=True)
        self._thread.start()

    def end(self) -> None:
        """Let the process park the bench and end, without waiting for it; harmless when repeated."""
        self._closing = True
        with self._lock, suppress(OSError):  # it has ended before
            if self._connection is not None:
                self._connection.send(Call(0, "end", {}))

    def close(self) -> None:
        """Let the process park the bench and end, and return when it has."""
        self.end()
        if self._thread is not None:
            self._thread.join()

    async def call(self, name: str, **arguments: Any) -> Any:
        """What comes of a command; raises what refused it, `Conflict` where nobody is there to obey."""
        return await asyncio.wrap_future(self.ask(name, lambda *_: None, **arguments))

    def ask(self, name: str, tell: Callable[[float, str], None], **arguments: Any) -> Future[Any]:
        """As `call`, from any thread; `tell` is told how far it is, 0 to 1 and in words, and must return soon."""
        number = next(self._numbers)
        answer: Future[Any] = Future()
        with self._lock:
            if self._connection is None:
                raise Conflict("The process that drives the bench is being started; try again in a moment")
            self._waiting[number] = answer, tell
            try:
                self._connection.send(Call(number, name, arguments))
            except OSError:  # it has ended, and nobody has noticed yet
                del self._waiting[number]
                raise BenchEnded(_ENDED) from None
        return answer

    async def stop(self) -> None:
        """Stop the bench at once, whichever service drives it."""
        driver = self.state.driver
        if driver is not None and not driver.here:
            await asyncio.to_thread(pass_on_stop, self._database)
        else:
            await self.call("stop")

    def _supervise(self) -> None:
        alarm: Alarm | None = None
        while not self._closing:
            here, there = PREPARED.Pipe()
            task = replace(self._task, since=now(), alarm=alarm)
            process = PREPARED.Process(target=main, args=(there, task), name="goniometer bench")
            process.start()
            record_done(self._database, "bench", "start", {"process": process.pid})
            there.close()
            with self._lock:
                self._connection = here
                if self._closing:  # `end` came before there was anybody to be told
                    with suppress(OSError):
                        here.send(Call(0, "end", {}))
            self._listen(here)
            with self._lock:
                self._connection = None
                here.close()
                forsaken, self._waiting = self._waiting, {}
            self._tell(_unknown(self._task, self._state.alarms))
            self.lives = False
            for answer, _ in forsaken.values():
                if answer.set_running_or_notify_cancel():
                    answer.set_exception(BenchEnded(_ENDED))
            process.join(PATIENCE)
            if process.exitcode is None:
                log.error("The process that drives the bench does not end; it is killed")
                process.kill()
                process.join()
            record_done(self._database, "bench", "end", {"process": process.pid, "code": process.exitcode})
            if not self._closing:
                code = process.exitcode
                message = f"The process that drives the bench has ended (code {code}) and is started anew; see the log"
                log.error(message)
                alarm = Alarm(text=message, since=now())
                self._tell(_unknown(self._task, (alarm,)))
                self._events.publish("alarm", Notice(level="error", message=message, moment=alarm.since))
                time.sleep(RESTART)

    def _listen(self, connection: Connection) -> None:
        """Hear the process until it ends."""
        with suppress(EOFError, OSError):
            while True:
                self._hear(connection.recv())

    def _hear(self, message: Message) -> None:
        match message:
            case BenchState():
                self._tell(message)
                self.lives = True
                self._remember(message)
            case Snapshot():
                self.snapshot = message
                read = SpectrumRead(
                    number=message.number,
                    integration_time=message.integration_time,
                    brightest=int(message.counts.max()),
                    saturation=message.saturation,
                    shutter=message.shutter,
                )
                self._events.publish("spectrum", read)
            case Told(kind, data):
                self._events.publish(kind, data)
            case Doing(number, share, words):
                _, tell = self._waiting.get(number, (None, None))
                if tell is not None:
                    tell(share, words)
            case Done(number, value):
                if (answer := self._answer(number)) is not None:
                    answer.set_result(value)
            case Refusal(number, kind, sentence):
                if (answer := self._answer(number)) is not None:
                    answer.set_exception(error_named(kind, sentence) or GoniometerError(sentence))

    def _answer(self, number: int) -> Future[Any] | None:
        """The future of a call that is over; None where nobody waits for it any more."""
        with self._lock:
            answer, _ = self._waiting.pop(number, (None, None))
        return answer if answer is not None and answer.set_running_or_notify_cancel() else None

    def _tell(self, state: BenchState) -> None:
        self._state, self.shown = state, state.model_dump_json()
        self._events.publish("state", self.shown)

    def _remember(self, state: BenchState) -> None:
        if time.monotonic() - self._past_told >= HISTORY_EVERY and state.stages:
            self._past_told = time.monotonic()
            self._past.append(Past(now(), state.detector_temperature, state.lamp_on_for))


def _unknown(task: Task, alarms: tuple[Alarm, ...] = ()) -> BenchState:
    """The state of a bench of which nobody has told anything yet."""
    return BenchState(
        name=task.bench,
        phase="disconnected",
        doing="The process that drives the bench is being started.",
        possible=(),
        driver=None,
        simulated=task.settings is None,
        stages=(),
        theta_in=None,
        theta_out=None,
        detector_temperature=None,
        cooler_set_point=set_point(task.settings),
        lamp_on_for=None,
        shutter="unknown",
        integration_time=None,
        integration_limits=None,
        spectrum=None,
        running=None,
        prompt=None,
        alarms=alarms,
    )
