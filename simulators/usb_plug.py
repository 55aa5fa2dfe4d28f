"""A USB port that exists only in this process: a backend for pyusb with one device plugged in.

Nothing waits here: a transfer that takes time lets it pass on the simulated clock.
"""

import errno
import threading
from abc import abstractmethod
from array import array
from collections import deque
from collections.abc import Iterator
from types import SimpleNamespace

import usb.backend
import usb.core

from simulators.clock import SimulatedClock


class UsbPlug(usb.backend.IBackend):  # type: ignore[misc]
    """The plug of a simulated device with a bulk endpoint each way.

    `packet_size` is 512 bytes on high-speed USB and 64 on full-speed USB. Opaque handles that pyusb passes
    around are not looked at: there is only one device. Thread-safe.
    """

    def __init__(self, clock: SimulatedClock, *, name: str, vendor: int, product: int, packet_size: int) -> None:
        self.packets_until_unplugged: int | None = None
        """Packets that are still delivered before the cable is pulled; None for a sound cable."""
        self.packets_to_lose = 0
        """Packets that are still to be lost on the way to the host."""
        self._clock = clock
        self._name = name
        self._vendor = vendor
        self._product = product
        self._packet_size = packet_size
        self._lock = threading.RLock()
        self._plugged_in = True
        self._packets: deque[bytes] = deque()

    def unplug(self) -> None:
        """Pull the cable."""
        with self._lock:
            self._plugged_in = False
            self._forget()

    def plug_in(self) -> None:
        """Put the cable back."""
        self._plugged_in = True

    @abstractmethod
    def _receive(self, data: bytes) -> None:
        """Act on one message from the host."""

    @abstractmethod
    def _prepare_reply(self, deadline: float) -> bool:
        """Let time pass until there is something to send, and queue it; False when there is not by `deadline`."""

    def _forget(self) -> None:
        """Drop what has not been delivered."""
        with self._lock:
            self._packets.clear()

    def _queue(self, data: bytes) -> None:
        """Put one transfer on its way to the host."""
        self._packets += [data[i : i + self._packet_size] for i in range(0, len(data), self._packet_size)]

    def _await_reply(self, deadline: float) -> bool:
        if self._prepare_reply(deadline):
            return True
        self._clock.advance_to(deadline)
        return False

    def enumerate_devices(self) -> Iterator[str]:
        """The devices that are plugged in."""
        return iter([self._name] if self._plugged_in else [])

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

    def open_device(self, dev: object) -> object:
        """A handle."""
        self._check_cable()
        return dev

    def close_device(self, dev_handle: object) -> None:
        """Nothing to give back."""

    def set_configuration(self, dev_handle: object, config_value: int) -> None:
        """There is only one."""
        self._check_cable()

    def get_configuration(self, dev_handle: object) -> int:
        """There is only one."""
        self._check_cable()
        return 1

    def claim_interface(self, dev_handle: object, intf: int) -> None:
        """Always granted."""
        self._check_cable()

    def release_interface(self, dev_handle: object, intf: int) -> None:
        """Nothing to give back."""
        self._check_cable()

    def reset_device(self, dev_handle: object) -> None:
        """Forget what is under way."""
        self._check_cable()
        self._forget()

    def is_kernel_driver_active(self, dev_handle: object, intf: int) -> bool:
        """No kernel driver claims such a device."""
        return False

    def bulk_write(self, dev_handle: object, ep: int, intf: int, data: "array[int]", timeout: int) -> int:
        """Take one message."""
        with self._lock:
            self._check_cable()
            self._receive(data.tobytes())
            return len(data)

    def bulk_read(self, dev_handle: object, ep: int, intf: int, buff: "array[int]", timeout: int) -> int:
        """Deliver packets until `buff` is full or a short packet ends the transfer.

        A packet that does not fit is lost with an overflow error, as in reality.
        """
        with self._lock:
            self._check_cable()
            deadline = self._clock.now() + timeout / 1000
            filled = 0
            while filled < len(buff):
                if not self._packets and not self._await_reply(deadline):
                    if filled:
                        return filled
                    raise usb.core.USBTimeoutError("Operation timed out", -7, errno.ETIMEDOUT)
                self._count_packet()
                packet = self._packets.popleft()
                if self.packets_to_lose:
                    self.packets_to_lose -= 1
                    continue
                if len(packet) > len(buff) - filled:
                    raise usb.core.USBError("Overflow", -8, errno.EOVERFLOW)
                buff[filled : filled + len(packet)] = array("B", packet)
                filled += len(packet)
                if len(packet) < self._packet_size:
                    break
            return filled

    def _count_packet(self) -> None:
        if self.packets_until_unplugged == 0:
            self.packets_until_unplugged = None
            self.unplug()
            self._check_cable()
        elif self.packets_until_unplugged is not None:
            self.packets_until_unplugged -= 1

    def _check_cable(self) -> None:
        if not self._plugged_in:
            raise usb.core.USBError("No such device (it may have been disconnected)", -4, errno.ENODEV)
