"""Modbus over TCP or over a serial line (RTU), opened by URL: one request, one reply, with its errors in our words.

On TCP every frame carries the number of its request. On a serial line a reply says only to which kind of request it
belongs, so that one that comes late or twice could pass for another. Therefore each exchange there is closed by a
number that the device cannot know and is asked to echo (Modbus function 8): a line keeps the order of what it
carries, so that a reply is the right one if it and the echo are all that arrived. After an exchange that failed the
line counts as out of step, and whatever arrives before the next such echo is dropped.
"""

import asyncio
import contextlib
import logging
import secrets
from collections.abc import Callable
from urllib.parse import urlsplit

from pymodbus.client import AsyncModbusSerialClient, AsyncModbusTcpClient
from pymodbus.exceptions import ConnectionException, ModbusException, ModbusIOException
from pymodbus.pdu import ModbusPDU
from pymodbus.pdu.diag_message import ReturnQueryDataRequest, ReturnQueryDataResponse
from pymodbus.pdu.register_message import ReadHoldingRegistersRequest, WriteMultipleRegistersRequest
from pymodbus.transport.serialtransport import SerialTransport

from drivers.errors import DeviceDisconnected, DeviceNotFound, DeviceRefused, DeviceTimeout, DriverError, ProtocolError
from drivers.serial_port import ATTEMPTS, OPEN_ERRORS, PORT_ERRORS

# what it logs as errors is raised here in our words; without a handler it would go to stderr as well
logging.getLogger("pymodbus.logging").addHandler(logging.NullHandler())

SILENCE, SILENT_CHARACTERS, BITS = 0.00175, 3.5, 11
"""Seconds, or characters of so many bits if that is longer, that separate two frames on a serial line ("Modbus over
serial line" specification, section 2.5.1.1)."""
PAUSES = (0.02, 0.04, 0.08, 0.16, 0.32)
"""Seconds for which late replies are awaited before each attempt to bring a serial line back into step."""
OVERTAKING = 0xFFFF
"""Number of a request that overtakes others; pymodbus itself counts to 65000 only."""
NO_GIVING_UP = 1_000_000_000
"""Failures in a row after which pymodbus would hang up by itself."""
ERROR = 0x80
"""Added to the function in a reply that is an exception."""

EXCEPTIONS = {
    1: "it does not know the function",
    2: "it does not have that register",
    3: "the value is not allowed",
    4: "it cannot do that in its present state",
    11: "nothing answers behind its gateway",
}
"""Modbus exception codes in words (Modbus application protocol, section 7)."""

log = logging.getLogger(__name__)


