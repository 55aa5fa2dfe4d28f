"""A serial line opened by URL: one request, one reply, with its errors in our words.

The URL is whatever pyserial takes: `/dev/ttyUSB0`, `COM3`, `socket://host:port`.

A line keeps the order of what it carries but not its content or its timing. So a reply is taken only when it has
the form that the request calls for, and after a reply that failed to come the line counts as out of step: a query
whose answer cannot be mistaken is sent first, and whatever arrives before that answer belongs to the past.
"""

import asyncio
import contextlib
import logging
import os
import socket
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import serial

from drivers.device_thread import DeviceThread
from drivers.errors import DeviceDisconnected, DeviceNotFound, DeviceRefused, DeviceTimeout, ProtocolError

try:
    import termios

    # a tty that was unplugged raises this from pyserial, and it is no OSError
    PORT_ERRORS: tuple[type[Exception], ...] = (OSError, termios.error)
except ImportError:  # Windows has no termios
    PORT_ERRORS = (OSError,)
# ValueError: pyserial does not know the kind of URL
OPEN_ERRORS: tuple[type[Exception], ...] = (ValueError, *PORT_ERRORS)

ATTEMPTS = 3
"""How often a query is sent before its failure is raised; commands are sent once."""
SLICE = 0.05
"""Seconds that a single read may block, so that a device that trickles bytes cannot stretch the timeout."""
LONGEST_FRAME = 4096
"""Bytes after which something that never ends is no reply."""

log = logging.getLogger(__name__)

Missing = Callable[[bytes], int]
"""How many bytes a reply still lacks that begins with these; 0 when it is whole. Raises `ProtocolError`.

Less than 0 when no reply begins like this: the first byte is then dropped, and the rest tried.
"""


@dataclass(frozen=True)
class Query:
    """A request, and how to tell its reply from any other."""

    request: bytes
    """The bytes to send."""
    wanted: Callable[[bytes], bool]
    """Whether a whole reply, as it came, answers `request`."""


def line(terminator: bytes) -> Missing:
    """Replies that end with `terminator`."""
    return lambda data: 0 if data.endswith(terminator) else 1


def _send_at_once(port: serial.Serial) -> None:
    """Let a terminal server have each request at once.

    By itself TCP holds a request back until the one before is acknowledged, for which a command without a reply makes
    it wait 40 ms.
    """
    with socket.fromfd(port.fileno(), socket.AF_INET, socket.SOCK_STREAM) as same:
        same.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)


@dataclass
class _Line:
    """An open line, and all that its devices share: several controllers, or axes of one, may hang on it."""

    thread: DeviceThread
    """Does what blocks, for one device after the other."""
    baudrate: int
    writing: threading.Lock = field(default_factory=threading.Lock)
    port: serial.Serial | None = None
    users: int = 0
    in_step: bool = True
    is_lost: bool = False
    """Whether who opens the line opens the port anew: it failed, or nothing has come from it since a reply was missed.

    A hub or a terminal server that hangs shows no other sign, and one that shares the line may hold the port open.
    """
    turn: asyncio.Lock = field(default_factory=asyncio.Lock)
    """For questions that protect each other by their order."""

    def close(self) -> None:
        """Close the port, not in the middle of a write."""
        with self.writing:
            port, self.port = self.port, None
        if port is not None:
            with contextlib.suppress(*PORT_ERRORS):  # a line that is gone is closed
                port.close()


_LINES: dict[str, _Line] = {}
"""The open lines of this process by their URL: the operating system gives a port away only once."""


