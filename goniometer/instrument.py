"""The bench as one object: two rotation stages, a spectrometer and a light, in degrees and seconds.

It knows the device interfaces only, so real and simulated devices behave alike.
"""

import asyncio
from collections.abc import Coroutine
from dataclasses import dataclass
from typing import Any

from drivers.arrays import FloatArray
from drivers.clock import Clock
from drivers.errors import DriverError
from drivers.interfaces import Light, RotationStage, Spectrometer, Spectrum
from goniometer.errors import GeometryError
from goniometer.geometry import Geometry, check, from_stages


@dataclass(frozen=True)
class Constants:
    """What calibration needs to know about the devices; stored with every scan."""

    spectrometer: str
    """What the spectrometer calls itself: maker, model, serial number."""
    stages: dict[str, str]
    """What each stage calls itself, by its name; some know no more than the address they answer at."""
    wavelengths: FloatArray
    """[pixels] nanometres."""
    nonlinearity: FloatArray
    """[coefficients] of the polynomial in dark-subtracted counts by which these are divided."""
    saturation: int
    """Counts at and above which a pixel is saturated."""
    gain: float
    """Electrons per count."""
    u_angle: float
    """Standard uncertainty of one stage position, degrees."""
    aperture: float
    """Full angle of the detector aperture, degrees."""


class Instrument:
    """The bench. All methods raise `DriverError`; stage names and angles are those of `goniometer.geometry`."""

    def __init__(
        self,
        sample_stage: RotationStage,
        detector_stage: RotationStage,
        spectrometer: Spectrometer,
        light: Light,
        clock: Clock,
        *,
        gain: float,
        u_angle: float = 0.005,
        aperture: float = 1.0,
    ) -> None:
        self.clock = clock
        """The time in which the bench lives."""
        self._sample_stage = sample_stage
        self._detector_stage = detector_stage
        self._spectrometer = spectrometer
        self._light = light
        self._gain = gain
        self._u_angle = u_angle
        self._aperture = aperture
        # None where it is not known, as at the start and after anything went wrong.
        self._sample_target: float | None = None
        self._detector_target: float | None = None
        self._shutter_open: bool | None = None

    @property
    def integration_limits(self) -> tuple[float, float]:
        """Shortest and longest integration time of the spectrometer, seconds."""
        return self._spectrometer.integration_limits

    @property
    def saturation(self) -> int:
        """Counts at and above which a pixel is saturated."""
        return self._spectrometer.saturation

    async def open(self) -> None:
        """Connect to all devices, switch the lamp on and find both reference marks."""
        await self._spectrometer.open()
        await self._sample_stage.open()
        await self._detector_stage.open()
        await self._set_shutter(False)
        await self._light.set_lamp(True)
        self._forget_targets()
        await _both(_home(self._sample_stage), _home(self._detector_stage))

    async def constants(self) -> Constants:
        """What the devices say about themselves, with the configured values."""
        spectrometer = self._spectrometer
        return Constants(
            await spectrometer.identity(),
            {stage.name: await stage.identity() for stage in (self._sample_stage, self._detector_stage)},
            await spectrometer.wavelengths(),
            await spectrometer.nonlinearity(),
            spectrometer.saturation,
            self._gain,
            self._u_angle,
            self._aperture,
        )

    def check(self, geometry: Geometry) -> None:
        """Raise `GeometryError` where the bench, its stages or the blocked sector forbid `geometry`."""
        check(geometry)
        if geometry.blocked:
            raise GeometryError(
                f"theta_in = {geometry.theta_in:g}, theta_out = {geometry.theta_out:g} deg is not possible: "
                f"the detector would stand in the beam; keep 5 deg away from the source axis"
            )
        for stage, angle in (
            (self._sample_stage, geometry.sample_angle),
            (self._detector_stage, geometry.detector_angle),
        ):
            low, high = stage.limits
            if not low <= angle <= high:
                raise GeometryError(
                    f"theta_in = {geometry.theta_in:g}, theta_out = {geometry.theta_out:g} deg is not possible: "
                    f"the {stage.name} would have to stand at {angle:g} deg, outside {low:g} to {high:g} deg"
                )

    async def goto(self, geometry: Geometry) -> Geometry:
        """Move both stages at once, each only if it must, and return the geometry that they read back."""
        self.check(geometry)
        sample_from, detector_from = self._sample_target, self._detector_target
        self._forget_targets()
        sample, detector = await _both(
            _settle(self._sample_stage, sample_from, geometry.sample_angle),
            _settle(self._detector_stage, detector_from, geometry.detector_angle),
        )
        self._sample_target, self._detector_target = geometry.sample_angle, geometry.detector_angle
        return from_stages(sample, detector)

    async def expose(self, integration_time: float) -> Spectrum:
        """One spectrum with the shutter open; `integration_time` in seconds."""
        await self._set_shutter(True)
        return await self._spectrometer.expose(integration_time)

    async def dark(self, integration_time: float) -> Spectrum:
        """One spectrum with the shutter closed; `integration_time` in seconds."""
        await self._set_shutter(False)
        return await self._spectrometer.expose(integration_time)

    async def safe(self) -> None:
        """Stop both stages and close the shutter; every device is tried, then the first fault is raised."""
        self._forget_targets()
        self._shutter_open = None
        faults: list[DriverError] = []
        for action in (self._sample_stage.stop, self._detector_stage.stop, self._close_shutter):
            try:
                await action()
            except DriverError as error:
                faults.append(error)
        if faults:
            raise faults[0]

    async def close(self) -> None:
        """Disconnect from all devices; harmless when not connected."""
        self._forget_targets()
        self._shutter_open = None
        await self._sample_stage.close()
        await self._detector_stage.close()
        await self._spectrometer.close()

    def _forget_targets(self) -> None:
        self._sample_target = self._detector_target = None

    async def _close_shutter(self) -> None:
        await self._set_shutter(False)

    async def _set_shutter(self, is_open: bool) -> None:
        if self._shutter_open is not is_open:
            self._shutter_open = None
            await self._light.set_shutter(is_open)
            self._shutter_open = is_open


async def _home(stage: RotationStage) -> float:
    """Find the reference mark of one stage; returns the angle read back."""
    await stage.home()
    return await stage.position()


async def _settle(stage: RotationStage, target: float | None, wanted: float) -> float:
    """Bring one stage to `wanted` unless it was sent there already; returns the angle read back."""
    return await stage.position() if target == wanted else await stage.move_to(wanted)


async def _both(first: Coroutine[Any, Any, float], second: Coroutine[Any, Any, float]) -> tuple[float, float]:
    """Two moves at once; when one fails the other is still awaited, so that no stage is left unwatched."""
    results = await asyncio.gather(first, second, return_exceptions=True)
    if isinstance(results[0], BaseException):
        raise results[0]
    if isinstance(results[1], BaseException):
        raise results[1]
    return results[0], results[1]
