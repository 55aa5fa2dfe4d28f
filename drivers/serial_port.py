"""A serial line opened by URL: one request, one reply, with its errors in our words.

The URL is whatever pyserial takes: `/dev/ttyUSB0`, `COM3`, `socket://host:port`.

A line keeps the order of what it carries but not its content or its timing. So a reply is taken only when it has
the form that the request calls for, and after a reply that failed to come the line counts as out of step: a query
whose answer cannot be mistaken is sent first, and whatever arrives before that answer belongs to the past.
"""

import contextlib
import logging
import socket
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

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


class SerialPort:
    """One line and the thread that waits on it.

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
        self._thread = DeviceThread(name)
        self._port: serial.Serial | None = None
        self._writing = threading.Lock()
        self._overtakings = 0
        self._in_step = True

    async def open(self) -> None:
        """Open the line with eight data bits, no parity and one stop bit. Raises `DeviceNotFound`."""
        await self._thread.run(self._open)

    async def close(self) -> None:
        """Close the line; harmless when it is closed or gone."""
        await self._thread.finish(self._close)

    async def ask(self, query: Query, attempts: int = ATTEMPTS) -> bytes:
        """Send `query` and return its reply, whole as it came.

        A request that does more than ask must not be repeated: it gets one of `attempts`. Raises `DeviceTimeout`
        when no reply comes in time, `ProtocolError` when only others come, `DeviceDisconnected` when the line is
        gone, and `DeviceRefused` for a request with one attempt that `send_now` has overtaken.
        """
        if attempts == 1:
            return await self._thread.run(self._converse, query, self._overtakings)
        for attempt in range(1, attempts):
            try:
                return await self._thread.run(self._converse, query)
            except (DeviceTimeout, ProtocolError) as error:
                log.warning("%s; asking again (attempt %d of %d)", error, attempt + 1, attempts)
        return await self._thread.run(self._converse, query)

    async def send(self, command: bytes) -> None:
        """Send `command`, which has no reply, after what waits already. Raises as `ask` does."""
        await self._thread.run(self._write, command, self._overtakings)

    def send_now(self, command: bytes) -> None:
        """Put `command`, which has no reply, on the wire at once, even while an exchange waits for its own reply.

        This is how a stop overtakes everything else: commands that were given before and are not on the wire yet
        never get there. Raises as `ask` does.
        """
        self._overtakings += 1
        self._write(command)

    # what follows blocks and, but for a write at once, runs in the device's thread

    def _open(self) -> None:
        self._close()
        try:
            self._port = serial.serial_for_url(
                self._url,
                baudrate=self._baudrate,
                timeout=min(SLICE, self._timeout),
                write_timeout=self._timeout,
                rtscts=self._rtscts,
                exclusive=True,
            )
            if self._url.startswith("socket://"):
                _send_at_once(self._port)
        except OPEN_ERRORS as error:
            message = f"{self._name}: cannot open {self._url} ({error}); check its power, its cable and the address"
            raise DeviceNotFound(message) from error
        self._in_step = False  # whoever used the line before may have left a reply behind

    def _close(self) -> None:
        port, self._port = self._port, None
        if port is not None:
            with contextlib.suppress(*PORT_ERRORS):  # a line that is gone is closed
                port.close()

    def _opened(self) -> serial.Serial:
        port = self._port
        if port is None:
            raise DeviceDisconnected(f"{self._name}: {self._url} is not open; open the device first")
        return port

    def _lost(self, error: Exception) -> DeviceDisconnected:
        message = f"{self._name}: the connection to {self._url} is lost ({error}); check the cable, then reopen it"
        return DeviceDisconnected(message)

    def _write(self, data: bytes, given_after: int | None = None) -> None:
        """Write `data`; a command was given after so many overtakings, and is dropped if there was another since."""
        port = self._opened()
        try:
            with self._writing:
                if given_after is not None and given_after != self._overtakings:
                    raise DeviceRefused(f"{self._name}: was stopped before {data!r} was sent; give the command again")
                port.write(data)
        except serial.SerialTimeoutException as error:
            raise DeviceTimeout(f"{self._name}: {self._url} took no bytes for {self._timeout:g} s") from error
        except PORT_ERRORS as error:
            raise self._lost(error) from error

    def _converse(self, query: Query, given_after: int | None = None) -> bytes:
        if not self._in_step:
            self._exchange(self._unmistakable)
        self._in_step = False
        reply = self._exchange(query, given_after)
        self._in_step = True
        return reply

    def _exchange(self, query: Query, given_after: int | None = None) -> bytes:
        """Send a query and return the first reply that answers it; others that come before are dropped."""
        port = self._opened()
        try:
            port.reset_input_buffer()
        except PORT_ERRORS as error:
            raise self._lost(error) from error
        self._write(query.request, given_after)
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
                    raise self._lost(error) from error
        if dropped:
            raise ProtocolError(
                f"{self._name}: {dropped!r} is no answer to {query.request!r}; check that this is the right device"
            )
        message = f"{self._name}: no whole reply to {query.request!r} within {self._timeout:g} s, only {reply!r}"
        raise DeviceTimeout(message + f"; check that the device at {self._url} is on")
