"""The wire end of simulated instruments: an event loop in a thread of its own, and a serial line on it.

The thread is what lets blocking clients (pyserial, a synchronous Modbus client) of any thread talk to a
simulator that lives in the same process.
"""

import asyncio
import contextlib
import os
import tempfile
import threading
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Coroutine
from pathlib import Path
from typing import Any, TypeVar

from simulators.devices.faults import Breakable, FaultScript, Kind, Line, Piece, duration, reaches_device, strike

T = TypeVar("T")


class LoopThread:
    """An event loop that runs in a thread of its own until it is closed."""

    def __init__(self, name: str) -> None:
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name=name, daemon=True)
        self._thread.start()

    def call(self, coroutine: Coroutine[Any, Any, T]) -> T:
        """Run `coroutine` on the loop and wait for what it returns or raises."""
        return asyncio.run_coroutine_threadsafe(coroutine, self._loop).result()

    def close(self) -> None:
        """End the loop and its thread."""
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()


class Listener(ABC):
    """A peer that listens on a local TCP port, from a thread of its own."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._thread: LoopThread | None = None
        self._port = 0

    @abstractmethod
    async def _listen(self) -> None:
        """Begin to listen on `_port`, on any free one where it is 0, and note it there."""

    @abstractmethod
    async def _hang_up(self) -> None:
        """Drop all connections and stop listening; harmless when not listening."""

    def _start(self) -> None:
        if self._thread is None:
            self._thread = LoopThread(self._name)
        self._thread.call(self._listen())

    def unplug(self) -> None:
        """Drop the connection and refuse new ones until `start`."""
        if self._thread is not None:
            self._thread.call(self._hang_up())

    def close(self) -> None:
        """End the connection and the thread; harmless when not started."""
        if self._thread is not None:
            self._thread.call(self._hang_up())
            self._thread.close()
            self._thread = None


def lines(data: bytes, terminator: bytes) -> tuple[list[bytes], bytes]:
    """The whole lines in `data`, without their terminators, and what is left of an unfinished one."""
    *whole, rest = data.split(terminator)
    return whole, rest


class ByteServer(Listener, Breakable):
    """An instrument on a serial line, served on a local TCP port and on a pseudo-terminal.

    A family of instruments inherits from it and fills in how its requests are told apart, how it answers one, and
    what the faults of devices mean to it. All that is called in the server's thread, one request after the other.
    """

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.script = FaultScript()
        """What befalls the requests from now on; may be replaced at any time."""
        self._tcp_wanted = False
        self._server: asyncio.Server | None = None
        self._terminal_folder: tempfile.TemporaryDirectory[str] | None = None
        self._terminal: _Terminal | None = None
        self._connections: set[_Connection] = set()
        self._replugging: asyncio.Task[None] | None = None
        self._stalled_until = 0.0

    @abstractmethod
    def split_requests(self, data: bytes) -> tuple[list[bytes], bytes]:
        """The whole requests in `data`, and the beginning of one that has not come to its end."""

    @abstractmethod
    def answer(self, request: bytes) -> bytes:
        """Act on one whole request and return the bytes to send back, none where it has no reply."""

    def start(self) -> str:
        """Begin to listen and return the URL, "socket://127.0.0.1:PORT"; the same one after an unplug."""
        self._tcp_wanted = True
        self._start()
        return f"socket://127.0.0.1:{self._port}"

    def start_pty(self) -> str:
        """Begin to listen on a pseudo-terminal and return its path; the same one after an unplug. POSIX only."""
        if self._terminal_folder is None:
            self._terminal_folder = tempfile.TemporaryDirectory(prefix="tty-")
        self._start()
        return str(self._terminal_path(self._terminal_folder))

    def close(self) -> None:
        """End all connections and the thread; harmless when not started."""
        super().close()
        if self._terminal_folder is not None:
            self._terminal_folder.cleanup()
            self._terminal_folder = None

    # what follows runs in the server's thread

    @staticmethod
    def _terminal_path(folder: "tempfile.TemporaryDirectory[str]") -> Path:
        return Path(folder.name, "tty")

    async def _listen(self) -> None:
        self._cancel_replugging()
        await self._plug_in()

    async def _hang_up(self) -> None:
        self._cancel_replugging()
        self._pull_out()
        await asyncio.sleep(0)

    async def _plug_in(self) -> None:
        if self._tcp_wanted and self._server is None:
            loop = asyncio.get_running_loop()
            self._server = await loop.create_server(lambda: _Socket(self), "127.0.0.1", self._port)
            self._port = self._server.sockets[0].getsockname()[1]
        if self._terminal_folder is not None and self._terminal is None:
            self._terminal = _Terminal(self, self._terminal_path(self._terminal_folder))

    def _pull_out(self) -> None:
        if self._server is not None:
            self._server.close()
            self._server = None
        for connection in list(self._connections):
            connection.cut()
        self._terminal = None

    def _unplug_for(self, seconds: float) -> None:
        async def replug() -> None:
            await asyncio.sleep(seconds)
            await self._plug_in()

        self._cancel_replugging()
        self._pull_out()
        self._replugging = asyncio.get_running_loop().create_task(replug())

    def _cancel_replugging(self) -> None:
        if self._replugging is not None:
            self._replugging.cancel()
            self._replugging = None

    def _serve(self, request: bytes, connection: "_Connection") -> None:
        """Let the script befall a request and its reply."""
        script = self.script
        faults = script.due()
        strike(self, faults)
        now = asyncio.get_running_loop().time()
        self._stalled_until = max(self._stalled_until, now + duration(Kind.STALL, faults))
        reply = self.answer(request) if reaches_device(faults) and now >= self._stalled_until else b""
        connection.send(connection.line.carry(faults, reply, script.random))
        unplugged = duration(Kind.UNPLUG, faults)
        if unplugged:
            self._unplug_for(unplugged)


class _Connection(ABC):
    """One client of a `ByteServer`; what goes back to it keeps its order."""

    def __init__(self, server: ByteServer) -> None:
        self.line = Line()
        self._server = server
        self._unfinished = b""
        self._waiting: deque[Piece] = deque()
        self._timer: asyncio.TimerHandle | None = None
        self._is_cut = False

    @abstractmethod
    def write(self, data: bytes) -> None:
        """Send `data` back at once."""

    @abstractmethod
    def hang_up(self) -> None:
        """End the connection without sending anything more."""

    def begin(self) -> None:
        """Count among the server's connections."""
        self._server._connections.add(self)

    def cut(self) -> None:
        """End the connection; what waits to be sent is lost. Harmless when it has ended."""
        self._is_cut = True
        self._server._connections.discard(self)
        self._waiting.clear()
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        self.hang_up()

    def receive(self, data: bytes) -> None:
        """Serve the requests that `data` completes."""
        requests, self._unfinished = self._server.split_requests(self._unfinished + data)
        for request in requests:
            if not self._is_cut:
                self._server._serve(request, self)

    def send(self, pieces: list[Piece]) -> None:
        """Send `pieces` after all that waits already."""
        self._waiting.extend(pieces)
        if self._timer is None:
            self._send_waiting()

    def _send_waiting(self) -> None:
        self._timer = None
        while self._waiting:
            piece = self._waiting.popleft()
            if piece.after:
                self._waiting.appendleft(Piece(piece.data))
                self._timer = asyncio.get_running_loop().call_later(piece.after, self._send_waiting)
                return
            self.write(piece.data)


