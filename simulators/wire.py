"""The wire end of simulated instruments: an event loop in a thread of its own, and a byte server on it.

The thread is what lets blocking clients (pyserial, a synchronous Modbus client) of any thread talk to a
simulator that lives in the same process.
"""

import asyncio
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Coroutine
from dataclasses import dataclass
from typing import Any, TypeVar

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


@dataclass
class WireFaults:
    """What a bad line does to replies; changed while the simulator runs."""

    silent: bool = False
    """Nothing comes back."""
    corrupt: bool = False
    """The highest bit of every byte but CR and LF is flipped."""
    split: bool = False
    """Replies arrive byte by byte."""
    late: float = 0.0
    """Real seconds by which replies are delayed: a client's own timeout is real, too."""


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


class ByteServer(Listener):
    """Serves one instrument's serial line on a local TCP port.

    `answer(data)` gets the bytes as they arrive, in any portions, and returns the bytes to send back; it is
    called in the server's thread.
    """

    def __init__(self, name: str, answer: Callable[[bytes], bytes]) -> None:
        super().__init__(name)
        self.faults = WireFaults()
        self._answer = answer
        self._server: asyncio.Server | None = None
        self._transports: set[asyncio.Transport] = set()

    def start(self) -> str:
        """Begin to listen and return the URL, "socket://127.0.0.1:PORT"; the same one after an unplug."""
        self._start()
        return f"socket://127.0.0.1:{self._port}"

    async def _listen(self) -> None:
        loop = asyncio.get_running_loop()
        self._server = await loop.create_server(lambda: _Connection(self), "127.0.0.1", self._port)
        self._port = self._server.sockets[0].getsockname()[1]

    async def _hang_up(self) -> None:
        if self._server is not None:
            self._server.close()
        for transport in list(self._transports):
            transport.abort()
        await asyncio.sleep(0)

    async def _send_badly(self, transport: asyncio.Transport, reply: bytes) -> None:
        await asyncio.sleep(self.faults.late)
        for byte in reply:
            transport.write(bytes([byte]))
            await asyncio.sleep(0.0005 * self.faults.split)


class _Connection(asyncio.Protocol):
    """One client of a `ByteServer`."""

    def __init__(self, server: ByteServer) -> None:
        self._server = server
        self._tasks: set[asyncio.Task[None]] = set()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        self._server._transports.add(transport)

    def connection_lost(self, exc: Exception | None) -> None:
        self._server._transports.discard(self._transport)

    def data_received(self, data: bytes) -> None:
        reply = self._server._answer(data)
        faults = self._server.faults
        if faults.silent or not reply:
            return
        if faults.corrupt:
            reply = bytes(byte if byte in b"\r\n" else byte ^ 0x80 for byte in reply)
        if faults.split or faults.late:
            task = asyncio.ensure_future(self._server._send_badly(self._transport, reply))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)
        else:
            self._transport.write(reply)
