"""What is struck: a simulated device of each family, the driver connected to it, and a day's work for both."""

import asyncio
from abc import ABC, abstractmethod
from typing import Any

import numpy as np

from drivers.arrays import CountArray
from drivers.errors import DriverError
from drivers.interfaces import StagePhase
from drivers.qepro import QEPro, QEProLight
from drivers.stage import Stage
from simulators.devices.clock import SimulatedClock
from simulators.devices.motion import Axis
from simulators.devices.qepro import QEProFaults, SimulatedQEPro
from tests.stage_bench import FAMILIES, PATIENCE, HeldClock, give_time

NAME = "device under test"
"""Of each driver, and of its threads."""
TIMEOUT = 0.1
"""Real seconds that a driver waits for a reply; a fault that lasts, lasts a little longer than that."""
LASTS = 0.12
SAME_ANGLE = 0.02
"""Degrees between the angle that a driver returns and where the axis stands."""


class Rig(ABC):
    """A simulated device, the driver connected to it, and a day's work."""

    simulator: Any
    driver: Any

    def __init__(self, breaches: list[str]) -> None:
        self.clock = HeldClock()
        self.breaches = breaches

    @abstractmethod
    async def work(self) -> None:
        """What is done with the device every day, once it is open."""

    @abstractmethod
    async def revive(self) -> None:
        """Make the device usable after a fault, as the bench does."""

    @abstractmethod
    def repair(self) -> None:
        """Put right what only a person can."""

    def give_time(self) -> None:  # noqa: B027  (what is no line is never late)
        """Wait for replies as long as a busy machine may need: nothing befalls the device."""

    def close(self) -> None:  # noqa: B027  (a device without a thread has nothing to switch off)
        """Switch the simulator off."""


class StageRig(Rig):
    """A stage of one family."""

    def __init__(self, breaches: list[str], family: str) -> None:
        super().__init__(breaches)
        self.axis = Axis(self.clock, start=3.0, velocity=20.0, acceleration=40.0, limits=(-95.0, 180.0))
        self.simulator = FAMILIES[family].simulate(self.axis, self.clock)
        self.driver = FAMILIES[family].drive(NAME, self.simulator.start(), self.clock, timeout=TIMEOUT)

    async def work(self) -> None:
        """Home, move, stop in the middle of a move, move."""
        stage: Stage = self.driver
        await stage.home()
        for angle in (12.5, 40.0):
            self._check(angle, await stage.move_to(angle))
        await self._stop_halfway(stage, -4.0)
        self._check(21.25, await stage.move_to(21.25))
        await stage.set_velocity(8.0)
        self._check(20.0, await stage.move_to(20.0))
        self._check(20.0, await stage.position())
        await stage.identity()

    def _check(self, wanted: float, reached: float) -> None:
        if abs(reached - wanted) > 0.1:
            self.breaches.append(f"returned {reached:.3f}° for {wanted:.3f}°")
        if abs(reached - self.axis.position()) > SAME_ANGLE:
            self.breaches.append(f"returned {reached:.3f}° while it stands at {self.axis.position():.3f}°")

    async def _stop_halfway(self, stage: Stage, target: float) -> None:
        clock = self.clock
        under_way = clock.hold()
        move = asyncio.create_task(stage.move_to(target))
        held = asyncio.create_task(under_way.wait())
        await asyncio.wait({move, held}, return_when=asyncio.FIRST_COMPLETED)
        held.cancel()
        clock.waiting = None
        moving = self.axis.moving()
        try:
            await stage.stop()
            if moving:
                clock.advance_to(clock.now() + 5.0)
                if abs(self.axis.position() - target) < 0.1:
                    self.breaches.append("went on to its target although the stop was said to be taken")
        finally:
            clock.released.set()
            await asyncio.wait({move})
            move.exception()  # that a stopped move does not arrive is no fault
        begin = clock.now()
        while (await stage.state()).phase is StagePhase.MOVING and clock.now() < begin + 10.0:
            await clock.sleep(0.5)

    async def revive(self) -> None:
        """Reopen a stage that does not answer, home one that is not ready."""
        stage: Stage = self.driver
        try:
            state = await stage.state()
        except DriverError:
            await stage.close()
            await stage.open()
            state = await stage.state()
        if state.phase in {StagePhase.MOVING, StagePhase.HOMING}:
            await stage.stop()
            await self.clock.sleep(10.0)
            state = await stage.state()
        if state.phase is not StagePhase.READY:
            await stage.home()

    def repair(self) -> None:
        """Undo a drift and a slowness, which a driver cannot clear, and a refusal that is still to come."""
        sound = {"_encoder_error": 0.0, "_drift": 0.0, "_zero": 0.0, "_slowness": 1.0, "_refusing": False}
        for name, value in sound.items():
            if hasattr(self.simulator, name):
                setattr(self.simulator, name, value)

    def give_time(self) -> None:
        """Wait for replies as long as a busy machine may need."""
        give_time(PATIENCE, self.driver)

    def close(self) -> None:
        """Switch the simulator off."""
        self.simulator.close()