class _Socket(_Connection, asyncio.Protocol):
    """A client on TCP."""

    _transport: asyncio.Transport

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        self.begin()

    def connection_lost(self, exc: Exception | None) -> None:
        self.cut()

    def data_received(self, data: bytes) -> None:
        self.receive(data)

    def write(self, data: bytes) -> None:
        self._transport.write(data)

    def hang_up(self) -> None:
        self._transport.abort()


class _Terminal(_Connection):
    """A client on a pseudo-terminal, at a path that stays the same, as the links to USB adapters by name do."""

    def __init__(self, server: ByteServer, path: Path) -> None:
        import tty  # noqa: PLC0415 - not on Windows

        super().__init__(server)
        # the end that clients open is kept open here, too, or ours would fail to read while there is none
        self._ours, self._theirs = os.openpty()
        tty.setraw(self._theirs)
        os.set_blocking(self._ours, False)
        self._path = path
        path.symlink_to(os.ttyname(self._theirs))
        asyncio.get_running_loop().add_reader(self._ours, self._read)
        self.begin()

    def write(self, data: bytes) -> None:
        with contextlib.suppress(BlockingIOError):  # nobody reads, and the buffer overflows as a UART's does
            os.write(self._ours, data)

    def hang_up(self) -> None:
        asyncio.get_running_loop().remove_reader(self._ours)
        self._path.unlink(missing_ok=True)
        os.close(self._theirs)
        os.close(self._ours)

    def _read(self) -> None:
        self.receive(os.read(self._ours, 4096))
