"""The kinds of device on the bench, as the rest of the system sees them.

Angles are degrees, times seconds, temperatures degrees Celsius. All methods raise `DriverError`, and `Camera.capture`
`FileExistsError` besides.

What a driver must survive:

- A call is cancelled at any of its awaits, by an abort or by *Stop*. `stop` and `set_shutter` come at once, before the
  call that was cancelled has ended.
- What was begun is never collected: a move without its `arrive`, spectra without `collect_sequence`. The next command
  comes all the same.
- Other tasks ask for `state` and `position` while a stage moves or homes. `temperature` may be waiting for its answer
  when a spectrum is asked for.
- After a fault a stage is closed, opened and homed again in whatever state it is, and a spectrometer is opened without
  having been closed. What never opened, or not to the end, is stopped and closed nevertheless.
"""

from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Protocol

from drivers.arrays import CountArray, FloatArray


class StagePhase(Enum):
    """What a rotation stage is doing."""

    NOT_REFERENCED = "not referenced"
    HOMING = "homing"
    READY = "ready"
    MOVING = "moving"
    DISABLED = "disabled"
    FAULT = "fault"


@dataclass(frozen=True)
class StageState:
    """A snapshot of a rotation stage."""

    phase: StagePhase
    position: float
    """Angle, degrees; meaningless while the stage is not referenced."""
    message: str = ""
    """The device's own words about a fault; empty when there is none."""


class RotationStage(Protocol):
    """One motorised rotation axis."""

    name: str
    """How the operator calls it, e.g. "sample stage"."""
    limits: tuple[float, float]
    """Lowest and highest angle that may be commanded, degrees."""
    velocity: float
    """Cruising speed, degrees/s; known once the stage is open."""
    acceleration: float
    """Of the ramps up and down, degrees/s^2; known once the stage is open."""

    async def open(self) -> None:
        """Connect and check that the right device answers."""

    async def close(self) -> None:
        """Disconnect; harmless when not connected."""

    async def identity(self) -> str:
        """Maker, model and firmware, as far as the device tells."""

    async def state(self) -> StageState:
        """What the stage is doing now."""

    async def home(self) -> None:
        """Find the reference mark and return when it is found."""

    async def move_to(self, angle: float) -> float:
        """Move to `angle` degrees, wait until the stage rests there, and return the angle it reads back.

        Raises `DeviceRefused` outside `limits` before anything moves.
        """

    async def begin_move(self, angle: float) -> float:
        """Begin to move to `angle` degrees, and return how long that should take, seconds, without waiting.

        Meanwhile `state` and `position` tell where the stage is; who goes on waits with `arrive`. Raises
        `DeviceRefused` outside `limits` before anything moves.
        """

    async def arrive(self, angle: float, expected: float = 0.0) -> float:
        """Wait until the stage rests at `angle` degrees, and return the angle it reads back.

        `expected` is how long the motion should still take, seconds.
        """

    async def position(self) -> float:
        """Angle now, degrees, also while the stage moves."""

    async def set_velocity(self, velocity: float) -> None:
        """Cruise at `velocity` degrees/s from the next motion on."""

    async def stop(self) -> None:
        """Stop moving at once; allowed from every state.

        The request is on the wire before this first yields to other tasks, also while another call waits for the
        device. Returns when the device has taken it, which is not yet when the stage rests.
        """


@dataclass(frozen=True)
class Spectrum:
    """One read-out of the detector."""

    counts: CountArray
    """[pixels] raw counts."""
    integration_time: float
    """Seconds, as the device reports it for this very spectrum."""
    count: int
    """The device's own running number of spectra."""
    detector_temperature: float
    """Degrees Celsius."""
    began: float | None = None
    """When the integration began, seconds on the clock of the bench, as far as the device tells; None where it does
    not. It is late by the time that the device's acknowledgement took."""


@dataclass(frozen=True)
class Begun:
    """Spectra that are being taken."""

    integration_time: float
    """Of each, seconds."""
    scans: int
    moment: float
    """When the device acknowledged that it begins, seconds on the clock of the bench."""


class Spectrometer(Protocol):
    """An array spectrometer."""

    name: str
    integration_limits: tuple[float, float]
    """Shortest and longest integration time, seconds."""
    saturation: int
    """Counts at and above which a pixel is saturated."""

    async def open(self) -> None:
        """Connect, check the identity and bring the device into a known state."""

    async def close(self) -> None:
        """Disconnect; harmless when not connected."""

    async def identity(self) -> str:
        """Maker, model and serial number."""

    async def wavelengths(self) -> FloatArray:
        """[pixels] nanometres, from the device's own coefficients."""

    async def nonlinearity(self) -> FloatArray:
        """[coefficients] of the polynomial c0 + c1 x + ... in dark-subtracted counts x.

        A measured value is divided by the polynomial. A device whose coefficients are all zero has never
        been characterised; the driver then returns [1.0].
        """

    async def temperature(self) -> float:
        """Of the detector now, degrees Celsius."""

    async def wait_until_cold(self) -> None:
        """Wait until the detector is at its set point; for instance after `expose` said that it is not.

        Raises `DeviceTimeout` when it does not get there.
        """

    async def expose(self, integration_time: float) -> Spectrum:
        """Integrate once for `integration_time` seconds.

        The spectrum was taken entirely after this call began, with exactly this integration time and with the
        detector at its set point. Raises `DeviceFault` when the detector is not.
        """

    async def sequence(self, integration_time: float, scans: int) -> list[Spectrum]:
        """`scans` spectra of `integration_time` seconds each, back to back; each is what `expose` promises."""

    async def begin_sequence(self, integration_time: float, scans: int) -> Begun:
        """Begin to take `scans` spectra of `integration_time` seconds each, without waiting for them."""

    async def collect_sequence(self, begun: Begun) -> list[Spectrum]:
        """Wait for the spectra that were begun, and return them with the moments at which they began.

        What is not as `sequence` promises is an error at once: what was to be seen meanwhile does not come back.
        """


class Light(Protocol):
    """The halogen source and the shutter in front of it."""

    async def set_lamp(self, on: bool) -> None:
        """Switch the lamp."""

    async def set_shutter(self, is_open: bool) -> None:
        """Open or close the shutter; a closed shutter gives a dark signal."""


@dataclass(frozen=True)
class Photograph:
    """A picture that a camera took."""

    path: Path
    """The file, with the ending that the camera gives its files, e.g. ".nef"."""
    exposure: float
    """Nominal exposure time that the camera was set to, seconds."""


class Camera(Protocol):
    """A camera whose exposure is set by hand: mode, sensitivity, aperture and file format never change once open."""

    name: str
    """How the operator calls it."""

    async def open(self) -> None:
        """Connect, check the identity and make all settings but the exposure time.

        Raises `DeviceNotFound` when no such camera answers, and `DeviceRefused` for a setting that it does not have.
        """

    async def close(self) -> None:
        """Disconnect; harmless when not connected."""

    async def identity(self) -> str:
        """Maker, model and serial number."""

    async def capture(self, path: Path, exposure: float) -> Photograph:
        """Expose for `exposure` seconds and put the picture into a file called `path` but for its ending.

        Raises `DeviceRefused` for an exposure time that the camera does not have, and `FileExistsError` before anything
        is exposed where a file is in the way.
        """
