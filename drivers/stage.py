"""What all rotation stages do alike, in front of what each family says in its own way."""

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace

from drivers.clock import Clock
from drivers.errors import DeviceFault, DeviceRefused, ProtocolError
from drivers.interfaces import StagePhase, StageState
from drivers.travel import (
    HOMING_POLL,
    HOMING_TIME,
    check_arrival,
    check_limits,
    longest_travel,
    travel_time,
    wait_for_rest,
)

AT_REST = 0.002
"""Degrees by which two readings of a stage at rest may differ, encoder noise included."""


@dataclass(frozen=True)
class Mounting:
    """How a stage sits on the bench: its own reading is `zero + direction * scale * angle`, all in degrees."""

    zero: float = 0.0
    """Reading of the stage where the bench calls the angle 0."""
    direction: int = 1
    """+1 where reading and angle grow together, -1 where they do not."""
    scale: float = 1.0
    """Degrees that the stage reads per degree that it turns, where they differ (a gear, a wrong configuration)."""

    def reading(self, angle: float) -> float:
        """What the stage reads at `angle` on the bench."""
        return self.zero + self.direction * self.scale * angle

    def angle(self, reading: float) -> float:
        """The angle on the bench where the stage reads `reading`."""
        return (reading - self.zero) * self.direction / self.scale


DIRECTLY = Mounting()
"""The stage reads the angle on the bench itself."""


class Stage(ABC):
    """A `RotationStage`; a family fills in what is abstract, in degrees of the stage's own reading.

    `limits` are the lowest and highest angle that may be commanded, in degrees on the bench.
    """

    def __init__(self, name: str, clock: Clock, *, limits: tuple[float, float], mounting: Mounting) -> None:
        self.name = name
        self.limits = limits
        self.velocity = 0.0
        """Degrees on the bench per second; known once the stage is open."""
        self.acceleration = 0.0
        """Degrees on the bench per second squared; known once the stage is open."""
        self._clock = clock
        self._mounting = mounting

    async def state(self) -> StageState:
        """What the stage is doing now; a fault is shown in the device's own words."""
        state = await self._read_state()
        return replace(state, position=self._mounting.angle(state.position))

    async def position(self) -> float:
        """Angle now, degrees."""
        return self._mounting.angle(await self._read_position())

    async def set_velocity(self, velocity: float) -> None:
        """Cruise at `velocity` degrees on the bench per second from the next motion on.

        Raises `DeviceRefused` for one that is not positive, or that the device refuses.
        """
        if not 0 < velocity < float("inf"):
            raise DeviceRefused(f"{self.name}: cannot move at {velocity:g}°/s; ask for more than 0°/s")
        await self._set_velocity(velocity * self._mounting.scale)
        self.velocity = velocity

    async def home(self) -> None:
        """Find the reference mark and return when it is found; a fault is cleared first.

        Raises `DeviceFault` or `DeviceTimeout` when it is not found.
        """
        await self._begin_homing()
        state = await wait_for_rest(
            self.name, self._clock, self.state, expected=0.0, at_most=HOMING_TIME, poll=HOMING_POLL
        )
        if state.phase is not StagePhase.READY:
            raise DeviceFault(f"{self.name}: is {state.phase.value}, not ready, after homing; home it again")

    async def move_to(self, angle: float) -> float:
        """Move to `angle` degrees, wait until the stage rests there, and return the angle it reads back.

        Raises `DeviceRefused` outside `limits` before anything is sent, or with the device's own reason;
        `DeviceFault` when it stops elsewhere or forgets its reference; `DeviceTimeout` when it does not arrive.
        """
        return await self.arrive(angle, await self.begin_move(angle))

    async def begin_move(self, angle: float) -> float:
        """Begin to move to `angle` degrees and return how long that should take, seconds; `arrive` waits for the end.

        Raises `DeviceRefused` outside `limits` before anything is sent, or with the device's own reason.
        """
        check_limits(self.name, angle, self.limits)
        expected = travel_time(angle - await self.position(), self.velocity, self.acceleration)
        await self._begin_move(self._mounting.reading(angle))
        return expected

    async def arrive(self, angle: float, expected: float = 0.0) -> float:
        """Wait until the stage rests at `angle` degrees and return the angle it reads back.

        `expected` is how long the motion should still take, seconds. Raises as `move_to` does.
        """
        state = await wait_for_rest(
            self.name, self._clock, self.state, expected=expected, at_most=longest_travel(expected)
        )
        if state.phase is not StagePhase.READY:
            raise DeviceFault(f"{self.name}: is {state.phase.value}, not ready, after a move; home it")
        check_arrival(self.name, angle, state.position)
        # the last reading is what gets stored, and most of these lines carry no checksum: it must come twice
        again = await self.position()
        if abs(again - state.position) > AT_REST:
            raise ProtocolError(
                f"{self.name}: reads {state.position:.3f}° and then {again:.3f}° at rest; check the cable and the brake"
            )
        return again

    @abstractmethod
    async def open(self) -> None:
        """Connect, check that the right device answers and learn how fast it moves.

        Raises `DeviceNotFound` when nothing answers and `ProtocolError` when something else does.
        """

    @abstractmethod
    async def close(self) -> None:
        """Disconnect; harmless when not connected."""

    @abstractmethod
    async def identity(self) -> str:
        """Maker, model and firmware, as far as the device tells."""

    @abstractmethod
    async def stop(self) -> None:
        """Stop moving at once; allowed from every state.

        The request is on the wire before this first yields to other tasks, also while another call waits for the
        device.
        """

    @abstractmethod
    async def _read_state(self) -> StageState:
        """What the stage is doing now, with its own reading in degrees as position."""

    @abstractmethod
    async def _read_position(self) -> float:
        """The stage's own reading now, degrees."""

    @abstractmethod
    async def _set_velocity(self, velocity: float) -> None:
        """Cruise at `velocity` degrees of the reading per second from the next motion on."""

    @abstractmethod
    async def _begin_homing(self) -> None:
        """Clear a fault, then begin to search for the reference mark."""

    @abstractmethod
    async def _begin_move(self, reading: float) -> None:
        """Begin to move to `reading` degrees. Raises `DeviceRefused` when the device does not take it."""
