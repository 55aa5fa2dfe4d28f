"""Requests and replies of the Ocean Binary Protocol over USB; every call blocks, for a bounded time."""

import errno
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
    INTERNAL_ERROR,
    NACK,
    RESPONSE,
    Message,
    decode,
    encode,
    total_length,
)

ENDPOINT_OUT, ENDPOINT_IN = 0x01, 0x81
FOREIGN_REPLIES = 8
"""Replies to earlier requests that are skipped before the device is said to be confused."""
DRAIN_TIMEOUT = 0.02
"""Seconds of silence after which nothing more is on its way."""
DRAIN_READS = 32
"""Reads after which a device that never falls silent is given up."""


class UsbLink:
    """An opened device. `name` is for messages; `timeout` bounds each transfer, in seconds."""

    def __init__(self, name: str, device: Any, timeout: float) -> None:
        """Open `device` (a `usb.core.Device`). Raises `DeviceNotFound` when the system does not let us."""
        self._name = name
        self._device = device
        self._timeout = timeout
        self._last_request = 0
        self._in_step = True
        """Whether the next bytes to come begin a message."""
        try:
            device.set_configuration()
            interface = device.get_active_configuration()[(0, 0)]
            endpoint = usb.util.find_descriptor(interface, bEndpointAddress=ENDPOINT_IN)
            usb.util.claim_interface(device, interface)
        except usb.core.USBError as error:
            usb.util.dispose_resources(device)
            message = f"{name}: is plugged in but cannot be opened ({error.strerror})"
            message += "; close other programs that use it and check that you may access USB devices"
            raise DeviceNotFound(message) from error
        self._packet_size = int(endpoint.wMaxPacketSize)

    def close(self) -> None:
        """Give the device back; harmless when it is gone."""
        usb.util.dispose_resources(self._device)

    def ask(self, message_type: int, payload: bytes = b"") -> bytes:
        """Send a query and return the payload of its reply."""
        return self.receive(self.send(message_type, payload)).payload

    def command(self, message_type: int, payload: bytes = b"") -> None:
        """Send a setting and wait until it is acknowledged. Raises `DeviceRefused` when it is not."""
        reply = self.receive(self.send(message_type, payload, flags=ACK_REQUESTED))
        if not reply.flags & ACK:
            raise ProtocolError(f"{self._name}: did not acknowledge message {message_type:#010x}; reopen the device")

    def send(self, message_type: int, payload: bytes = b"", flags: int = 0) -> Message:
        """Send a request, for whose reply `receive` waits."""
        if not self._in_step:
            self._drain()
        self._last_request = self._last_request % 0xFFFFFFFF + 1
        request = Message(message_type, regarding=self._last_request, flags=flags, payload=payload)
        try:
            self._device.write(ENDPOINT_OUT, encode(request), self._milliseconds())
        except usb.core.USBError as error:
            raise self._explain(error) from error
        return request

    def receive(self, request: Message) -> Message:
        """The reply to `request`; replies to earlier requests, which nobody waits for any more, are skipped.

        Raises `DeviceRefused` or `DeviceFault` when the reply says so, `ProtocolError` when it is malformed.
        """
        for _ in range(FOREIGN_REPLIES):
            reply = self._read_message()
            if reply.regarding != request.regarding:
                continue
            if reply.error == DEFERRED:
                continue
            self._check(request, reply)
            return reply
        message = f"{self._name}: answered {FOREIGN_REPLIES} other requests instead of {request.message_type:#010x}"
        raise ProtocolError(message + "; reopen the device")

    def _check(self, request: Message, reply: Message) -> None:
        words = ERRORS.get(reply.error, f"error {reply.error}")
        what = f"message {request.message_type:#010x}"
        if reply.flags & HARDWARE_EXCEPTION or reply.error == INTERNAL_ERROR:
            raise DeviceFault(f"{self._name}: reports a hardware fault on {what}: {words}; switch it off and on")
        if reply.flags & NACK or reply.error:
            raise DeviceRefused(f"{self._name}: refused {what}: {words}")
        if reply.message_type != request.message_type or not reply.flags & (RESPONSE | ACK):
            raise ProtocolError(f"{self._name}: answered {what} with {reply.message_type:#010x}; reopen the device")

    def _read_message(self) -> Message:
        """The next message. A bulk read must hold whole packets, or the packet overflows it and is lost."""
        self._in_step = False
        data = self._read(self._packet_size)
        try:
            missing = total_length(data) - len(data)
            if missing > 0:
                data += self._read(-(-missing // self._packet_size) * self._packet_size)
            message = decode(data)
        except ProtocolError as error:
            raise ProtocolError(f"{self._name}: {error}") from error
        self._in_step = True
        return message

    def _read(self, size: int, timeout: float | None = None) -> bytes:
        try:
            return bytes(self._device.read(ENDPOINT_IN, size, self._milliseconds(timeout)))
        except usb.core.USBError as error:
            raise self._explain(error) from error

    def _drain(self) -> None:
        """Read until nothing comes, so that the next bytes begin a message."""
        for _ in range(DRAIN_READS):
            try:
                self._read(self._packet_size, DRAIN_TIMEOUT)
            except DeviceTimeout:
                self._in_step = True
                return
        raise ProtocolError(f"{self._name}: sends without being asked; unplug the device and plug it in again")

    def _milliseconds(self, timeout: float | None = None) -> int:
        return round((self._timeout if timeout is None else timeout) * 1000)

    def _explain(self, error: Any) -> DriverError:
        """A `usb.core.USBError` in our words."""
        if isinstance(error, usb.core.USBTimeoutError):
            return DeviceTimeout(f"{self._name}: no answer on USB within {self._timeout:g} s; check that it is on")
        if error.errno == errno.EOVERFLOW:
            return ProtocolError(f"{self._name}: sent more than it announced; reopen the device")
        return DeviceDisconnected(f"{self._name}: is gone from USB ({error.strerror}); plug it in, then reopen it")


def open_link(
    name: str, vendor: int, product: int, serial_message: int, serial_number: str | None, backend: Any, timeout: float
) -> tuple[UsbLink, str]:
    """Open the device with `serial_number`, or the only one there is, and return it with its serial number.

    Raises `DeviceNotFound`.
    """
    try:
        devices = list(usb.core.find(find_all=True, idVendor=vendor, idProduct=product, backend=backend))
    except usb.core.NoBackendError as error:
        raise DeviceNotFound(f"{name}: this computer has no USB library; install libusb 1.0") from error
    links: list[tuple[UsbLink, str]] = []
    closed_to_us: list[DeviceNotFound] = []
    try:
        for device in devices:
            try:
                link = UsbLink(name, device, timeout)
            except DeviceNotFound as error:
                closed_to_us.append(error)  # it may be another one that somebody else uses
                continue
            links.append((link, ""))
            links[-1] = (link, link.ask(serial_message).rstrip(b"\0").decode("ascii", errors="backslashreplace"))
        wanted = [entry for entry in links if serial_number in {None, entry[1]}]
        if not wanted and closed_to_us:
            raise closed_to_us[0]
        if len(wanted) != 1:
            found = ", ".join(sorted(entry[1] for entry in links)) or "none"
            which = f"with serial number {serial_number}" if serial_number else "that could be the only one"
            message = f"{name}: USB has no {vendor:04x}:{product:04x} {which} (found: {found})"
            raise DeviceNotFound(message + "; check its power, its cable and the configured serial number")
    except DriverError:
        for link, _ in links:
            link.close()
        raise
    for entry in links:
        if entry is not wanted[0]:
            entry[0].close()
    return wanted[0]
