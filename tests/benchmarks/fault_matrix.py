"""Every fault on every device, while the driver does its daily work; run as a script it prints the matrix as a table.

A strike is one run: the device is opened, homed and used while a fault befalls it, then it is made usable again as
the bench would do it (`Instrument.recover`) and must work as on the first day. What must never happen is noted as a
breach: something false taken for data, a wait without end, an error that has no type, a thread or descriptor left.
"""

import asyncio
import contextlib
import logging
import os
import random
import sys
import threading
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from drivers.arrays import CountArray
from drivers.errors import DriverError
from drivers.interfaces import StagePhase
from drivers.k10cr1 import K10CR1
from drivers.modbus_line import PAUSES
from drivers.oriental_az import OrientalAZ
from drivers.owis import OwisPS
from drivers.qepro import QEPro, QEProLight
from drivers.serial_port import ATTEMPTS
from drivers.smc100 import SMC100
from drivers.stage import Stage
from simulators.clock import SimulatedClock
from simulators.faults import LASTING, Fault, FaultScript, Kind
from simulators.k10cr1 import SimulatedK10CR1
from simulators.motion import Axis
from simulators.oriental_az import SimulatedOrientalAZ
from simulators.owis import SimulatedOwisPS
from simulators.qepro import QEProFaults, SimulatedQEPro
from simulators.smc100 import SimulatedSMC100

NAME = "device under test"
"""Of each driver, and of its threads."""
TIMEOUT = 0.1
"""Real seconds that a driver waits for a reply; a fault that lasts, lasts a little longer than that."""
LASTS = 0.12
SAME_ANGLE = 0.02
"""Degrees between the angle that a driver returns and where the axis stands."""
COUNTS_PER_DEGREE = 1000.0
BLIND = {("K10CR1", Kind.DRIFT)}
"""What a driver cannot see: a mount without encoder that has lost steps."""


class HeldClock(SimulatedClock):
    """A clock on which one wait can be held in its middle, so that a stop comes while a stage moves."""

    def __init__(self) -> None:
        super().__init__()
        self.hold = False
        self.held = asyncio.Event()
        self.let_go = asyncio.Event()

    async def sleep(self, seconds: float) -> None:
        """Let `seconds` pass, after half of them only when the holder lets go."""
        if self.hold:
            self.hold = False
            self.advance_to(self.now() + seconds / 2)
            self.held.set()
            await self.let_go.wait()
        await super().sleep(seconds)


@dataclass
class Strike:
    """What came of one fault."""

    outcome: str = "ok"
    """"ok" where nobody noticed, "recovered" where something was tried again, else the name of the error."""
    retries: int = 0
    """Warnings of the driver."""
    happened: int = 0
    """How many requests were befallen."""
    seconds: float = 0.0
    """Real seconds, the work afterwards not included."""
    breaches: list[str] = field(default_factory=list)
    """What must never happen."""


class Rig:
    """A simulated device, the driver connected to it, and a day's work."""

    simulator: Any
    driver: Any

    def __init__(self, breaches: list[str]) -> None:
        self.clock = HeldClock()
        self.breaches = breaches

    async def work(self) -> None:
        """What is done with the device every day, once it is open."""
        raise NotImplementedError

    async def revive(self) -> None:
        """Make the device usable after a fault, as the bench does."""
        raise NotImplementedError

    def repair(self) -> None:
        """Put right what only a person can."""
        raise NotImplementedError

    def close(self) -> None:
        """Switch the simulator off."""


class StageRig(Rig):
    """A stage of one family."""

    def __init__(self, breaches: list[str], family: str) -> None:
        super().__init__(breaches)
        self.axis = Axis(self.clock, start=3.0, velocity=20.0, acceleration=40.0, limits=(-95.0, 180.0))
        self.simulator, self.driver = FAMILIES[family](self.axis, self.clock)

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
        clock.held, clock.let_go, clock.hold = asyncio.Event(), asyncio.Event(), True
        move = asyncio.create_task(stage.move_to(target))
        held = asyncio.create_task(clock.held.wait())
        await asyncio.wait({move, held}, return_when=asyncio.FIRST_COMPLETED)
        held.cancel()
        clock.hold = False
        moving = self.axis.moving()
        try:
            await stage.stop()
            if moving:
                clock.advance_to(clock.now() + 5.0)
                if abs(self.axis.position() - target) < 0.1:
                    self.breaches.append("went on to its target although the stop was said to be taken")
        finally:
            clock.let_go.set()
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
        """Undo a drift and a slowness, which are no faults that a driver could clear."""
        for name, value in {"_encoder_error": 0.0, "_drift": 0.0, "_zero": 0.0, "_slowness": 1.0}.items():
            if hasattr(self.simulator, name):
                setattr(self.simulator, name, value)

    def close(self) -> None:
        """Switch the simulator off."""
        self.simulator.close()


