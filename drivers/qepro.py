"""Ocean Optics (Ocean Insight) QE Pro spectrometer on USB.

A spectrum is delivered only when its own metadata say that it is the one that was asked for: integration time, trigger
mode, a count and a tick beyond all before; and when the detector is as cold as it was set. One that is not, or gets
lost, is taken again, a few times, and each time is logged.

That ticks are microseconds since the device was switched on is from memory.
"""

import asyncio
import contextlib
import logging
import math
import struct
from collections.abc import Awaitable, Callable
from typing import Any, TypeVar

from drivers.arrays import FloatArray
from drivers.clock import Clock
from drivers.device_thread import DeviceThread
from drivers.errors import DeviceDisconnected, DeviceFault, DeviceRefused, DeviceTimeout, DriverError, ProtocolError
from drivers.interfaces import Begun, Spectrum
from drivers.qepro_wire import (
    BUFFERED,
    COOLER_ENABLED,
    COOLER_STABLE,
    GPIO_LEVELS,
    GPIO_OUTPUTS,
    LAMP,
    SHUTTER,
    TEMPERATURE,
    Gpio,
    Known,
    QEProWire,
    Reading,
    Setting,
    TriggerMode,
)

COOLING_TIME = 600.0
"""Seconds that the cooler may take to its set point."""
COOLING_POLL = 2.0
"""Seconds between two questions while it cools."""
ATTEMPTS = 4
"""How often a spectrum is taken before the device is said to deliver only stale ones."""
POLL = 0.02
"""Seconds between two questions for a spectrum that should be there."""
TICK_SLACK = 0.99
"""The part of the integration time that two spectra in a row are at least apart."""

log = logging.getLogger(__name__)
T = TypeVar("T")
Taken = tuple[float | None, list[Reading]]
"""When the first of some readings began, seconds on the clock, None where that is not known; and the readings."""


