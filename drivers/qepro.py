"""Ocean Optics (Ocean Insight) QE Pro spectrometer on USB.

The meaning of the lamp and shutter payloads (one byte, 1 = on or open) was not checked on a device.
"""

import struct
from dataclasses import dataclass
from typing import Any

import numpy as np

from drivers.arrays import FloatArray
from drivers.clock import Clock
from drivers.device_thread import DeviceThread
from drivers.errors import DeviceDisconnected, DeviceRefused, DeviceTimeout, DriverError, ProtocolError
from drivers.interfaces import Spectrum
from drivers.obp import Message
from drivers.usb_link import UsbLink, open_link

VENDOR, PRODUCT = 0x2457, 0x4004
PIXELS = 1044
METADATA = struct.Struct("<LQLHB13x")
"""In front of each spectrum: count, tick, integration time in microseconds, reserved, trigger mode."""

SERIAL_NUMBER = 0x00000100
SET_INTEGRATION_TIME = 0x00110010
SET_TRIGGER_MODE = 0x00110110
ABORT = 0x00100000
CLEAR_BUFFER = 0x00100830
SPECTRUM = 0x00100928
WAVELENGTH_COUNT, WAVELENGTH_COEFFICIENT = 0x00180100, 0x00180101
NONLINEARITY_COUNT, NONLINEARITY_COEFFICIENT = 0x00181100, 0x00181101
COOLER_STABLE, TEMPERATURE, ENABLE_COOLER, SET_COOLER = 0x00420003, 0x00420004, 0x00420010, 0x00420011
LAMP, SHUTTER = 0x00110410, 0x00110610

COOLING_TIME = 600.0
"""Seconds that the cooler may take to its set point."""
COOLING_POLL = 2.0
"""Seconds between two questions while it cools."""
ATTEMPTS = 4
"""How often a spectrum is taken before the device is said to deliver only stale ones."""


@dataclass(frozen=True)
class _Calibration:
    """What the device knows of itself, read once when it is opened."""

    serial_number: str
    wavelengths: FloatArray
    nonlinearity: FloatArray