class Glow:
    """A detector whose counts tell when the integration ended, how long it was, the shutter and the lamp."""

    pixels = 1044
    wavelength_coefficients: tuple[float, ...] = (345.25, 0.8, -1e-5, -2e-9)
    nonlinearity_coefficients: tuple[float, ...] = (0.875, 2.0**-20, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)

    def __init__(self, clock: SimulatedClock) -> None:
        self.clock = clock

    def read_out(
        self, integration_time: float, *, shutter_open: bool, lamp_on: bool, sensor_temperature: float, ended: float
    ) -> CountArray:
        """[1044] all alike but the first, which is the moment in hundredths of a second."""
        counts = np.full(self.pixels, glow(integration_time, shutter_open, lamp_on))
        counts[0] = round(100 * self.clock.now())
        return counts.astype(np.uint32)


def glow(integration_time: float, shutter_open: bool, lamp_on: bool) -> int:
    """Counts of `Glow`."""
    return round(10_000 + 1000 * integration_time) + 1000 * shutter_open + 2000 * lamp_on


class SpectrometerRig(Rig):
    """A QE Pro."""

    def __init__(self, breaches: list[str]) -> None:
        super().__init__(breaches)
        self.simulator = SimulatedQEPro(Glow(self.clock), self.clock)
        self.driver = QEPro(NAME, self.clock, usb_backend=self.simulator, timeout=TIMEOUT)

    async def work(self) -> None:
        """Dark and light spectra of several integration times, one by one and in a row."""
        qepro: QEPro = self.driver
        light = QEProLight(qepro)
        await light.set_lamp(True)
        for is_open in (False, True):
            await light.set_shutter(is_open)
            for seconds in (0.1, 0.5, 0.1):
                begin = self.clock.now()
                self._check(await qepro.expose(seconds), seconds, is_open, begin)
        begin = self.clock.now()
        for spectrum in await qepro.sequence(0.2, 3):
            self._check(spectrum, 0.2, True, begin)
        await qepro.wait_until_cold()
        await qepro.identity()

    def _check(self, spectrum: Any, seconds: float, shutter_open: bool, begin: float) -> None:
        expected = glow(seconds, shutter_open, True)
        if spectrum.integration_time != seconds or not (spectrum.counts[1:] == expected).all():
            self.breaches.append(f"took {spectrum.counts[1]} counts of {spectrum.integration_time} s for {expected}")
        if spectrum.counts[0] < round(100 * (begin + seconds)) - 1:
            self.breaches.append("took a spectrum that had begun before it was asked for")
        if abs(spectrum.detector_temperature + 10.0) > 0.5:
            self.breaches.append(f"took a spectrum at {spectrum.detector_temperature:.1f} °C")

    async def revive(self) -> None:
        """Open it again, which cools it."""
        await self.driver.open()

    def repair(self) -> None:
        """Mend the electronics and the cooler."""
        self.simulator.faults = QEProFaults()
        self.simulator._refusing = False


DEVICES = (*FAMILIES, "QE Pro")


def make_rig(device: str, breaches: list[str]) -> Rig:
    """One of `DEVICES`; what must never happen is added to `breaches`."""
    return StageRig(breaches, device) if device in FAMILIES else SpectrometerRig(breaches)
