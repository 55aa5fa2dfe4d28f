"""The bench as one object: two rotation stages, a spectrometer and a light, in degrees and seconds.

It knows the device interfaces only, so real and simulated devices behave alike. Nothing that a driver returns is
believed because it came: a stage must say that it is ready before it moves and read back where it was sent, and a
spectrum must have the integration time, the pixels and the detector temperature that belong to it.
"""

import logging
import math
import uuid

import numpy as np

from drivers.arrays import FloatArray
from drivers.clock import Clock
from drivers.errors import DeviceFault, DriverError, ProtocolError
from drivers.interfaces import Light, RotationStage, Spectrometer, Spectrum
from drivers.travel import travel_time
from goniometer.bench.arm import Arm
from goniometer.bench.moves import faults_of
from goniometer.bench.safety import Forbidden, Standing
from goniometer.bench.track import SWEEP_MARGIN, Passage, passages
from goniometer.constants import BenchData, Constants
from goniometer.geometry import Geometry

TEMPERATURE_DRIFT = 1.0
"""Degrees Celsius by which the detector may depart from its first spectrum; by more, its cooler has failed."""

DARK_SPREAD = 2000.0
"""Counts by which parts of a dark spectrum may differ; light differs by more from one end of its spectrum to the other,
as a halogen lamp has next to no violet and a point is exposed until its brightest pixel has a good part of all counts.
"""

DARK_PARTS = 16
"""In which a dark spectrum is looked at; the median of each does not see single hot pixels."""

RECOVERY_PAUSES = (1.0, 5.0, 20.0, 60.0)
"""Seconds between the attempts to make the devices usable again: a hub comes back at once, a fuse does not."""

NOMINAL = BenchData()
"""A bench of which nothing was stated."""