class SerialPort:
    """The line to one device, which several devices may share.

    `name` is the device's, for messages; `timeout` bounds each write and each reply, in seconds; `missing` tells
    where a reply ends; `unmistakable` is the query that brings a line back into step.
    """

    def __init__(
        self,
        name: str,
        url: str,
        *,
        baudrate: int,
        timeout: float,
        missing: Missing,
        unmistakable: Query,
        rtscts: bool = False,
    ) -> None:
        self._name = name
        self._url = url
        self._baudrate = baudrate
        self._timeout = timeout
        self._missing = missing
        self._unmistakable = unmistakable
        self._rtscts = rtscts
        self._line: _Line | None = None
        self._overtakings = 0

    async def open(self) -> None:
        """Open the line with eight data bits, no parity and one stop bit, or join those that have it open.

        Raises `DeviceNotFound`.
        """
        await self.close()
        line = self._line = _LINES.setdefault(self._url, _Line(DeviceThread(self._name), self._baudrate))
        line.users += 1
        async with contextlib.AsyncExitStack() as on_failure:  # a cancellation is one, too
            on_failure.push_async_callback(self.close)
            if line.baudrate != self._baudrate:
                raise DeviceNotFound(
                    f"{self._name}: {self._url} is open at {line.baudrate} Bd for another device; "
                    f"give both the same baud rate, or a line each"
                )
            await line.thread.run(self._open, line)
            on_failure.pop_all()

    async def close(self) -> None:
        """Leave the line, and close it when nobody uses it any more; harmless when it is closed or gone."""
        line, self._line = self._line, None
        if line is None:
            return
        line.users -= 1
        if line.users == 0:
            if _LINES.get(self._url) is line:
                del _LINES[self._url]
            await line.thread.finish(line.close)

    async def ask(self, query: Query, attempts: int = ATTEMPTS) -> bytes:
        """Send `query` and return its reply, whole as it came.

        A request that does more than ask must not be repeated: it gets one of `attempts`. Raises `DeviceTimeout`
        when no reply comes in time, `ProtocolError` when only others come, `DeviceDisconnected` when the line is
        gone, and `DeviceRefused` for a request with one attempt that `send_now` has overtaken.
        """
        line = self._joined()
        if attempts == 1:
            return await line.thread.run(self._converse, line, query, self._overtakings)
        for attempt in range(1, attempts):
            try:
                return await line.thread.run(self._converse, line, query)
            except (DeviceTimeout, ProtocolError) as error:
                log.warning("%s; asking again (attempt %d of %d)", error, attempt + 1, attempts)
        return await line.thread.run(self._converse, line, query)

    async def send(self, command: bytes, *, to_stop: bool = False) -> None:
        """Send `command`, which has no reply, after what waits already.

        Raises as `ask` does, but no `DeviceRefused` for what is sent `to_stop`: two who stop at once both do.
        """
        line = self._joined()
        await line.thread.run(self._write, line, command, None if to_stop else self._overtakings)

    def send_now(self, command: bytes) -> None:
        """Put `command`, which has no reply, on the wire at once, even while an exchange waits for its own reply.

        This is how a stop overtakes everything else: commands that were given before and are not on the wire yet
        never get there. Raises as `ask` does.
        """
        self._overtakings += 1
        self._write(self._joined(), command)

    @property
    def turn(self) -> asyncio.Lock:
        """To be held for questions that protect each other by their order; all devices on the line have the same one.

        Raises `DeviceDisconnected` when the line is not open.
        """
        return self._joined().turn

    def _joined(self) -> _Line:
        if self._line is None:
            raise self._not_open()
        return self._line

    def _not_open(self) -> DeviceDisconnected:
        return DeviceDisconnected(f"{self._name}: {self._url} is not open; open the device first")

    # what follows blocks and, but for a write at once, runs in the line's thread

    def _open(self, line: _Line) -> None:
        line.in_step = False  # whoever used the line before may have left a reply behind
        if line.port is not None and not line.is_lost:
            return
        line.close()
        try:
            line.port = serial.serial_for_url(
                self._url,
                baudrate=self._baudrate,
                timeout=min(SLICE, self._timeout),
                write_timeout=self._timeout,
                rtscts=self._rtscts,
                exclusive=True,
            )
            if self._url.startswith("socket://"):
                _send_at_once(line.port)
        except OPEN_ERRORS as error:
            reason = os.strerror(error.errno) if isinstance(error, OSError) and error.errno else error
            message = f"{self._name}: cannot open {self._url} ({reason}); check its power, its cable and the address"
            raise DeviceNotFound(message) from error
        line.is_lost = False

    def _lost(self, line: _Line, error: Exception) -> DeviceDisconnected:
        line.is_lost = True
        message = f"{self._name}: the connection to {self._url} is lost ({error}); check the cable, then reopen it"
        return DeviceDisconnected(message)

    def _write(self, line: _Line, data: bytes, given_after: int | None = None) -> None:
        """Write `data`; a command was given after so many overtakings, and is dropped if there was another since."""
        try:
            with line.writing:
                if line.port is None:
                    raise self._not_open()
                if given_after is not None and given_after != self._overtakings:
                    raise DeviceRefused(f"{self._name}: was stopped before {data!r} was sent; give the command again")
                line.port.write(data)
        except serial.SerialTimeoutException as error:
            raise DeviceTimeout(f"{self._name}: {self._url} took no bytes for {self._timeout:g} s") from error
        except PORT_ERRORS as error:
            raise self._lost(line, error) from error

    def _converse(self, line: _Line, query: Query, given_after: int | None = None) -> bytes:
        if not line.in_step:
            self._exchange(line, self._unmistakable)
        line.in_step = False
        reply = self._exchange(line, query, given_after)
        line.in_step, line.is_lost = True, False
        return reply

    def _exchange(self, line: _Line, query: Query, given_after: int | None = None) -> bytes:
        """Send a query and return the first reply that answers it; others that come before are dropped."""
        port = line.port
        if port is None:
            raise self._not_open()
        try:
            port.reset_input_buffer()
        except PORT_ERRORS as error:
            raise self._lost(line, error) from error
        self._write(line, query.request, given_after)
        deadline = time.monotonic() + self._timeout
        reply, dropped = b"", b""
        while True:
            missing = self._missing(reply)
            if missing == 0:
                if query.wanted(reply):
                    return reply
                reply, dropped = b"", reply
            elif missing < 0:
                reply, dropped = reply[1:], reply
            elif time.monotonic() > deadline:
                break
            elif len(reply) + missing > LONGEST_FRAME:
                raise ProtocolError(f"{self._name}: sent {LONGEST_FRAME} bytes without an end; check the baud rate")
            else:
                try:
                    reply += port.read(missing)
                except PORT_ERRORS as error:
                    raise self._lost(line, error) from error
        if dropped:
            raise ProtocolError(
                f"{self._name}: {dropped!r} is no answer to {query.request!r}; check that this is the right device"
            )
        line.is_lost = True
        message = f"{self._name}: no whole reply to {query.request!r} within {self._timeout:g} s, only {reply!r}"
        raise DeviceTimeout(message + f"; check that the device at {self._url} is on")
