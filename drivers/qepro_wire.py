"""What is said to a QE Pro, message by message; every call blocks, for a bounded time.

Settings and commands are sent once; when an acknowledgement is lost, the device is asked whether it obeyed. Queries
are repeated by the link. Message numbers and layouts are those of Ocean Optics' SeaBreeze, from its source; no device
was at hand. From memory is that filling the buffer ends when it is full.
"""

import contextlib
import logging
import struct
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np

from drivers.arrays import CountArray, FloatArray
from drivers.errors import DeviceFault, DeviceRefused, DeviceTimeout, DriverError, ProtocolError
from drivers.obp import Message
from drivers.usb_link import open_link

VENDOR, PRODUCT = 0x2457, 0x4004
PIXELS = 1044
METADATA = struct.Struct("<LQLHB13x")
"""In front of each spectrum: count, tick, integration time in microseconds, reserved, trigger mode."""

HARDWARE_REVISION, FIRMWARE_REVISION, SERIAL_NUMBER = 0x00000080, 0x00000090, 0x00000100
ABORT, CLEAR_BUFFER, FILL_BUFFER = 0x00100000, 0x00100830, 0x00100902
LARGEST_BUFFER, BUFFERED, IS_IDLE, SPECTRUM = 0x00100820, 0x00100900, 0x00100908, 0x00100928
WAVELENGTH_COUNT, WAVELENGTH_COEFFICIENT = 0x00180100, 0x00180101
NONLINEARITY_COUNT, NONLINEARITY_COEFFICIENT = 0x00181100, 0x00181101
COOLER_ENABLED, COOLER_STABLE, TEMPERATURE = 0x00420000, 0x00420003, 0x00420004

SET_POINT_STEP = 0.1
"""Degrees by which a set point may be rounded by the device."""

log = logging.getLogger(__name__)


class TriggerMode(IntEnum):
    """What begins an integration."""

    NORMAL = 0
    """The device itself."""
    LEVEL = 1
    SYNCHRONOUS = 2
    EDGE = 3


@dataclass(frozen=True)
class Setting:
    """Something that the device can be set to."""

    what: str
    """In words, for messages."""
    message: int
    """That sets it."""
    layout: str
    """Of its value, for `struct`."""
    query: int | None
    """That reads it back; None where there is none."""
    optional: bool = False
    """Whether there may be firmware that cannot read it back; then the acknowledgement has to do."""


INTEGRATION_TIME = Setting("integration time", 0x00110010, "<L", 0x00110000)
TRIGGER_MODE = Setting("trigger mode", 0x00110110, "<B", 0x00110100, optional=True)
BUFFER_SIZE = Setting("buffer size", 0x00100832, "<L", 0x00100822)
COOLER = Setting("cooler", 0x00420010, "<B", COOLER_ENABLED)
SET_POINT = Setting("cooler set point", 0x00420011, "<f", 0x00420001)
LAMP = Setting("lamp", 0x00110410, "<B", 0x00110400, optional=True)
SHUTTER = Setting("shutter", 0x00110610, "<B", None)
GPIO_OUTPUTS = Setting("GPIO direction", 0x00200110, "<L", 0x00200100)
GPIO_LEVELS = Setting("GPIO level", 0x00200310, "<L", 0x00200300)


@dataclass(frozen=True)
class Gpio:
    """The general-purpose pins, one bit each."""

    outputs: int
    """1 where the pin is an output."""
    levels: int
    """1 where the level is high."""


@dataclass(frozen=True)
class Reading:
    """A spectrum as it comes."""

    count: int
    tick: int
    microseconds: int
    mode: int
    counts: CountArray


@dataclass(frozen=True)
class Known:
    """What the device says of itself, read once when it is opened."""

    identity: str
    wavelengths: FloatArray
    nonlinearity: FloatArray
    largest_buffer: int