class QEPro:
    """A `Spectrometer` on a QE Pro.

    Opening it switches the cooler on and waits until the detector is at `cooler_set_point` (degrees Celsius), which
    takes minutes; a spectrum that was taken more than `temperature_tolerance` degrees from it is refused. Of several
    devices, `serial_number` tells which. `usb_backend` is a pyusb backend, the system's own by default. `timeout`
    bounds each reply beyond the integration time, in seconds.
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
        temperature_tolerance: float = 0.5,
        timeout: float = 2.0,
    ) -> None:
        self.name = name
        self._clock = clock
        self._serial_number = serial_number
        self._usb_backend = usb_backend
        self._cooler_set_point = cooler_set_point
        self._temperature_tolerance = temperature_tolerance
        self._timeout = timeout
        self._thread = DeviceThread(name)
        self._wire: QEProWire | None = None
        self._known: Known | None = None
        self._newest: Reading | None = None
        self._distrust = ""
        """Why no spectrum may be taken before the device is opened again."""

    async def open(self) -> None:
        """Connect, read the calibration, cool the detector and wait until it is cold.

        Raises `DeviceNotFound`; `DeviceFault` when the calibration in the device is no calibration; `DeviceTimeout`
        when it does not answer or does not get cold.
        """
        await self.close()
        try:
            await self._thread.run(self._connect)
            await self._run(QEProWire.abort)  # of an integration that somebody left behind
            await self._run(QEProWire.set_cooler, self._cooler_set_point)
            await self.wait_until_cold()
            # from now on it is known which spectra are old ones
            await self.expose(self.integration_limits[0])
        except (DriverError, asyncio.CancelledError):
            await self.close()
            raise

    async def close(self) -> None:
        """Disconnect; harmless when not connected. The cooler is left on, so that a reopening is quick."""
        await self._thread.finish(self._disconnect)

    async def identity(self) -> str:
        """Maker, model, serial number, and the revisions where the device tells them."""
        return self._opened().identity

    async def wavelengths(self) -> FloatArray:
        """[1044] nanometres: the device's polynomial in the pixel index."""
        return self._opened().wavelengths

    async def nonlinearity(self) -> FloatArray:
        """[coefficients] of the polynomial to divide by; [1.0] for a device that was never characterised."""
        return self._opened().nonlinearity

    async def temperature(self) -> float:
        """Of the detector now, degrees Celsius."""
        temperature = await self._run(QEProWire.ask, TEMPERATURE, "<f")
        if not math.isfinite(temperature):
            raise ProtocolError(f"{self.name}: says that its detector is at {temperature} °C; switch it off and on")
        return temperature

    async def wait_until_cold(self) -> None:
        """Wait until the cooler is stable and the detector at its set point.

        Raises `DeviceFault` when the cooler is off, `DeviceTimeout` when it takes longer than `COOLING_TIME`.
        """
        begin = self._clock.now()
        while True:
            # the time is taken before the questions: another task may let much of it pass before the answers
            elapsed = self._clock.now() - begin
            temperature = await self.temperature()
            if await self._run(QEProWire.ask, COOLER_STABLE, "<B") and self._is_cold(temperature):
                return
            if not await self._run(QEProWire.ask, COOLER_ENABLED, "<B"):
                raise DeviceFault(f"{self.name}: the cooler is off; reopen the device, which switches it on")
            if elapsed > COOLING_TIME:
                message = f"{self.name}: the detector is at {temperature:.1f} °C after {COOLING_TIME:g} s; it should"
                raise DeviceTimeout(message + f" rest at {self._cooler_set_point:g} °C: is the room too warm?")
            await self._clock.sleep(COOLING_POLL)

    async def expose(self, integration_time: float) -> Spectrum:
        """Integrate once for `integration_time` seconds.

        What the device integrates on its own is thrown away first. A spectrum that is not the one asked for, or gets
        lost, is taken again. Raises `ProtocolError` when nothing else comes, `DeviceTimeout` when it takes longer,
        `DeviceRefused` outside the limits, `DeviceFault` when the detector is not cold or the device was restarted
        since it was opened. When cancelled it ends at once and aborts the integration.
        """

        async def take() -> Taken:
            request = await self._run(QEProWire.begin, microseconds)
            began = self._clock.now()
            # a long wait is spent on the clock, where it can be cancelled, and not in the device's thread
            await self._clock.sleep(integration_time)
            return began, [await self._run(QEProWire.finish, request)]

        microseconds = self._microseconds(integration_time)
        return (await self._acquire(take, microseconds, TriggerMode.NORMAL, ATTEMPTS))[0]

    async def sequence(self, integration_time: float, scans: int) -> list[Spectrum]:
        """`scans` spectra of `integration_time` seconds each, taken back to back into the device's own buffer.

        Their counts are consecutive and their ticks at least one integration time apart; otherwise all are taken
        again. Raises as `expose` does, and `DeviceRefused` when the buffer has no room for so many.
        """

        async def take() -> Taken:
            return await self._collect(await self.begin_sequence(integration_time, scans))

        return await self._acquire(take, self._microseconds(integration_time), TriggerMode.NORMAL, ATTEMPTS)

    async def begin_sequence(self, integration_time: float, scans: int) -> Begun:
        """Begin to take `scans` spectra of `integration_time` seconds each, back to back, into the device's own buffer.

        Raises `DeviceRefused` outside the limits or when the buffer has no room for so many, and `DeviceFault` when
        the device was restarted since it was opened.
        """
        microseconds, largest = self._microseconds(integration_time), self._opened().largest_buffer
        if not 1 <= scans <= largest:
            raise DeviceRefused(f"{self.name}: cannot take {scans} spectra in a row; ask for 1 to {largest}")
        self._check_trust()
        await self._run(QEProWire.fill, microseconds, TriggerMode.NORMAL, scans)
        return Begun(integration_time, scans, self._clock.now())

    async def collect_sequence(self, begun: Begun) -> list[Spectrum]:
        """Wait for the spectra that `begin_sequence` began.

        The first one began when the device acknowledged, the others when its ticks say. Raises as `sequence` does, but
        a spectrum that is not the one asked for is an error at once.
        """
        microseconds = self._microseconds(begun.integration_time)
        return await self._acquire(lambda: self._collect(begun), microseconds, TriggerMode.NORMAL, 1)

    async def _collect(self, begun: Begun) -> Taken:
        time, scans = begun.integration_time, begun.scans
        for number in range(1, scans + 1):
            await self._clock.sleep(max(begun.moment + number * time - self._clock.now(), 0.0))
            late = f"{self.name}: spectrum {number} of {scans} of {time:g} s is not there in time"
            await self._buffered(number, self._timeout, late + "; switch the device off and on")
        return begun.moment, await self._run(QEProWire.read_buffer, scans)

    async def expose_on_trigger(self, mode: TriggerMode, integration_time: float, within: float) -> Spectrum:
        """Integrate once, when an external pulse says so, within so many seconds.

        Raises as `expose` does, and `DeviceTimeout` when no pulse comes. A spectrum that is not the one asked for is
        an error at once, because the pulse does not come back.
        """

        async def take() -> Taken:
            await self._run(QEProWire.fill, microseconds, mode, 1)
            late = f"{self.name}: no spectrum came within {within:g} s of waiting for a trigger; check its cable"
            await self._buffered(1, within + integration_time + self._timeout, late)
            return None, await self._run(QEProWire.read_buffer, 1)

        microseconds = self._microseconds(integration_time)
        return (await self._acquire(take, microseconds, mode, 1))[0]

    async def change(self, setting: Setting, value: int) -> None:
        """Set the lamp or the shutter and read it back where the device can tell.

        Raises `DeviceRefused` when it says no, `DeviceFault` when it says yes and does not.
        """
        await self._run(QEProWire.set, setting, struct.pack(setting.layout, value))

    async def gpio(self) -> Gpio:
        """Directions and levels of the general-purpose pins."""
        outputs = await self._run(QEProWire.ask, GPIO_OUTPUTS.query, "<L")
        levels = await self._run(QEProWire.ask, GPIO_LEVELS.query, "<L")
        return Gpio(int(outputs), int(levels))

    async def set_gpio_outputs(self, outputs: int, mask: int) -> None:
        """Make pins outputs (1) or inputs (0); only those with a 1 in `mask`. Raises as `change` does."""
        await self._run(QEProWire.set_pins, GPIO_OUTPUTS, outputs, mask)

    async def set_gpio_levels(self, levels: int, mask: int) -> None:
        """Drive output pins high (1) or low (0); only those with a 1 in `mask`. Raises as `change` does."""
        await self._run(QEProWire.set_pins, GPIO_LEVELS, levels, mask)

    # what every acquisition shares

    def _microseconds(self, integration_time: float) -> int:
        low, high = self.integration_limits
        if not low <= integration_time < high:
            message = f"{self.name}: cannot integrate for {integration_time:g} s; ask for {low:g} s to {high:g} s"
            raise DeviceRefused(message)
        return round(integration_time * 1e6)

    async def _acquire(
        self, take: Callable[[], Awaitable[Taken]], microseconds: int, mode: TriggerMode, attempts: int
    ) -> list[Spectrum]:
        """What `take` brings, once it is what was asked for."""
        self._check_trust()
        began: float | None = None
        readings: list[Reading] = []
        for attempt in range(1, attempts + 1):
            try:
                began, readings = await take()
                wrong = self._what_is_wrong(readings, microseconds, mode)
            except ProtocolError as error:
                wrong = str(error)
            except asyncio.CancelledError:
                with contextlib.suppress(DriverError):  # the next acquisition begins with an abort in any case
                    await asyncio.shield(self._run(QEProWire.abort))
                raise
            if not wrong:
                temperature = await self.temperature()
                self._check_temperature(temperature)
                return [
                    Spectrum(r.counts, r.microseconds / 1e6, r.count, temperature, _began(began, readings[0], r))
                    for r in readings
                ]
            await self._run(QEProWire.forget_settings)
            log.warning("%s: %s (attempt %d of %d)", self.name, wrong, attempt, attempts)
        if any(_is_older(reading, self._newest) for reading in readings):
            self._distrust = f"{self.name}: {wrong}: it was restarted; reopen it, for its settings are lost"
            raise DeviceFault(self._distrust)
        message = f"{self.name}: delivered {attempts} stale spectra where {microseconds / 1e6:g} s were set"
        raise ProtocolError(f"{message}, the last time: {wrong}; switch the device off and on")

    def _what_is_wrong(self, readings: list[Reading], microseconds: int, mode: TriggerMode) -> str:
        """Why these are not what was asked for; empty when they are."""
        before: Reading | None = None
        for reading in readings:
            newest = self._newest
            if newest and _is_older(reading, newest):
                told = f"spectrum {reading.count} at tick {reading.tick}"
                return f"{told} came after {newest.count} at {newest.tick}"
            if newest and reading.count == newest.count:
                return f"spectrum {reading.count} came again"
            self._newest = reading
            if (reading.microseconds, reading.mode) != (microseconds, mode):
                return f"a spectrum of {reading.microseconds / 1e6:g} s in trigger mode {reading.mode} came"
            if before is not None and reading.count != before.count + 1:
                return f"spectrum {reading.count} came next after {before.count}"
            if before is not None and reading.tick - before.tick < TICK_SLACK * microseconds:
                return f"two spectra are only {reading.tick - before.tick} ticks apart"
            before = reading
        return ""

    def _check_trust(self) -> None:
        if self._distrust:
            raise DeviceFault(self._distrust)

    def _is_cold(self, temperature: float) -> bool:
        return abs(temperature - self._cooler_set_point) <= self._temperature_tolerance

    def _check_temperature(self, temperature: float) -> None:
        if not self._is_cold(temperature):
            message = f"{self.name}: the detector is at {temperature:.2f} °C instead of {self._cooler_set_point:g} °C"
            raise DeviceFault(message + "; the spectrum is thrown away: check the cooler and wait until it is cold")

    async def _buffered(self, number: int, seconds: float, late: str) -> None:
        """Wait until the buffer holds `number` spectra. Raises `DeviceTimeout(late)` after `seconds`."""
        begin = self._clock.now()
        while True:
            elapsed = self._clock.now() - begin
            if await self._run(QEProWire.ask, BUFFERED, "<L") >= number:
                return
            if elapsed > seconds:
                await self._run(QEProWire.abort)
                raise DeviceTimeout(late)
            await self._clock.sleep(POLL)

    async def _run(self, call: Callable[..., T], *arguments: object) -> T:
        """Run a method of `QEProWire` in the device's thread. Raises `DeviceDisconnected` when it is not open."""
        if self._wire is None:  # no thread begins for a device that is closed
            raise DeviceDisconnected(f"{self.name}: is not open; open the device first")
        return await self._thread.run(call, self._wire, *arguments)

    def _opened(self) -> Known:
        if self._known is None:
            raise DeviceDisconnected(f"{self.name}: is not open; open the device first")
        return self._known

    # these two run in the device's thread

    def _connect(self) -> None:
        self._wire = QEProWire(self.name, self._serial_number, self._usb_backend, self._timeout)
        self._known = self._wire.known()
        self._newest, self._distrust = None, ""

    def _disconnect(self) -> None:
        wire, self._wire, self._known = self._wire, None, None
        if wire is not None:
            wire.close()


def _is_older(reading: Reading, newest: Reading | None) -> bool:
    """Whether a spectrum is from before `newest`, or from before a restart; not whether it is the same again."""
    if newest is None or (reading.count, reading.tick) == (newest.count, newest.tick):
        return False
    return reading.count <= newest.count or reading.tick <= newest.tick


def _began(first: float | None, earliest: Reading, reading: Reading) -> float | None:
    """When the integration of a reading began, as its ticks say, where the first of its row began at `first`."""
    return None if first is None else first + (reading.tick - earliest.tick) * 1e-6


class QEProLight:
    """The `Light` that a QE Pro switches: the lamp and the shutter on its accessory connector."""

    def __init__(self, qepro: QEPro) -> None:
        self._qepro = qepro

    async def set_lamp(self, on: bool) -> None:
        """Switch the lamp, and read it back where the firmware can."""
        await self._qepro.change(LAMP, on)

    async def set_shutter(self, is_open: bool) -> None:
        """Open or close the shutter; a closed shutter gives a dark signal. The device cannot tell where it is."""
        await self._qepro.change(SHUTTER, is_open)
