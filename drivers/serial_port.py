"""A serial line opened by URL, read in lines, with its errors in our words.

The URL is whatever pyserial takes: `/dev/ttyUSB0`, `COM3`, `socket://host:port`.
"""

import contextlib

import serial

from drivers.device_thread import DeviceThread
from drivers.errors import DeviceDisconnected, DeviceNotFound, DeviceTimeout

try:
    import termios

    # a tty that was unplugged raises this from pyserial, and it is no OSError
    PORT_ERRORS: tuple[type[Exception], ...] = (OSError, termios.error)
except ImportError:  # Windows has no termios
    PORT_ERRORS = (OSError,)
# ValueError: pyserial does not know the kind of URL
OPEN_ERRORS: tuple[type[Exception], ...] = (ValueError, *PORT_ERRORS)


class SerialPort:
    """One line and the thread that waits on it.

    `name` is the device's, for messages; `timeout` bounds each write and each reply, in seconds.
    """

    def __init__(self, name: str, url: str, *, baudrate: int, timeout: float, terminator: bytes) -> None:
        self._name = name
        self._url = url
        self._baudrate = baudrate
        self._timeout = timeout
        self._terminator = terminator
        self._thread = DeviceThread(name)
        self._port: serial.Serial | None = None

    async def open(self) -> None:
        """Open the line, 8N1. Raises `DeviceNotFound`."""
        await self._thread.run(self._open)

    async def close(self) -> None:
        """Close the line; harmless when it is closed or gone."""
        await self._thread.finish(self._close)

    async def ask(self, request: bytes) -> bytes:
        """Send `request` and return the next line without its terminator.

        Raises `DeviceTimeout` when no whole line comes in time and `DeviceDisconnected` when the line is gone.
        """
        return await self._thread.run(self._ask, request)

    async def send(self, command: bytes) -> None:
        """Send `command`, which has no reply. Raises as `ask` does."""
        await self._thread.run(self._exchange, command, False)

    def _open(self) -> None:
        self._close()
        try:
            self._port = serial.serial_for_url(
                self._url,
                baudrate=self._baudrate,
                timeout=self._timeout,
                write_timeout=self._timeout,
                exclusive=True,
            )
        except OPEN_ERRORS as error:
            message = f"{self._name}: cannot open {self._url} ({error}); check its power, its cable and the address"
            raise DeviceNotFound(message) from error

    def _close(self) -> None:
        port, self._port = self._port, None
        if port is not None:
            with contextlib.suppress(*PORT_ERRORS):  # a line that is gone is closed
                port.close()

    def _ask(self, request: bytes) -> bytes:
        line = self._exchange(request, True)
        if not line.endswith(self._terminator):
            message = f"{self._name}: no whole reply to {request!r} within {self._timeout:g} s, only {line!r}"
            raise DeviceTimeout(message + f"; check that the device at {self._url} is on")
        return line.removesuffix(self._terminator)

    def _exchange(self, request: bytes, with_reply: bool) -> bytes:
        if self._port is None:
            raise DeviceDisconnected(f"{self._name}: {self._url} is not open; open the device first")
        try:
            # a late reply to a request that timed out must not answer this one
            self._port.reset_input_buffer()
            self._port.write(request)
            return bytes(self._port.read_until(self._terminator)) if with_reply else b""
        except serial.SerialTimeoutException as error:
            raise DeviceTimeout(f"{self._name}: {self._url} took no bytes for {self._timeout:g} s") from error
        except PORT_ERRORS as error:
            message = f"{self._name}: the connection to {self._url} is lost ({error}); check the cable, then reopen it"
            raise DeviceDisconnected(message) from error
