"""Requests and replies of the Ocean Binary Protocol over USB; every call blocks, for a bounded time.

What comes is taken as a stream of bytes: a reply may arrive in pieces or together with the next one, behind the rest
of a torn one, or long after it was given up. A reply counts only when its message type and the number that the
request carried are right. After a failure everything that is under way is read and thrown away before the next
request.
"""

import errno
import logging
import random
from typing import Any

import usb.core
import usb.util

from drivers.errors import (
    DeviceDisconnected,
    DeviceFault,
    DeviceNotFound,
    DeviceRefused,
    DeviceTimeout,
    DriverError,
    ProtocolError,
)
from drivers.obp import (
    ACK,
    ACK_REQUESTED,
    DEFERRED,
    ERRORS,
    HARDWARE_EXCEPTION,
    HEADER,
    INTERNAL_ERROR,
    NACK,
    RESPONSE,
    START,
    Message,
    decode,
    encode,
    total_length,
)

ENDPOINT_OUT, ENDPOINT_IN = 0x01, 0x81
ATTEMPTS = 3
"""How often a query is sent before its failure is raised; commands are sent once."""
FOREIGN_REPLIES = 8
"""Replies to earlier requests that are skipped before the device is said to be confused."""
READS = 64
"""Reads after which a message that is still not whole never will be."""
DRAIN_TIMEOUT = 0.02
"""Seconds of silence after which nothing more is on its way."""
DRAIN_SIZE = 8192
"""Bytes that are thrown away at a time; whole packets."""
DRAIN_READS = 32
"""Reads after which a device that never falls silent is given up."""
BROKEN_TRANSFER = {errno.EIO, errno.EPIPE, errno.EILSEQ, getattr(errno, "EPROTO", errno.EIO)}
"""What the system says when the bus, and not the device, spoiled a transfer."""

log = logging.getLogger(__name__)