class ModbusLine:
    """The connection to one Modbus unit; it belongs to the event loop in which it was opened.

    `name` is the device's, for messages. `url` is `tcp://host:port`, `rtu:///dev/ttyUSB0`, `rtu://COM3`, or `rtu+`
    and any URL of pyserial, such as `rtu+socket://host:port` for a terminal server; pyserial's `hwgrep://` is taken
    as it is. `timeout` bounds the wait for a
    connection and for a reply, in seconds. `baudrate` and `parity` ("E", "O" or "N") are those of a serial line.
    Raises `ValueError` for a URL that is none of these.
    """

    def __init__(self, name: str, url: str, *, unit: int, timeout: float, baudrate: int, parity: str) -> None:
        self._name = name
        self._unit = unit
        self._timeout = timeout
        self._baudrate = baudrate
        self._parity = parity
        self._host, self._port = _address(name, url)
        self.address = f"{url} (unit {unit})"
        """Where the unit answers, for messages."""
        self._client: AsyncModbusTcpClient | AsyncModbusSerialClient | None = None
        self._turn = asyncio.Lock()
        self._in_step = False
        self._overtakings = 0
        self._arrived: list[bytes] = []
        """What pymodbus looked at since the last request, whole frames and their beginnings."""

    async def open(self) -> None:
        """Connect. Raises `DeviceNotFound`."""
        await self.close()
        self._turn = asyncio.Lock()
        self._in_step = False  # whoever used the line before may have left a reply behind
        self._client = client = self._new_client()
        client.set_max_no_responses(NO_GIVING_UP)
        reason = "nothing answers"
        try:
            connected = await client.connect()
        except OPEN_ERRORS as error:
            connected, reason = False, f"it cannot be opened ({error})"
        if not connected:
            await self.close()
            message = f"{self._name}: {reason} at {self.address}; check its power, its cable and the address"
            raise DeviceNotFound(message)

    async def close(self) -> None:
        """Disconnect; harmless when not connected."""
        client, self._client = self._client, None
        if client is None:
            return
        transport = client.ctx.transport
        with contextlib.suppress(*PORT_ERRORS):  # a line that is gone is closed
            client.close()
            if isinstance(transport, asyncio.WriteTransport):
                transport.abort()  # does not wait until a dead peer has taken the last bytes
        await asyncio.sleep(0)  # the loop closes a socket only when it comes round

    async def read(self, address: int, count: int) -> list[int]:
        """Return `count` registers from `address` on; asked again when the reply fails to come.

        Raises `DeviceRefused` with the device's own reason, `DeviceTimeout` when no reply comes in time,
        `ProtocolError` when only others come, `DeviceDisconnected` when the line is gone.
        """
        request = ReadHoldingRegistersRequest(address=address, count=count, dev_id=self._unit)
        reply = await self._ask(
            request,
            lambda reply: len(reply.registers) == count,
            f"reading register {address:#06x}",
            ATTEMPTS,
        )
        return list(reply.registers)

    async def write(self, address: int, words: list[int], *, attempts: int = 1, to_stop: bool = False) -> None:
        """Write registers from `address` on; raises as `read` does.

        More than one of `attempts` are for what may be done twice only. After `DeviceTimeout` and `ProtocolError` the
        registers may have been written or not. `DeviceRefused` also when `write_at_once` has overtaken it, but for what
        is written `to_stop`: two who stop at once both do.
        """
        request = self._write_request(address, words)
        await self._ask(
            request,
            lambda reply: (reply.address, reply.count) == (address, len(words)),
            f"writing register {address:#06x}",
            attempts,
            None if to_stop else self._overtakings,
        )

    def write_at_once(self, address: int, words: list[int]) -> None:
        """Put the request to write on the wire at once, even while another one waits for its reply.

        This is how a stop overtakes everything else: writes that were asked for before and are not on the wire yet
        never get there. Whether it arrived is not known: write again. Raises `DeviceDisconnected`.
        """
        self._overtakings += 1
        client = self._connected()
        request = self._write_request(address, words)
        request.transaction_id = OVERTAKING
        self._in_step = False  # its own reply will come when another one is expected
        transport = client.ctx.transport
        assert isinstance(transport, asyncio.WriteTransport)  # neither UDP nor a server
        transport.write(client.ctx.framer.buildFrame(request))
        if isinstance(transport, SerialTransport):
            transport.intern_write_ready()  # by itself it writes only when the loop comes round
        self._connected()

    def _new_client(self) -> AsyncModbusTcpClient | AsyncModbusSerialClient:
        # it neither repeats nor reconnects by itself: a trigger that is repeated could move a stage twice
        if self._port is not None:
            return AsyncModbusTcpClient(
                self._host, port=self._port, timeout=self._timeout, retries=0, reconnect_delay=0
            )
        return AsyncModbusSerialClient(
            self._host,
            baudrate=self._baudrate,
            parity=self._parity,
            timeout=self._timeout,
            retries=0,
            reconnect_delay=0,
            trace_packet=self._note,
        )

    def _note(self, is_sent: bool, data: bytes) -> bytes:
        if not is_sent:
            self._arrived.append(data)
        return data

    def _write_request(self, address: int, words: list[int]) -> ModbusPDU:
        return WriteMultipleRegistersRequest(address=address, registers=words, dev_id=self._unit)

    async def _ask(
        self,
        request: ModbusPDU,
        wanted: Callable[[ModbusPDU], bool],
        what: str,
        attempts: int,
        given_after: int | None = None,
    ) -> ModbusPDU:
        for attempt in range(1, attempts):
            try:
                return await self._converse(request, wanted, what, given_after)
            except (DeviceTimeout, ProtocolError) as error:
                log.warning("%s; trying again (attempt %d of %d)", error, attempt + 1, attempts)
        return await self._converse(request, wanted, what, given_after)

    async def _converse(
        self, request: ModbusPDU, wanted: Callable[[ModbusPDU], bool], what: str, given_after: int | None
    ) -> ModbusPDU:
        """Send `request` when its turn comes and return the reply, if that is `wanted`.

        A write was given after so many overtakings, and is dropped if there was another since.
        """
        async with self._turn:
            if self._port is None and not self._in_step:
                await self._bring_into_step()
            self._in_step = False
            self._arrived.clear()
            if given_after is not None and given_after != self._overtakings:
                raise DeviceRefused(f"{self._name}: was stopped before {what}; give the command again")
            reply = await self._exchange(request)
            if self._port is None:
                await self._close_exchange(reply, what)
            self._in_step = True
            if reply.function_code == request.function_code | ERROR:
                reason = EXCEPTIONS.get(reply.exception_code, f"exception {reply.exception_code}")
                raise DeviceRefused(f"{self._name}: refused {what}: {reason}")
            if reply.function_code != request.function_code or not wanted(reply):
                raise ProtocolError(f"{self._name}: answered {reply} to {what}; check that no one else uses its line")
            return reply

    async def _bring_into_step(self) -> None:
        """Drop what arrives until the device echoes a number that was made for this purpose."""
        for pause in PAUSES:
            await asyncio.sleep(pause)  # pymodbus drops what comes while nothing is asked
            number = secrets.token_bytes(2)
            reply = await self._echo(number)
            if _is_echo(reply, number):
                return
            log.warning("%s: answered %s where the echo of %s was expected; waiting", self._name, reply, number.hex())
        message = f"{self._name}: does not echo what is sent to it at {self.address}"
        raise ProtocolError(message + "; check the unit, and that no one else uses its line")

    async def _close_exchange(self, reply: ModbusPDU, what: str) -> None:
        """Raise `ProtocolError` unless `reply` and now an echo are all that arrived."""
        number = secrets.token_bytes(2)
        echo = await self._echo(number)
        build = self._connected().ctx.framer.buildFrame
        frames = [build(reply), build(echo)]
        arrived = [part for part in self._arrived if not any(_begins(part, frame) for frame in frames)]
        if not _is_echo(echo, number) or arrived != frames:
            shown = ", ".join(part.hex(" ") for part in arrived)
            message = f"{self._name}: more than one answer came to {what} ({shown})"
            raise ProtocolError(message + "; check that no one else uses its line")

    async def _echo(self, number: bytes) -> ModbusPDU:
        return await self._exchange(ReturnQueryDataRequest(number, dev_id=self._unit))

    async def _exchange(self, request: ModbusPDU) -> ModbusPDU:
        """Send `request` and return what arrives."""
        if self._port is None:
            await asyncio.sleep(max(SILENCE, SILENT_CHARACTERS * BITS / self._baudrate))
        try:
            reply: ModbusPDU = await self._connected().execute(False, request)
        except ModbusException as error:
            raise self._explain(error) from error
        if reply.transaction_id != request.transaction_id:
            raise ProtocolError(f"{self._name}: sent a reply without the number of its request; reopen the device")
        return reply

    def _connected(self) -> AsyncModbusTcpClient | AsyncModbusSerialClient:
        if self._client is None:
            raise DeviceDisconnected(f"{self._name}: is not open; open the device first")
        if not self._client.connected:
            raise self._lost()
        return self._client

    def _lost(self) -> DeviceDisconnected:
        message = f"{self._name}: the connection to {self.address} is lost"
        return DeviceDisconnected(message + "; check the cable, then reopen it")

    def _explain(self, error: ModbusException) -> DriverError:
        """A pymodbus exception in our words."""
        gone = self._client is None or not self._client.connected
        if gone or isinstance(error, ConnectionException):
            return self._lost()
        if isinstance(error, ModbusIOException):
            message = f"{self._name}: no whole answer from {self.address} within {self._timeout:g} s"
            return DeviceTimeout(message + "; check that the device is on")
        return ProtocolError(f"{self._name}: sent a malformed Modbus reply ({error}); reopen the device")


def _is_echo(reply: ModbusPDU, number: bytes) -> bool:
    return isinstance(reply, ReturnQueryDataResponse) and reply.message == number


def _begins(part: bytes, frame: bytes) -> bool:
    """Whether `part` is the beginning of `frame`, and not all of it."""
    return part != frame and frame.startswith(part)


def _address(name: str, url: str) -> tuple[str, int | None]:
    """Host and port of a Modbus TCP URL, or the serial port of an RTU one and None."""
    if url.startswith("rtu://") and url != "rtu://":
        return url.removeprefix("rtu://"), None
    if url.startswith(("rtu+", "hwgrep://")):
        return url.removeprefix("rtu+"), None
    try:
        parts = urlsplit(url)
        if parts.scheme == "tcp" and parts.hostname and parts.port:
            return parts.hostname, parts.port
    except ValueError:  # a port that is no number
        pass
    raise ValueError(f"{name}: {url!r} is no Modbus address; write it as tcp://host:port or rtu:///dev/ttyUSB0.")