class Glow:
    """A detector whose counts tell when the integration ended, how long it was, the shutter and the lamp."""

    pixels = 1044
    wavelength_coefficients = (345.25, 0.8, -1e-5, -2e-9)
    nonlinearity_coefficients = (0.875, 2.0**-20, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)

    def __init__(self, clock: SimulatedClock) -> None:
        self.clock = clock

    def read_out(
        self, integration_time: float, *, shutter_open: bool, lamp_on: bool, sensor_temperature: float
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


def _owis(axis: Axis, clock: SimulatedClock) -> tuple[Any, Stage]:
    simulator = SimulatedOwisPS([axis], clock, counts_per_degree=COUNTS_PER_DEGREE)
    return simulator, OwisPS(NAME, simulator.start(), clock, counts_per_degree=COUNTS_PER_DEGREE, timeout=TIMEOUT)


def _smc100(axis: Axis, clock: SimulatedClock) -> tuple[Any, Stage]:
    simulator = SimulatedSMC100(axis)
    return simulator, SMC100(NAME, simulator.start(), clock, timeout=TIMEOUT)


def _k10cr1(axis: Axis, clock: SimulatedClock) -> tuple[Any, Stage]:
    simulator = SimulatedK10CR1(axis)
    return simulator, K10CR1(NAME, simulator.start(), clock, timeout=TIMEOUT)


def _oriental(*, rtu: bool) -> Callable[[Axis, SimulatedClock], tuple[Any, Stage]]:
    def make(axis: Axis, clock: SimulatedClock) -> tuple[Any, Stage]:
        simulator = SimulatedOrientalAZ(axis, rtu=rtu)
        return simulator, OrientalAZ(NAME, simulator.start(), clock, timeout=TIMEOUT)

    return make


FAMILIES: dict[str, Callable[[Axis, SimulatedClock], tuple[Any, Stage]]] = {
    "SMC100": _smc100,
    "OWIS PS": _owis,
    "K10CR1": _k10cr1,
    "AZ on TCP": _oriental(rtu=False),
    "AZ on RTU": _oriental(rtu=True),
}
"""What makes the simulator and the driver of each family of stages."""
DEVICES = (*FAMILIES, "QE Pro")


class _Warnings(logging.Handler):
    """Counts the warnings of the drivers."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.count = 0

    def emit(self, record: logging.LogRecord) -> None:
        self.count += 1


def longest(device: str, happened: int) -> float:
    """Real seconds that a run may take in which so many requests were befallen.

    The work without faults takes far less than two seconds. A request that was befallen may cost all attempts, each
    with bringing the line back into step first, which on a serial Modbus line is tried once for each of `PAUSES`.
    """
    step = sum(PAUSES) + (1 + len(PAUSES)) * TIMEOUT if device == "AZ on RTU" else TIMEOUT
    return 10.0 + happened * (ATTEMPTS + 1) * (TIMEOUT + LASTS + step)


def requests_of(device: str) -> int:
    """How many requests a day's work takes where nothing goes wrong."""
    rig = _rig(device, [])

    async def day() -> None:
        await rig.driver.open()
        await rig.work()
        await rig.driver.close()

    try:
        asyncio.run(day())
    finally:
        rig.close()
    return int(rig.simulator.script.requests)


def strike(device: str, kind: Kind, at: int, *, times: int = 1, seed: int = 0) -> Strike:
    """Let `kind` befall the request `at` and those after it, `times` in all, on a day's work with `device`."""
    result = Strike()
    before = _descriptors()
    rig = _rig(device, result.breaches)
    rig.simulator.script = FaultScript([Fault(kind, at, times, seconds=LASTS if kind in LASTING else 0.0)], seed)
    script = rig.simulator.script
    warnings = _Warnings()
    logger = logging.getLogger("drivers")
    logger.addHandler(warnings)
    propagate, logger.propagate = logger.propagate, False
    try:
        asyncio.run(_day(device, rig, result, warnings))
    finally:
        logger.removeHandler(warnings)
        logger.propagate = propagate
        rig.close()
    result.happened = len(script.happened)
    if (device, kind) in BLIND:
        result.breaches[:] = [breach for breach in result.breaches if "while it stands at" not in breach]
    _look_for_leaks(before, result)
    return result


def _rig(device: str, breaches: list[str]) -> Rig:
    return StageRig(breaches, device) if device in FAMILIES else SpectrometerRig(breaches)


async def _day(device: str, rig: Rig, result: Strike, warnings: _Warnings) -> None:
    begin = time.monotonic()
    script = rig.simulator.script

    async def day() -> None:
        await rig.driver.open()
        await rig.work()

    await _bounded(device, day, result, script)
    result.seconds = time.monotonic() - begin
    result.retries = warnings.count
    if result.outcome == "ok" and warnings.count:
        result.outcome = "recovered"
    # a person has repaired what is broken; the bench does the rest
    rig.simulator.script = FaultScript()
    rig.repair()
    await _bounded_revival(rig, result)
    await rig.driver.close()
    await rig.driver.close()


async def _bounded(device: str, work: Callable[[], Awaitable[None]], result: Strike, script: FaultScript) -> None:
    """Do `work` and note how it ends; one that does not end is a breach."""
    task = asyncio.ensure_future(work())
    begin = time.monotonic()
    while not task.done():
        await asyncio.wait({task}, timeout=0.5)
        if time.monotonic() - begin > longest(device, len(script.happened)):
            task.cancel()
            await asyncio.wait({task}, timeout=5.0)
            result.breaches.append(f"hung for {time.monotonic() - begin:.1f} s")
            return
    error = task.exception()
    if isinstance(error, DriverError):
        result.outcome = type(error).__name__
        if not str(error).startswith(NAME):
            result.breaches.append(f"an error that does not name the device: {error}")
    elif error is not None:
        result.breaches.append(f"an error without a type: {error!r}")


async def _bounded_revival(rig: Rig, result: Strike) -> None:
    """The device must work again, once a cable that was pulled is back."""
    failure: DriverError | None = None
    for _ in range(5):
        try:
            async with asyncio.timeout(20.0):
                await rig.revive()
                failure = None
            break
        except DriverError as error:
            failure = error
            await rig.clock.sleep(5.0)
            await asyncio.sleep(LASTS / 2)
    try:
        async with asyncio.timeout(20.0):
            if failure is not None:
                raise failure
            await rig.work()
    except (DriverError, TimeoutError) as error:
        result.breaches.append(f"does not work again: {error!r}")


def _descriptors() -> int:
    with contextlib.suppress(FileNotFoundError):
        return len(os.listdir("/proc/self/fd"))
    return 0


def _look_for_leaks(descriptors: int, result: Strike) -> None:
    deadline = time.monotonic() + 3.0
    while True:
        threads = [thread.name for thread in threading.enumerate() if thread.name.startswith((NAME, "simulated "))]
        left = _descriptors() - descriptors
        if not threads and left <= 0:
            return
        if time.monotonic() > deadline:
            result.breaches.append(f"left {left} descriptors and the threads {threads}")
            return
        time.sleep(0.005)


def moments(device: str, kind: Kind, count: int, requests: int) -> list[tuple[int, int]]:
    """When to strike and how many requests in a row: spread over the day; the last blow is a longer one."""
    chance = random.Random(f"{device} {kind}")
    blows = []
    for number in range(count):
        at = 1 + int(requests * (number + chance.random()) / count)
        blows.append((at, 6 if number == count - 1 and count > 1 else 1))
    return blows


def main(count: int) -> int:
    """Print the matrix with `count` strikes in each cell; returns 1 where there was a breach."""
    requests = {device: requests_of(device) for device in DEVICES}
    print("requests of a day's work:", ", ".join(f"{device} {number}" for device, number in requests.items()))
    print(f"{'':14}" + "".join(f"{device:>27}" for device in DEVICES))
    breaches = []
    for kind in Kind:
        row = f"{kind:14}"
        for device in DEVICES:
            strikes = [
                strike(device, kind, at, times=times, seed=at)
                for at, times in moments(device, kind, count, requests[device])
            ]
            breaches += [f"{kind} on {device}: {breach}" for s in strikes for breach in s.breaches]
            names = list(dict.fromkeys(s.outcome for s in strikes))
            words = "/".join(name.replace("Device", "").replace("Error", "") for name in names)
            retries = sum(s.retries for s in strikes)
            row += f"{words}{f'({retries})' if retries else ''} {max(s.seconds for s in strikes):.2f} s".rjust(27)
        print(row, flush=True)
    print(*breaches, sep="\n")
    print(f"{len(breaches)} breaches in {count * len(Kind) * len(DEVICES)} strikes")
    return bool(breaches)


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]) if len(sys.argv) > 1 else 4))