class QEPro:
    """A `Spectrometer` on a QE Pro.

    Opening it switches the cooler on and waits until the detector is at `cooler_set_point` (degrees Celsius),
    which takes minutes. Of several devices, `serial_number` tells which. `usb_backend` is a pyusb backend, the
    system's own by default. `timeout` bounds each reply beyond the integration time, in seconds.
    """

    integration_limits = (0.008, 1600.0)
    """Shortest and longest integration time, seconds."""
    saturation = 200_000
    """Counts at and above which a pixel is saturated: the 18-bit converter is limited before its full scale."""

    def __init__(
        self,
        name: str,
        clock: Clock,
        *,
        serial_number: str | None = None,
        usb_backend: Any = None,  # usb.backend.IBackend, which has no types
        cooler_set_point: float = -10.0,
        timeout: float = 2.0,
    ) -> None:
        self.name = name
        self._clock = clock
        self._serial_number = serial_number
        self._usb_backend = usb_backend
        self._cooler_set_point = cooler_set_point
        self._timeout = timeout
        self._thread = DeviceThread(name)
        self._link: UsbLink | None = None
        self._calibration: _Calibration | None = None
        self._integration_us = 0
        self._last_count = -1

    async def open(self) -> None:
        """Connect, read the calibration, cool the detector and wait until it is cold.

        Raises `DeviceNotFound` and `DeviceTimeout`.
        """
        await self.close()
        try:
            await self._thread.run(self._connect)
            await self._cool()
        except DriverError:
            await self.close()
            raise

    async def close(self) -> None:
        """Disconnect; harmless when not connected. The cooler is left on, so that a reopening is quick."""
        await self._thread.finish(self._disconnect)

    async def identity(self) -> str:
        """Maker, model and serial number."""
        return f"Ocean Optics QE Pro {self._known().serial_number}"

    async def wavelengths(self) -> FloatArray:
        """[1044] nanometres: the device's polynomial in the pixel index."""
        return self._known().wavelengths

    async def nonlinearity(self) -> FloatArray:
        """[coefficients] of the polynomial to divide by; [1.0] for a device that was never characterised."""
        return self._known().nonlinearity

    async def expose(self, integration_time: float) -> Spectrum:
        """Integrate once for `integration_time` seconds.

        What the device integrates on its own is thrown away first. The device may still deliver a spectrum
        of the previous setting; it is recognised by its own metadata and discarded. Raises `ProtocolError` when
        nothing else comes, `DeviceTimeout` when nothing comes, `DeviceRefused` outside the limits.
        """
        low, high = self.integration_limits
        if not low <= integration_time < high:
            message = f"{self.name}: cannot integrate for {integration_time:g} s; ask for {low:g} s to {high:g} s"
            raise DeviceRefused(message)
        microseconds = round(integration_time * 1e6)
        for _ in range(ATTEMPTS):
            request = await self._thread.run(self._begin, microseconds)
            # a long wait is spent on the clock, where it can be cancelled, and not in the device's thread
            await self._clock.sleep(integration_time)
            spectrum = await self._thread.run(self._finish, request)
            is_fresh = round(spectrum.integration_time * 1e6) == microseconds and spectrum.count != self._last_count
            self._last_count = spectrum.count
            if is_fresh:
                return spectrum
            self._integration_us = 0
        message = f"{self.name}: delivered {ATTEMPTS} stale spectra, the last of {spectrum.integration_time:g} s"
        raise ProtocolError(message + f" where {integration_time:g} s were set; switch the device off and on")

    async def command(self, message_type: int, payload: bytes) -> None:
        """Send one setting and wait until the device has acknowledged it. Raises `DeviceRefused`."""
        await self._thread.run(self._command, message_type, payload)

    def _open_link(self) -> UsbLink:
        if self._link is None:
            raise DeviceDisconnected(f"{self.name}: is not open; open the device first")
        return self._link

    def _known(self) -> _Calibration:
        if self._calibration is None:
            raise DeviceDisconnected(f"{self.name}: is not open; open the device first")
        return self._calibration

    async def _cool(self) -> None:
        await self.command(SET_COOLER, struct.pack("<f", self._cooler_set_point))
        await self.command(ENABLE_COOLER, b"\x01")
        begin = self._clock.now()
        while not await self._thread.run(self._ask, COOLER_STABLE, "<B"):
            if self._clock.now() - begin > COOLING_TIME:
                temperature = await self._thread.run(self._ask, TEMPERATURE, "<f")
                message = f"{self.name}: the detector is at {temperature:.1f} °C after {COOLING_TIME:g} s"
                raise DeviceTimeout(
                    message + f"; it should rest at {self._cooler_set_point:g} °C: is the room too warm?"
                )
            await self._clock.sleep(COOLING_POLL)

    # what follows blocks and runs in the device's thread

    def _connect(self) -> None:
        self._link, serial_number = open_link(
            self.name, VENDOR, PRODUCT, SERIAL_NUMBER, self._serial_number, self._usb_backend, self._timeout
        )
        wavelengths = self._coefficients(WAVELENGTH_COUNT, WAVELENGTH_COEFFICIENT)
        nonlinearity = self._coefficients(NONLINEARITY_COUNT, NONLINEARITY_COEFFICIENT)
        if not nonlinearity.any():
            nonlinearity = np.ones(1)
        pixels = np.arange(PIXELS, dtype=np.float64)
        axis = sum((c * pixels**power for power, c in enumerate(wavelengths)), start=np.zeros(PIXELS))
        self._calibration = _Calibration(serial_number, axis, nonlinearity)
        # neither is known of a device that others may have used
        self._integration_us, self._last_count = 0, -1

    def _disconnect(self) -> None:
        link, self._link, self._calibration = self._link, None, None
        if link is not None:
            link.close()

    def _command(self, message_type: int, payload: bytes) -> None:
        self._open_link().command(message_type, payload)

    def _ask(self, message_type: int, layout: str, payload: bytes = b"") -> float:
        """One number of the given `struct` layout."""
        reply = self._open_link().ask(message_type, payload)
        if len(reply) != struct.calcsize(layout):
            message = f"{self.name}: answered {len(reply)} bytes to {message_type:#010x}"
            raise ProtocolError(message + f"; {struct.calcsize(layout)} were expected")
        return float(struct.unpack(layout, reply)[0])

    def _coefficients(self, count_message: int, message: int) -> FloatArray:
        count = int(self._ask(count_message, "<B"))
        return np.array([self._ask(message, "<f", bytes([index])) for index in range(count)])

    def _begin(self, microseconds: int) -> Message:
        """Throw away what was integrated before, and request a new spectrum."""
        link = self._open_link()
        if microseconds != self._integration_us:
            link.command(SET_INTEGRATION_TIME, struct.pack("<L", microseconds))
            self._integration_us = microseconds
        link.command(ABORT)
        link.command(SET_TRIGGER_MODE, b"\x00")
        link.command(CLEAR_BUFFER)
        return link.send(SPECTRUM)

    def _finish(self, request: Message) -> Spectrum:
        link = self._open_link()
        data = link.receive(request).payload
        if len(data) != METADATA.size + 4 * PIXELS:
            message = f"{self.name}: sent a spectrum of {len(data)} bytes"
            raise ProtocolError(message + f"; {METADATA.size + 4 * PIXELS} were expected")
        count, _, microseconds, _, _ = METADATA.unpack_from(data)
        counts = np.frombuffer(data, dtype="<u4", offset=METADATA.size).astype(np.uint32)
        return Spectrum(counts, microseconds / 1e6, count, self._ask(TEMPERATURE, "<f"))


class QEProLight:
    """The `Light` that a QE Pro switches: the lamp and the shutter on its accessory connector."""

    def __init__(self, qepro: QEPro) -> None:
        self._qepro = qepro

    async def set_lamp(self, on: bool) -> None:
        """Switch the lamp."""
        await self._qepro.command(LAMP, bytes([on]))

    async def set_shutter(self, is_open: bool) -> None:
        """Open or close the shutter; a closed shutter gives a dark signal."""
        await self._qepro.command(SHUTTER, bytes([is_open]))