log = logging.getLogger(__name__)


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
        data: BenchData = NOMINAL,
        forbidden: tuple[Forbidden, ...] = (),
        backlash: Standing = (0.0, 0.0),
        settling: Standing = (0.0, 0.0),
    ) -> None:
        """`backlash` (degrees) and `settling` (seconds after a move) are those of the sample and the detector stage."""
        self.clock = clock
        """The time in which the bench lives."""
        self.session = uuid.uuid4().hex
        """Names whose clock moments are read from: those of two sessions, as of two processes, cannot be compared."""
        self.arm = Arm(sample_stage, detector_stage, clock, forbidden=forbidden, backlash=backlash, settling=settling)
        """The two stages as one."""
        self._spectrometer = spectrometer
        self._light = light
        self._data = data
        # None where it is not known, as at the start and after anything went wrong.
        self._shutter_open: bool | None = None
        self._last_count: int | None = None
        self._lamp_since = math.inf  # on the clock; infinite where no lamp was switched on
        # None until the first spectrum; they stay when devices are reopened, as the scan goes on
        self._pixels: int | None = None
        self._temperature: float | None = None
        self._last_spectrum: Spectrum | None = None

    @property
    def u_angle(self) -> float:
        """Standard uncertainty of one stage position, degrees."""
        return self._data.u_angle

    @property
    def integration_limits(self) -> tuple[float, float]:
        """Shortest and longest integration time of the spectrometer, seconds."""
        return self._spectrometer.integration_limits

    @property
    def saturation(self) -> int:
        """Counts at and above which a pixel is saturated."""
        return self._spectrometer.saturation

    @property
    def lamp_on_for(self) -> float:
        """Seconds for which the lamp has been on for all that is known; negative where it was not switched on.

        A lamp that burned before it was switched on here counts as cold, and so does one after a recovery, because
        nobody knows whether it burned meanwhile; `trust_lamp` is for who does.
        """
        return self.clock.now() - self._lamp_since

    @property
    def shutter_open(self) -> bool | None:
        """Whether the shutter is open; None where it is not known."""
        return self._shutter_open

    @property
    def last_spectrum(self) -> Spectrum | None:
        """The last spectrum that could be believed; None where there was none yet."""
        return self._last_spectrum

    def trust_lamp(self) -> None:
        """Believe an operator who says that the lamp is warm."""
        self._lamp_since = -math.inf

    async def wait_until_cold(self) -> None:
        """Return when the detector rests at its set point; raises `DeviceTimeout` when it does not get there."""
        await self._spectrometer.wait_until_cold()

    async def open(self) -> None:
        """Connect to all devices, switch the lamp on and find both reference marks.

        Where regions are forbidden the detector stage is homed first, then the sample stage. No path to the marks can
        be checked, because nobody knows where it begins: look before the stages are homed. Raises `GeometryError`
        where the marks lie in a forbidden region.
        """
        self._forget()
        await self._spectrometer.open()
        await self.arm.open()
        await self._set_shutter(False)
        await self._switch_lamp_on()
        await self.arm.find_marks()

    async def temperature(self) -> float:
        """Of the detector now, degrees Celsius; waits for an integration to end."""
        return await self._spectrometer.temperature()

    async def constants(self) -> Constants:
        """What the devices say about themselves, with the configured values."""
        spectrometer = self._spectrometer
        return Constants(
            await spectrometer.identity(),
            {stage.name: await stage.identity() for stage in self.arm.stages},
            await spectrometer.wavelengths(),
            await spectrometer.nonlinearity(),
            spectrometer.saturation,
            self._data,
        )

    async def wavelengths(self) -> FloatArray:
        """[pixels] nanometres, as the spectrometer tells them."""
        return await self._spectrometer.wavelengths()

    async def expose(self, integration_time: float) -> Spectrum:
        """One spectrum with the shutter open; `integration_time` in seconds.

        Raises `ProtocolError` for a spectrum that cannot be the one that was asked for, and `DeviceFault` where the
        detector is not as warm as it was.
        """
        await self._set_shutter(True)
        return await self._checked(await self._spectrometer.expose(integration_time), integration_time)

    async def sequence(self, integration_time: float, scans: int) -> list[Spectrum]:
        """`scans` spectra in a row with the shutter open; `integration_time` in seconds. Raises as `expose` does."""
        await self._set_shutter(True)
        spectra = await self._spectrometer.sequence(integration_time, scans)
        if len(spectra) != scans:
            raise ProtocolError(f"{self._spectrometer.name}: delivered {len(spectra)} spectra where {scans} were asked")
        return [await self._checked(spectrum, integration_time) for spectrum in spectra]

    async def sweep(
        self, theta_in: float, start: float, stop: float, velocity: float, integration_time: float
    ) -> tuple[list[Passage], float]:
        """Spectra of `integration_time` seconds, taken while the arm goes from theta_out `start` to `stop`, degrees.

        It moves at `velocity`, degrees/s, and may cross the blocked sector. Returns the spectra that it moved during,
        which cover the way without a gap, and the angle of the sample stage, degrees. How well their ends are known
        depends on how quickly the stage tells where it is: on half that time. Raises `GeometryError` before anything
        moves where the arm cannot go there or all the way; `DeviceRefused` for a velocity that the stage cannot have;
        `ProtocolError` and `DeviceFault` where a spectrum is not the one that was asked for or part of the way was not
        seen. The arm has its former velocity again afterwards, or, where it cannot be told so, after `recover`.
        """
        end = Geometry(theta_in, stop)
        sample = await self.arm.begin_sweep(Geometry(theta_in, start), end)
        await self._set_shutter(True)
        seconds = travel_time(stop - start, velocity, self.arm.motion.detector.acceleration)
        scans = math.ceil((seconds + SWEEP_MARGIN) / integration_time)
        spectrometer = self._spectrometer
        async with self.arm.slowed(velocity):
            track = [await self.arm.reading()]
            begun = await spectrometer.begin_sequence(integration_time, scans)
            track += await self.arm.sweep(end, seconds, look=integration_time / 2)
            spectra = await spectrometer.collect_sequence(begun)
        if len(spectra) != scans:
            raise ProtocolError(f"{spectrometer.name}: delivered {len(spectra)} spectra where {scans} were asked")
        checked = [await self._checked(spectrum, integration_time) for spectrum in spectra]
        step = velocity * integration_time
        return passages(self.arm.stages[1].name, checked, track, step), sample

    async def dark(self, integration_time: float) -> Spectrum:
        """One spectrum with the shutter closed; `integration_time` in seconds.

        Raises as `expose` does, and `DeviceFault` where it shows light: a shutter cannot tell where it is.
        """
        await self._set_shutter(False)
        spectrum = await self._checked(await self._spectrometer.expose(integration_time), integration_time)
        levels = [float(np.median(part)) for part in np.array_split(spectrum.counts, DARK_PARTS)]
        if max(levels) - min(levels) > DARK_SPREAD or max(levels) >= self.saturation:
            raise DeviceFault(
                f"{self._spectrometer.name}: sees light behind the closed shutter, parts of its dark spectrum have "
                f"{min(levels):.0f} and {max(levels):.0f} counts; look whether the shutter closes, and for other light"
            )
        return spectrum

    async def safe(self) -> None:
        """Bring the bench into its safe state: stages stopped, shutter closed; the lamp stays on, to stay warm.

        The stops are sent at once and before all else; that the stages rest is seen afterwards. Every device is
        tried and every fault logged, then the first one is raised. `DeviceTimeout` where a stage goes on moving.
        """
        self._forget()
        stages = self.arm.stages
        # tasks begin in this order, and a stop is on the wire before it first waits
        faults = await faults_of(*(stage.stop() for stage in stages), self._set_shutter(False))
        faults += await faults_of(*(self.arm.rest(stage) for stage in stages))
        if faults:
            raise faults[0]

    async def recover(self) -> None:
        """Make every device usable again after a fault; the shutter is closed then, and the lamp on.

        The spectrometer is reopened, which cools it; so is a stage that does not answer; one that is not ready, or
        has lost count, is homed. This is tried once, and again after each of `RECOVERY_PAUSES`; then what is wrong is
        raised. Raises `GeometryError` at once, before a stage is homed, where a forbidden region may lie between where
        the arm was last known to be and the mark; how a stage searches beyond its mark is not known here.
        """
        for pause in RECOVERY_PAUSES:
            try:
                return await self._revive()
            except DriverError as error:
                log.warning("%s (trying again in %g s)", error, pause)
                await self.clock.sleep(pause)
        return await self._revive()

    async def close(self) -> None:
        """Disconnect from all devices; harmless when not connected. Every device is tried."""
        self._forget()
        faults = await faults_of(*(stage.close() for stage in self.arm.stages), self._spectrometer.close())
        if faults:
            raise faults[0]

    def _forget(self) -> None:
        """Nothing is known of the devices any more."""
        self.arm.forget()
        self._shutter_open = None
        self._last_count = None

    async def _set_shutter(self, is_open: bool) -> None:
        if self._shutter_open is not is_open:
            self._shutter_open = None
            await self._light.set_shutter(is_open)
            self._shutter_open = is_open

    async def _switch_lamp_on(self) -> None:
        await self._light.set_lamp(True)
        self._lamp_since = self.clock.now()

    async def _checked(self, spectrum: Spectrum, integration_time: float) -> Spectrum:
        """`spectrum`, if it can be the one that was asked for: the last look before it is stored."""
        name = self._spectrometer.name
        if self._pixels is None:
            self._pixels = len(await self._spectrometer.wavelengths())
        if round(spectrum.integration_time * 1e6) != round(integration_time * 1e6):
            raise ProtocolError(
                f"{name}: delivered a spectrum of {spectrum.integration_time:g} s where {integration_time:g} s were "
                f"asked; switch it off and on"
            )
        if spectrum.counts.shape != (self._pixels,):
            raise ProtocolError(
                f"{name}: delivered counts of shape {spectrum.counts.shape}; {self._pixels} pixels were expected"
            )
        if spectrum.count == self._last_count:
            raise ProtocolError(f"{name}: delivered spectrum number {spectrum.count} twice; switch it off and on")
        if self._temperature is None:
            self._temperature = spectrum.detector_temperature
        if not abs(spectrum.detector_temperature - self._temperature) <= TEMPERATURE_DRIFT:  # also no number
            raise DeviceFault(
                f"{name}: the detector is at {spectrum.detector_temperature:.1f} °C, and was at "
                f"{self._temperature:.1f} °C before; let the cooler settle"
            )
        self._last_count = spectrum.count
        self._last_spectrum = spectrum
        return spectrum

    async def _revive(self) -> None:
        """One attempt to make every device usable."""
        self._forget()
        await self._spectrometer.open()
        await self._set_shutter(False)
        await self._switch_lamp_on()
        await self.arm.revive()
