"""A USB port that exists only in this process: a backend for pyusb with one device plugged in.

Nothing waits here: a transfer that takes time lets it pass on the simulated clock, and so do the timeouts of the host
and the faults that last (delay, stall, unplug).
"""

import errno
import threading
from abc import abstractmethod
from array import array
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from types import SimpleNamespace

import usb.backend
import usb.core

from simulators.devices.clock import SimulatedClock
from simulators.devices.faults import Breakable, Fault, FaultScript, Kind, Line, duration, reaches_device, strike


@dataclass(frozen=True)
class _Pull:
    """The cable is pulled when the host gets here."""

    seconds: float
    """Simulated seconds after which it is back."""


@dataclass(frozen=True)
class _Spoilt:
    """A transfer that the bus could not bring across."""


class UsbPlug(usb.backend.IBackend, Breakable):  # type: ignore[misc]
    """The plug of a simulated device with a bulk endpoint each way.

    `packet_size` is 512 bytes on high-speed USB and 64 on full-speed USB. Opaque objects that pyusb passes around are
    not looked at, as there is only one device, but for the handle: it dies with the connection. Thread-safe.

    A corrupted packet never reaches the host as data, because USB repeats what fails its checksum: after
    `Kind.CORRUPT` the host is told that the transfer failed.
    """

    def __init__(self, clock: SimulatedClock, *, name: str, vendor: int, product: int, packet_size: int) -> None:
        self.script = FaultScript()
        """What befalls the requests."""
        self._clock = clock
        self._name = name
        self._vendor = vendor
        self._product = product
        self._packet_size = packet_size
        self._lock = threading.RLock()
        self._back_at = 0.0
        """When the cable is, or was, plugged in; simulated seconds."""
        self._connection = 0
        """Number of this connection; the handles of an earlier one are dead."""
        self._line = Line()
        self._coming: deque[tuple[float, bytes | _Pull | _Spoilt]] = deque()
        """When each packet is there, simulated seconds, and what it holds."""
        self._silent_until = 0.0

    def unplug(self, seconds: float = float("inf")) -> None:
        """Pull the cable, and put it back after `seconds` of simulated time."""
        with self._lock:
            self._back_at = self._clock.now() + seconds
            self._connection += 1
            self._forget()

    def plug_in(self) -> None:
        """Put the cable back."""
        with self._lock:
            self._back_at = self._clock.now()

    @abstractmethod
    def _receive(self, data: bytes, faults: Sequence[Fault]) -> None:
        """Act on one message from the host, whose reply the faults befall."""

    @abstractmethod
    def _prepare_reply(self, deadline: float) -> bool:
        """Let time pass until there is something to send, and queue it; False when there is not by `deadline`."""

    def _forget(self) -> None:
        """Drop what has not been delivered."""
        with self._lock:
            self._coming.clear()
            self._line = Line()

    def _queue(self, data: bytes, faults: Sequence[Fault]) -> None:
        """Put one reply on its way to the host; each piece of it is a transfer."""
        ready = max(self._clock.now(), self._silent_until)
        if self._coming:
            ready = max(ready, self._coming[-1][0])  # a pipe keeps the order
        kinds = {fault.kind for fault in faults}
        rest = [fault for fault in faults if fault.kind is not Kind.CORRUPT]
        for piece in self._line.carry(rest, data, self.script.random):
            ready += piece.after
            if Kind.CORRUPT in kinds:
                self._coming.append((ready, _Spoilt()))
                continue
            size = self._packet_size
            self._coming += [(ready, piece.data[i : i + size]) for i in range(0, len(piece.data), size)]
        if Kind.UNPLUG in kinds:
            self._coming.append((ready, _Pull(duration(Kind.UNPLUG, faults))))

    def _await_packet(self, deadline: float) -> bool:
        """Let time pass until a packet is there, at most until `deadline`; whether it is."""
        if (self._coming or self._prepare_reply(deadline)) and self._coming:
            ready = self._coming[0][0]
            self._clock.advance_to(min(ready, deadline))
            return ready <= deadline
        self._clock.advance_to(deadline)
        return False

    def enumerate_devices(self) -> Iterator[str]:
        """The devices that are plugged in."""
        return iter([self._name] if self._clock.now() >= self._back_at else [])

    def get_parent(self, dev: object) -> None:
        """No hub."""

    def get_device_descriptor(self, dev: object) -> SimpleNamespace:
        """Vendor and model."""
        return SimpleNamespace(
            bLength=18, bDescriptorType=1, bcdUSB=0x0200, bDeviceClass=0xFF, bDeviceSubClass=0, bDeviceProtocol=0,
            bMaxPacketSize0=64, idVendor=self._vendor, idProduct=self._product, bcdDevice=0x0100, iManufacturer=0,
            iProduct=0, iSerialNumber=0, bNumConfigurations=1,
            address=1, bus=1, port_number=1, port_numbers=(1,), speed=3,
        )  # fmt: skip

    def get_configuration_descriptor(self, dev: object, config: int) -> SimpleNamespace:
        """One configuration. Raises `IndexError` past it."""
        if config:
            raise IndexError(config)
        return SimpleNamespace(
            bLength=9, bDescriptorType=2, wTotalLength=32, bNumInterfaces=1, bConfigurationValue=1, iConfiguration=0,
            bmAttributes=0x80, bMaxPower=250, extra_descriptors=[],
        )  # fmt: skip

    def get_interface_descriptor(self, dev: object, intf: int, alt: int, config: int) -> SimpleNamespace:
        """One interface. Raises `IndexError` past it."""
        if intf or alt or config:
            raise IndexError(intf)
        return SimpleNamespace(
            bLength=9, bDescriptorType=4, bInterfaceNumber=0, bAlternateSetting=0, bNumEndpoints=2,
            bInterfaceClass=0xFF, bInterfaceSubClass=0, bInterfaceProtocol=0, iInterface=0, extra_descriptors=[],
        )  # fmt: skip

    def get_endpoint_descriptor(self, dev: object, ep: int, intf: int, alt: int, config: int) -> SimpleNamespace:
        """A bulk endpoint each way. Raises `IndexError` past them."""
        return SimpleNamespace(
            bLength=7, bDescriptorType=5, bEndpointAddress=(0x01, 0x81)[ep], bmAttributes=2,
            wMaxPacketSize=self._packet_size, bInterval=0, bRefresh=0, bSynchAddress=0, extra_descriptors=[],
        )  # fmt: skip

    def open_device(self, dev: object) -> int:
        """A handle, which dies with the connection."""
        with self._lock:
            self._check_cable(self._connection)
            return self._connection

    def close_device(self, dev_handle: int) -> None:
        """Nothing to give back."""

    def set_configuration(self, dev_handle: int, config_value: int) -> None:
        """There is only one."""
        self._check_cable(dev_handle)

    def get_configuration(self, dev_handle: int) -> int:
        """There is only one."""
        self._check_cable(dev_handle)
        return 1

    def claim_interface(self, dev_handle: int, intf: int) -> None:
        """Always granted."""
        self._check_cable(dev_handle)

    def release_interface(self, dev_handle: int, intf: int) -> None:
        """Nothing to give back."""
        self._check_cable(dev_handle)

    def clear_halt(self, dev_handle: int, ep: int) -> None:
        """No pipe stays halted."""
        self._check_cable(dev_handle)

    def reset_device(self, dev_handle: int) -> None:
        """Forget what is under way."""
        self._check_cable(dev_handle)
        self._forget()

    def is_kernel_driver_active(self, dev_handle: int, intf: int) -> bool:
        """No kernel driver claims such a device."""
        return False

    def bulk_write(self, dev_handle: int, ep: int, intf: int, data: "array[int]", timeout: int) -> int:
        """Take one message."""
        with self._lock:
            self._check_cable(dev_handle)
            faults = self.script.due()
            now = self._clock.now()
            heard = reaches_device(faults) and now >= self._silent_until
            self._silent_until = max(self._silent_until, now + duration(Kind.STALL, faults))
            strike(self, faults)
            if heard:
                self._receive(data.tobytes(), faults)
            return len(data)

    def bulk_read(self, dev_handle: int, ep: int, intf: int, buff: "array[int]", timeout: int) -> int:
        """Deliver packets until `buff` is full or a short packet ends the transfer.

        A packet that does not fit is lost with an overflow error, as in reality.
        """
        with self._lock:
            self._check_cable(dev_handle)
            deadline = self._clock.now() + timeout / 1000
            filled = 0
            while filled < len(buff):
                if not self._await_packet(deadline):
                    if filled:
                        return filled
                    raise usb.core.USBTimeoutError("Operation timed out", -7, errno.ETIMEDOUT)
                _, packet = self._coming.popleft()
                if isinstance(packet, _Pull):
                    self.unplug(packet.seconds)
                    self._check_cable(dev_handle)
                    break
                if isinstance(packet, _Spoilt):
                    raise usb.core.USBError("Input/Output Error", -1, errno.EIO)
                if len(packet) > len(buff) - filled:
                    raise usb.core.USBError("Overflow", -8, errno.EOVERFLOW)
                buff[filled : filled + len(packet)] = array("B", packet)
                filled += len(packet)
                if len(packet) < self._packet_size:
                    break
            return filled

    def _check_cable(self, connection: int) -> None:
        if connection != self._connection or self._clock.now() < self._back_at:
            raise usb.core.USBError("No such device (it may have been disconnected)", -4, errno.ENODEV)
