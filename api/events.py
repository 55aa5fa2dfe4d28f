"""What happens on the bench and around it, as a stream that any number of listeners follow.

Whoever publishes never waits: the last events are kept, and a listener that falls behind them, or that names one which
is not known any more, is told `reset` and reads everything anew.
"""

import asyncio
import json
import secrets
import threading
from collections import deque
from collections.abc import AsyncIterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

EventKind = Literal["state", "progress", "point", "spectrum", "queue", "mount", "job", "alarm", "log", "reset"]
"""What an event is about; "reset" says that some were missed."""

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
    """Its data as JSON in one line."""


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

    def attach(self, loop: asyncio.AbstractEventLoop) -> None:
        """Name the event loop in which listeners wait."""
        self._loop = loop

    def publish(self, kind: EventKind, data: Mapping[str, Any]) -> None:
        """Tell all listeners; `data` must be what JSON can say."""
        text = json.dumps(data, ensure_ascii=False, separators=(",", ":"), allow_nan=False)
        with self._lock:
            self._count += 1
            self._kept.append(Event(self._count, kind, text))
        self._wake_soon()

    def close(self) -> None:
        """End all streams, so that nothing keeps the server from ending; harmless when repeated."""
        self._closed = True
        self._wake_soon()

    @property
    def count(self) -> int:
        """Events that were published so far."""
        return self._count

    def name(self, event: Event) -> str:
        """What a listener calls the event when it comes back, for `subscribe`."""
        return f"{self._run}-{event.number}"

    async def subscribe(self, after: str | None = None) -> AsyncIterator[list[Event]]:
        """What happens from now on, or after the event of that name; an empty list is a heartbeat.

        The first list comes at once: what was missed, or nothing. One whose first event is a "reset" says that events
        were lost. The last event that was told is remembered by the listener, by its `name`.
        """
        seen = self._count
        if after is not None:
            run, _, number = after.rpartition("-")
            known = run == self._run and number.isascii() and number.isdecimal() and int(number) <= self._count
            seen = int(number) if known else -1
        first = True
        while not self._closed:
            changed = self._changed
            with self._lock:
                oldest = self._kept[0].number if self._kept else self._count + 1
                lost = seen < oldest - 1
                told = [event for event in self._kept if event.number > seen] if not lost else []
                if lost:
                    told = [Event(self._count, "reset", "{}")]
                seen = self._count
            if told or first:
                first = False
                yield told
                continue
            try:
                await asyncio.wait_for(changed.wait(), HEARTBEAT)
            except TimeoutError:
                yield []
            else:
                await asyncio.sleep(TOGETHER)

    def _wake_soon(self) -> None:
        loop = self._loop
        with self._lock:
            if loop is None or loop.is_closed() or self._waking:
                return
            self._waking = True
        loop.call_soon_threadsafe(self._wake)

    def _wake(self) -> None:
        with self._lock:
            self._waking = False
            self._changed.set()
            self._changed = asyncio.Event()
