"""A simulated stage of any family with its driver, and a clock that can be held in the middle of a move."""

import asyncio
import sys
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Generic, TypeVar

from drivers.errors import DriverError
from drivers.interfaces import StagePhase
from drivers.k10cr1 import K10CR1
from drivers.oriental_az import OrientalAZ
from drivers.owis import OwisPS
from drivers.smc100 import SMC100
from drivers.stage import Stage
from simulators.devices.clock import SimulatedClock
from simulators.devices.faults import FaultScript
from simulators.devices.k10cr1 import SimulatedK10CR1
from simulators.devices.motion import Axis
from simulators.devices.oriental_az import SimulatedOrientalAZ
from simulators.devices.owis import SimulatedOwisPS
from simulators.devices.smc100 import SimulatedSMC100

NAME = "sample stage"
COUNTS_PER_DEGREE = 1000.0
"""Of an OWIS stage."""
HAS_TERMINALS = sys.platform != "win32"
PATIENCE = 1.0
"""Real seconds that a driver waits for a reply of a sound device, which may come late on a busy machine."""

S = TypeVar("S", bound=Stage)


class HeldClock(SimulatedClock):
    """A clock on which the next wait lasts until the test lets go, so that it can act in the middle of a move."""

    def __init__(self) -> None:
        super().__init__()
        self.waiting: asyncio.Event | None = None
        self.released = asyncio.Event()

    def hold(self) -> asyncio.Event:
        """Hold the next wait and return the event that tells when it has begun."""
        self.waiting, self.released = asyncio.Event(), asyncio.Event()
        return self.waiting

    async def sleep(self, seconds: float) -> None:
        """Let `seconds` pass, of a wait that is held the second half only after `released`."""
        if self.waiting is not None:
            waiting, self.waiting = self.waiting, None
            self.advance_to(self.now() + seconds / 2)
            waiting.set()
            await self.released.wait()
        await super().sleep(seconds)


@dataclass(frozen=True)
class Family(Generic[S]):
    """What makes the simulator and the driver of a family of stages."""

    simulate: Callable[[Axis, SimulatedClock], Any]
    drive: Callable[..., S]
    """Called with name, URL, clock and options by name."""
    terminal: str | None = ""
    """What stands in front of the path of a terminal in a URL; None where it is no serial line."""


def _ps90(axis: Axis, clock: SimulatedClock) -> SimulatedOwisPS:
    """Its second axis is the one that is looked at."""
    first, third = (Axis(clock, velocity=5.0, acceleration=5.0, limits=(-20.0, 100.0)) for _ in range(2))
    return SimulatedOwisPS([first, axis, third], clock, counts_per_degree=COUNTS_PER_DEGREE)


FAMILIES: dict[str, Family[Any]] = {
    "SMC100": Family(lambda axis, clock: SimulatedSMC100(axis), SMC100),
    "OWIS PS": Family(_ps90, partial(OwisPS, axis=2, counts_per_degree=COUNTS_PER_DEGREE)),
    "K10CR1": Family(lambda axis, clock: SimulatedK10CR1(axis), K10CR1),
    "AZ on TCP": Family(lambda axis, clock: SimulatedOrientalAZ(axis), OrientalAZ, terminal=None),
    # a pseudo-terminal knows no parity
    "AZ on RTU": Family(
        lambda axis, clock: SimulatedOrientalAZ(axis, rtu=True), partial(OrientalAZ, parity="N"), terminal="rtu://"
    ),
}


class Bench(Generic[S]):
    """A simulated stage, and the driver connected to it.

    It hangs on a pseudo-terminal where there is one, unless a `socket` is wanted: pyserial sleeps when it closes that.
    Drivers wait `timeout` for a reply while there are faults in the script, and from the next `run` or `befall` on at
    least `PATIENCE` where there are none.
    """

    def __init__(
        self,
        family: Family[S],
        *,
        start: float = 12.0,
        velocity: float = 20.0,
        acceleration: float = 40.0,
        limits: tuple[float, float] = (-20.0, 100.0),
        socket: bool = False,
        timeout: float = 0.1,
    ) -> None:
        self._timeout = timeout
        self._driven: list[tuple[S, float]] = []
        self.clock = HeldClock()
        self.axis = Axis(self.clock, start=start, velocity=velocity, acceleration=acceleration, limits=limits)
        self.simulator = family.simulate(self.axis, self.clock)
        self._family = family
        self._socket = socket or not HAS_TERMINALS or family.terminal is None
        self.url = self.plug_in()
        self.stage = self.driver()

    def plug_in(self) -> str:
        """Begin to listen, at the same URL as before."""
        if self._socket:
            url: str = self.simulator.start()
            return url
        return f"{self._family.terminal}{self.simulator.start_pty()}"

    def driver(self, *, timeout: float | None = None, **options: Any) -> S:
        """Another driver for the same device."""
        timeout = timeout or self._timeout
        stage = self._family.drive(NAME, self.url, self.clock, timeout=timeout, **options)
        self._driven.append((stage, timeout))
        return stage

    def befall(self, script: str, seed: int = 0) -> None:
        """Let faults befall the requests from now on."""
        self.simulator.script = FaultScript.parse(script, seed)
        self._give_time()

    def _give_time(self) -> None:
        for stage, timeout in self._driven:
            give_time(timeout if self.simulator.script.faults else max(timeout, PATIENCE), stage)

    def run(self, scenario: Callable[[S], Awaitable[None]], stage: S | None = None, *, homed: bool = True) -> None:
        """Open a stage, home it, let the scenario happen and close it."""
        stage = stage or self.stage
        self._give_time()

        async def whole() -> None:
            await stage.open()
            try:
                if homed:
                    await stage.home()
                await scenario(stage)
            finally:
                await stage.close()

        asyncio.run(whole())

    async def make_ready(self, stage: S) -> None:
        """What an operator does after an error: reopen until the line is back, and home a stage that is not ready."""
        self.befall("")
        await stage.close()
        await self.clock.sleep(60.0)
        await opened(stage)
        if (await stage.state()).phase is not StagePhase.READY:
            await stage.home()


def give_time(timeout: float, *stages: Any) -> None:
    """Let the drivers of stages wait `timeout` real seconds for each reply from now on."""
    for stage in stages:
        parts = vars(stage)
        line = parts.get("_port") or parts["_line"]
        line._timeout = timeout
        if (client := getattr(line, "_client", None)) is not None:
            client.ctx.comm_params.timeout_connect = timeout


async def opened(stage: Stage) -> None:
    """Open a stage as soon as its line is back."""
    deadline = time.monotonic() + 60
    while True:
        try:
            await stage.open()
            return
        except DriverError:
            assert time.monotonic() < deadline, "the stage cannot be opened again"
            await asyncio.sleep(0.01)


async def until(true: Callable[[], bool]) -> None:
    """Wait in real time, and not for ever."""
    deadline = time.monotonic() + 60
    while not true():
        assert time.monotonic() < deadline, "waited in vain"
        await asyncio.sleep(0.001)
