"""What happens on the bench and around it, as a stream that any number of listeners follow.

Whoever publishes never waits: the last events are kept, and a listener that falls behind them, or that names one which
is not known any more, is told `reset` and reads everything anew.
"""

import asyncio
import json
import secrets
import threading
from collections import deque
from collections.abc import AsyncIterator
from dataclasses import dataclass
from itertools import islice

from api.bodies.events import AnyData, EventKind

KEPT = 2000
"""Events that are kept for listeners who come back."""
HEARTBEAT = 15.0
"""Seconds after which a listener who has heard nothing is told that the stream lives."""
TOGETHER = 0.2
"""Seconds for which events are collected before they are sent: a chunk costs more than what is in it."""


@dataclass(frozen=True)
class Event:
    """Something that happened."""

    number: int
    kind: EventKind
    text: str
    """Its data as JSON in one line; `api.bodies.events.EventData` has the shape of every kind."""


class Events:
    """The stream; publish from any thread, subscribe in the event loop that `attach` named."""

    def __init__(self) -> None:
        self._run = secrets.token_hex(4)  # numbers begin anew with every process
        self._kept: deque[Event] = deque(maxlen=KEPT)
        self._count = 0
        self._lock = threading.Lock()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._changed = asyncio.Event()
        self._waking = False
        self._closed = False
        self._shared: tuple[int, int, tuple[Event, ...]] = (0, 0, ())
        self._beat: asyncio.TimerHandle | None = None

    def attach(self, loop: asyncio.AbstractEventLoop) -> None:
        """Name the event loop in which listeners wait; to be called in it."""
        self._loop = loop
        self._beat = loop.call_later(HEARTBEAT, self._wake)

    def publish(self, kind: EventKind, data: AnyData | str) -> None:
        """Tell all listeners; `data` are what `EventData` says of the kind, or are that as JSON in one line already."""
        if not isinstance(data, str):
            told = data.model_dump(mode="json")
            data = json.dumps(told, ensure_ascii=False, separators=(",", ":"), allow_nan=False)
        with self._lock:
            self._count += 1
            self._kept.append(Event(self._count, kind, data))
        self._wake_soon(TOGETHER)

    def close(self) -> None:
        """End all streams, so that nothing keeps the server from ending; harmless when repeated."""
        self._closed = True
        self._wake_soon(0.0)

    @property
    def count(self) -> int:
        """Events that were published so far."""
        return self._count

    def name(self, event: Event) -> str:
        """What a listener calls the event when it comes back, for `subscribe`."""
        return f"{self._run}-{event.number}"

    async def subscribe(self, after: str | None = None) -> AsyncIterator[tuple[Event, ...]]:
        """What happens from now on, or after the event of that name; nothing is a heartbeat.

        The first comes at once: what was missed, or nothing. Where the first event is a "reset", events were lost. The
        last event that was told is remembered by the listener, by its `name`. Listeners who are told the same are given
        the same object.
        """
        seen = self._count
        if after is not None:
            run, _, number = after.rpartition("-")
            known = run == self._run and number.isascii() and number.isdecimal() and int(number) <= self._count
            seen = int(number) if known else -1
        while not self._closed:
            changed = self._changed
            seen, told = self._since(seen)
            yield told
            await changed.wait()

    def _since(self, seen: int) -> tuple[int, tuple[Event, ...]]:
        """The number of the last event, and all events after the one of the number `seen`."""
        with self._lock:
            if self._shared[:2] != (seen, self._count):
                new = self._count - seen
                told: tuple[Event, ...] = (Event(self._count, "reset", "{}"),)
                if new <= len(self._kept):
                    told = tuple(islice(reversed(self._kept), new))[::-1]
                self._shared = seen, self._count, told
            return self._count, self._shared[2]

    def _wake_soon(self, seconds: float) -> None:
        """Let all listeners look after so many seconds, at once where there are none."""
        loop = self._loop
        with self._lock:
            if loop is None or loop.is_closed() or (self._waking and seconds):
                return
            self._waking = True
        loop.call_soon_threadsafe(loop.call_later, seconds, self._wake)

    def _wake(self) -> None:
        """Let all listeners look now; where nothing happens, again after a while, so that they see the stream lives."""
        with self._lock:
            self._waking = False
        self._changed.set()
        self._changed = asyncio.Event()
        if self._beat is not None:
            self._beat.cancel()
        assert self._loop is not None  # it is the one that runs this
        self._beat = self._loop.call_later(HEARTBEAT, self._wake)