class UsbLink:
    """An opened device. `name` is for messages; `timeout` bounds each transfer, in seconds.

    All methods but `close` raise `DriverError`.
    """

    def __init__(self, name: str, device: Any, timeout: float) -> None:
        """Open `device` (a `usb.core.Device`). Raises `DeviceNotFound` when the system does not let us."""
        self._name = name
        self._device = device
        self._timeout = timeout
        # another program, or this one before, may have left a request behind whose reply is still to come
        self._last_request = random.SystemRandom().randrange(1, 1 << 31)
        self._received = b""
        self._in_step = False
        """Whether nothing is known to be under way but what was asked for."""
        try:
            device.set_configuration()
            interface = device.get_active_configuration()[(0, 0)]
            usb.util.claim_interface(device, interface)
        except usb.core.USBError as error:
            usb.util.dispose_resources(device)
            message = f"{name}: is plugged in but cannot be opened ({error.strerror})"
            message += "; close other programs that use it and check that you may access USB devices"
            raise DeviceNotFound(message) from error
        endpoint = usb.util.find_descriptor(interface, bEndpointAddress=ENDPOINT_IN)
        if endpoint is None:
            usb.util.dispose_resources(device)
            raise DeviceNotFound(f"{name}: has no USB endpoint {ENDPOINT_IN:#04x}; is it really this model?")
        self._packet_size = int(endpoint.wMaxPacketSize)

    def close(self) -> None:
        """Give the device back; harmless when it is gone."""
        usb.util.dispose_resources(self._device)

    def ask(self, message_type: int, payload: bytes = b"") -> bytes:
        """Send a query and return the payload of its reply; asks again when it does not come or is malformed.

        Raises `DeviceRefused`, `DeviceFault`, `DeviceDisconnected`; `DeviceTimeout` and `ProtocolError` when that
        happens on every attempt.
        """
        for attempt in range(2, ATTEMPTS + 1):
            try:
                return self.receive(self.send(message_type, payload)).payload
            except (DeviceTimeout, ProtocolError) as error:
                log.warning("%s; asking again (attempt %d of %d)", error, attempt, ATTEMPTS)
        return self.receive(self.send(message_type, payload)).payload

    def command(self, message_type: int, payload: bytes = b"") -> None:
        """Send a setting once and wait until it is acknowledged.

        Raises as `ask` does; after `DeviceTimeout` and `ProtocolError` the device may have obeyed or not.
        """
        reply = self.receive(self.send(message_type, payload, flags=ACK_REQUESTED))
        if not reply.flags & ACK:
            raise ProtocolError(f"{self._name}: did not acknowledge message {message_type:#010x}; reopen the device")

    def send(self, message_type: int, payload: bytes = b"", flags: int = 0) -> Message:
        """Send a request, for whose reply `receive` waits."""
        if not self._in_step:
            self._drain()
        self._last_request = self._last_request % 0xFFFFFFFF + 1
        request = Message(message_type, regarding=self._last_request, flags=flags, payload=payload)
        data = encode(request)
        try:
            written = self._device.write(ENDPOINT_OUT, data, self._milliseconds())
        except usb.core.USBError as error:
            raise self._explain(error) from error
        if written != len(data):
            raise ProtocolError(f"{self._name}: took {written} of {len(data)} bytes; unplug it and plug it in again")
        return request

    def receive(self, request: Message) -> Message:
        """The reply to `request`; replies to earlier requests, which nobody waits for any more, are skipped.

        Raises `DeviceRefused` or `DeviceFault` when the reply says so, `ProtocolError` when it is malformed.
        """
        for _ in range(FOREIGN_REPLIES):
            reply = self._next_message()
            if reply.regarding != request.regarding:
                log.info("%s: dropped a reply to an earlier request (%#010x)", self._name, reply.message_type)
                continue
            if reply.error == DEFERRED:
                continue
            self._check(request, reply)
            return reply
        self._in_step = False
        message = f"{self._name}: answered {FOREIGN_REPLIES} other requests instead of {request.message_type:#010x}"
        raise ProtocolError(message + "; reopen the device")

    def _check(self, request: Message, reply: Message) -> None:
        words = ERRORS.get(reply.error, f"error {reply.error}")
        what = f"message {request.message_type:#010x}"
        if reply.message_type != request.message_type:
            raise ProtocolError(f"{self._name}: answered {what} with {reply.message_type:#010x}; reopen the device")
        if reply.flags & HARDWARE_EXCEPTION or reply.error == INTERNAL_ERROR:
            raise DeviceFault(f"{self._name}: reports a hardware fault on {what}: {words}; switch it off and on")
        if reply.flags & NACK or reply.error:
            raise DeviceRefused(f"{self._name}: refused {what}: {words}")
        if not reply.flags & (RESPONSE | ACK):
            raise ProtocolError(f"{self._name}: sent a request where {what} was to be answered; reopen the device")

    def _next_message(self) -> Message:
        """The next message of the stream."""
        self._in_step = False
        for _ in range(READS):
            try:
                missing = self._missing()
                if missing <= 0:
                    length = total_length(self._received)
                    data, self._received = self._received[:length], self._received[length:]
                    message = decode(data)
                    self._in_step = True
                    return message
            except ProtocolError as error:
                raise ProtocolError(f"{self._name}: {error}") from error
            # a bulk read must have room for whole packets, or the packet overflows it and is lost
            self._received += self._read(-(-missing // self._packet_size) * self._packet_size)
        raise ProtocolError(f"{self._name}: sends a message that never ends; unplug it and plug it in again")

    def _missing(self) -> int:
        """Bytes to read before the first message of what was received is whole; what is no message is dropped."""
        begin = self._received.find(START)
        if begin < 0:
            # the last bytes may be the first ones of a message
            begin = max(len(self._received) - len(START) + 1, 0)
        if begin:
            log.warning("%s: dropped %d bytes that are no message", self._name, begin)
            self._received = self._received[begin:]
        if len(self._received) < HEADER.size:
            return HEADER.size - len(self._received)
        return total_length(self._received) - len(self._received)

    def _read(self, size: int, timeout: float | None = None) -> bytes:
        try:
            return bytes(self._device.read(ENDPOINT_IN, size, self._milliseconds(timeout)))
        except usb.core.USBError as error:
            raise self._explain(error) from error

    def _drain(self) -> None:
        """Read until nothing comes, so that the next bytes begin a message."""
        self._received = b""
        for _ in range(DRAIN_READS):
            try:
                self._read(DRAIN_SIZE, DRAIN_TIMEOUT)
            except DeviceTimeout:
                self._in_step = True
                return
            except ProtocolError as error:
                log.warning("%s", error)  # it is thrown away in any case
        raise ProtocolError(f"{self._name}: sends without being asked; unplug the device and plug it in again")

    def _milliseconds(self, timeout: float | None = None) -> int:
        return max(round((self._timeout if timeout is None else timeout) * 1000), 1)  # 0 would be for ever

    def _explain(self, error: Any) -> DriverError:
        """A `usb.core.USBError` in our words."""
        if isinstance(error, usb.core.USBTimeoutError):
            return DeviceTimeout(f"{self._name}: no answer on USB within {self._timeout:g} s; check that it is on")
        if error.errno == errno.EOVERFLOW:
            return ProtocolError(f"{self._name}: sent more than it announced; reopen the device")
        if error.errno in BROKEN_TRANSFER:
            if error.errno == errno.EPIPE:
                self._clear_halts()
            return ProtocolError(f"{self._name}: a USB transfer failed ({error.strerror}); check the cable and the hub")
        return DeviceDisconnected(f"{self._name}: is gone from USB ({error.strerror}); plug it in, then reopen it")

    def _clear_halts(self) -> None:
        """A pipe that has stalled stays so until the host clears it."""
        for endpoint in (ENDPOINT_OUT, ENDPOINT_IN):
            try:
                self._device.clear_halt(endpoint)
            except usb.core.USBError as error:
                log.warning("%s: endpoint %#04x stays halted (%s)", self._name, endpoint, error.strerror)


def open_link(
    name: str, vendor: int, product: int, serial_message: int, serial_number: str | None, backend: Any, timeout: float
) -> tuple[UsbLink, str]:
    """Open the device with `serial_number`, or the only one there is, and return it with its serial number.

    Raises `DeviceNotFound`, and what the only candidate raised when asked for its serial number.
    """
    try:
        devices = list(usb.core.find(find_all=True, idVendor=vendor, idProduct=product, backend=backend))
    except usb.core.NoBackendError as error:
        raise DeviceNotFound(f"{name}: this computer has no USB library; install libusb 1.0") from error
    except usb.core.USBError as error:
        raise DeviceNotFound(f"{name}: USB cannot be searched ({error.strerror}); check the hub") from error
    links: list[tuple[UsbLink, str]] = []
    failures: list[DriverError] = []
    for device in devices:
        try:
            link = UsbLink(name, device, timeout)
        except DeviceNotFound as error:
            failures.append(error)  # it may be another one that somebody else uses
            continue
        try:
            found = link.ask(serial_message).rstrip(b"\0").decode("ascii", errors="backslashreplace")
            if not found.isprintable():
                raise ProtocolError(f"{name}: answered {found!a} when asked for its serial number; plug it in again")
        except DriverError as error:
            link.close()
            failures.append(error)
            continue
        links.append((link, found))
    wanted = [entry for entry in links if serial_number in {None, entry[1]}]
    for entry in links:
        if wanted != [entry]:
            entry[0].close()
    if len(wanted) == 1:
        return wanted[0]
    if not wanted and failures:
        raise failures[0]
    which = f" with serial number {serial_number}" if serial_number else ", which would have to be the only one,"
    known = ", ".join(sorted(found for _, found in links))
    message = f"{name}: no USB device {vendor:04x}:{product:04x}{which} is plugged in (found: {known or 'none'})"
    raise DeviceNotFound(message + "; check its power, its cable and the configured serial number")