class QEProWire:
    """An opened QE Pro. `name` is for messages; `timeout` bounds each reply, in seconds.

    All methods but `close` raise `DriverError`.
    """

    def __init__(self, name: str, serial_number: str | None, usb_backend: Any, timeout: float) -> None:
        """Open the device with `serial_number`, or the only one. Raises as `open_link` does."""
        self._name = name
        self._timeout = timeout
        self._link, self._serial_number = open_link(
            name, VENDOR, PRODUCT, SERIAL_NUMBER, serial_number, usb_backend, timeout
        )
        self._set_to: dict[Setting, bytes] = {}
        """Settings of acquisitions that need not be sent again."""

    def close(self) -> None:
        """Give the device back; harmless when it is gone."""
        self._link.close()

    def known(self) -> Known:
        """What the device says of itself. Raises `DeviceFault` when its calibration is none."""
        pixels = np.arange(PIXELS, dtype=np.float64)
        wavelengths = np.polynomial.Polynomial(self._coefficients(WAVELENGTH_COUNT, WAVELENGTH_COEFFICIENT))(pixels)
        if not (np.diff(wavelengths) > 0).all():
            message = f"{self._name}: the wavelengths in the device do not increase from pixel to pixel"
            raise DeviceFault(message + "; have it recalibrated")
        nonlinearity = self._coefficients(NONLINEARITY_COUNT, NONLINEARITY_COEFFICIENT)
        if not nonlinearity.any():
            nonlinearity = np.ones(1)
        identity = f"Ocean Optics QE Pro {self._serial_number}"
        with contextlib.suppress(DeviceRefused):  # not all firmware tells
            hardware = int(self.ask(HARDWARE_REVISION, "<B"))
            identity += f" (hardware {hardware}, firmware {int(self.ask(FIRMWARE_REVISION, '<H')):#06x})"
        return Known(identity, wavelengths, nonlinearity, int(self.ask(LARGEST_BUFFER, "<L")))

    def ask(self, message_type: int, layout: str, payload: bytes = b"") -> float:
        """One number of the given `struct` layout."""
        reply = self._link.ask(message_type, payload)
        if len(reply) != struct.calcsize(layout):
            message = f"{self._name}: answered {len(reply)} bytes to {message_type:#010x}"
            raise ProtocolError(message + f"; {struct.calcsize(layout)} were expected")
        return float(struct.unpack(layout, reply)[0])

    def _coefficients(self, count_message: int, message: int) -> FloatArray:
        count = int(self.ask(count_message, "<B"))
        coefficients = np.array([self.ask(message, "<f", bytes([index])) for index in range(count)])
        if not (count and np.isfinite(coefficients).all()):
            raise DeviceFault(f"{self._name}: holds coefficients {coefficients.tolist()}; have it recalibrated")
        return coefficients

    def set(self, setting: Setting, payload: bytes, is_set: Callable[[bytes], bool] | None = None) -> None:
        """Send a setting once and read it back, so that an acknowledgement that gets lost does no harm.

        `is_set` tells whether what is read is what was set; by default it has to be the same bytes. Raises
        `DeviceRefused` when the device says no, `DeviceFault` when it says yes and does not.
        """
        agrees = is_set or payload.__eq__
        doubt: DriverError | None = None
        try:
            self._link.command(setting.message, payload)
        except (DeviceTimeout, ProtocolError) as error:
            doubt = error
        found = self._read_back(setting)
        if found is not None and agrees(found):
            if doubt is not None:
                log.warning("%s; the %s reads back as it was set", doubt, setting.what)
        elif doubt is not None:
            raise doubt
        elif found is not None:
            message = f"{self._name}: acknowledged a {setting.what} of {payload.hex()} and reads back {found.hex()}"
            raise DeviceFault(message + "; switch the device off and on")

    def _read_back(self, setting: Setting) -> bytes | None:
        """What the device is set to; None where it cannot tell."""
        if setting.query is None:
            return None
        try:
            return self._link.ask(setting.query)
        except DeviceRefused:
            if setting.optional:
                return None
            raise

    def _do(self, message: int, is_done: Callable[[], bool]) -> None:
        """Send a command once; when its acknowledgement is lost, ask whether it was obeyed."""
        try:
            self._link.command(message)
        except (DeviceTimeout, ProtocolError) as error:
            if not is_done():
                raise
            log.warning("%s; it was obeyed", error)

    def abort(self) -> None:
        """End the integration under way."""
        self._do(ABORT, lambda: bool(self.ask(IS_IDLE, "<B")))

    def set_cooler(self, set_point: float) -> None:
        """Switch the cooler on, towards `set_point` degrees Celsius."""

        def is_near(found: bytes) -> bool:
            return len(found) == 4 and abs(struct.unpack("<f", found)[0] - set_point) <= SET_POINT_STEP

        self.set(SET_POINT, struct.pack("<f", set_point), is_near)
        self.set(COOLER, b"\x01")

    def set_pins(self, setting: Setting, bits: int, mask: int) -> None:
        """Set those bits of `GPIO_OUTPUTS` or `GPIO_LEVELS` that are 1 in `mask`."""

        def agrees(found: bytes) -> bool:
            return len(found) == 4 and int.from_bytes(found, "little") & mask == bits & mask

        self.set(setting, struct.pack("<LL", bits, mask), agrees)

    def forget_settings(self) -> None:
        """Set everything anew for the next integration."""
        self._set_to.clear()

    def _prepare(self, microseconds: int, mode: TriggerMode) -> None:
        """Throw away what was integrated before, and set what the next integration shall be."""
        self.abort()
        for setting, value in ((INTEGRATION_TIME, microseconds), (TRIGGER_MODE, mode)):
            payload = struct.pack(setting.layout, value)
            if self._set_to.pop(setting, None) != payload:
                self.set(setting, payload)
            self._set_to[setting] = payload
        self._do(CLEAR_BUFFER, lambda: self.ask(BUFFERED, "<L") == 0)

    def begin(self, microseconds: int) -> Message:
        """Request a new spectrum."""
        self._prepare(microseconds, TriggerMode.NORMAL)
        return self._link.send(SPECTRUM)

    def finish(self, request: Message) -> Reading:
        """The spectrum that was requested. Raises `ProtocolError` when it got lost on the way."""
        try:
            return self._reading(self._link.receive(request))
        except DeviceTimeout as error:
            if self.ask(IS_IDLE, "<B"):
                raise ProtocolError(f"{self._name}: a spectrum got lost on USB") from error
            self.abort()
            message = f"{self._name}: no answer on USB: a spectrum takes {self._timeout:g} s longer than it was set"
            raise DeviceTimeout(message + "; switch the device off and on") from error

    def fill(self, microseconds: int, mode: TriggerMode, scans: int) -> None:
        """Begin to acquire `scans` spectra into the buffer."""
        self._prepare(microseconds, mode)
        self.set(BUFFER_SIZE, struct.pack(BUFFER_SIZE.layout, scans))
        self._do(FILL_BUFFER, lambda: not self.ask(IS_IDLE, "<B") or self.ask(BUFFERED, "<L") > 0)

    def read_buffer(self, scans: int) -> list[Reading]:
        """The oldest `scans` spectra of the buffer. Raises `ProtocolError` when one got lost on the way."""
        try:
            return [self._reading(self._link.receive(self._link.send(SPECTRUM))) for _ in range(scans)]
        except DeviceTimeout as error:
            raise ProtocolError(f"{self._name}: a spectrum of the buffer got lost on USB") from error

    def _reading(self, reply: Message) -> Reading:
        data = reply.payload
        if len(data) != METADATA.size + 4 * PIXELS:
            message = f"{self._name}: sent a spectrum of {len(data)} bytes"
            raise ProtocolError(message + f"; {METADATA.size + 4 * PIXELS} were expected")
        count, tick, microseconds, _, mode = METADATA.unpack_from(data)
        counts = np.frombuffer(data, dtype="<u4", offset=METADATA.size).astype(np.uint32)
        return Reading(count, tick, microseconds, mode, counts)
