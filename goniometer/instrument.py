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
from drivers.errors import DeviceFault, DeviceTimeout, DriverError, ProtocolError
from drivers.interfaces import Light, RotationStage, Spectrometer, Spectrum, StagePhase, StageState
from drivers.travel import travel_time
from goniometer.constants import BenchData, Constants
from goniometer.errors import GeometryError
from goniometer.geometry import Geometry, check, from_stages
from goniometer.moves import ARRIVAL, Move, both, bring, faults_of, followed, home, not_ready, ready
from goniometer.route import Motion, StageMotion, approach
from goniometer.safety import Forbidden, Limits, Standing, check_standing, check_sweep, grown, raised, safe_path
from goniometer.track import SWEEP_MARGIN, Passage, passages

TEMPERATURE_DRIFT = 1.0
"""Degrees Celsius by which the detector may depart from its first spectrum; by more, its cooler has failed."""

DARK_SPREAD = 2000.0
"""Counts by which parts of a dark spectrum may differ; light differs by more from one end of its spectrum to the other,
as a halogen lamp has next to no violet and a point is exposed until its brightest pixel has a good part of all counts.
"""

DARK_PARTS = 16
"""In which a dark spectrum is looked at; the median of each does not see single hot pixels."""

REST_TIME = 5.0
"""Seconds in which a stage that was told to stop must rest."""

REST_POLL = 0.05
"""Seconds between two looks at a stage that should come to rest."""

RECOVERY_PAUSES = (1.0, 5.0, 20.0, 60.0)
"""Seconds between the attempts to make the devices usable again: a hub comes back at once, a fuse does not."""

NOMINAL = BenchData()
"""A bench of which nothing was stated."""

_MOVING = {StagePhase.MOVING, StagePhase.HOMING}

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
        self.forbidden = grown(forbidden, backlash)
        """Where the arm must never be sent, and through which it must not pass; with the room that backlash takes."""
        self._sample_stage = sample_stage
        self._detector_stage = detector_stage
        self._spectrometer = spectrometer
        self._light = light
        self._data = data
        self._regions = forbidden
        self._backlash = backlash
        self._settling = settling
        # None where it is not known, as at the start and after anything went wrong.
        self._sample_target: float | None = None
        self._detector_target: float | None = None
        self._shutter_open: bool | None = None
        self._last_count: int | None = None
        self._lamp_since = math.inf  # on the clock; infinite where no lamp was switched on
        # names of stages that did not read what they read when they were left
        self._astray: set[str] = set()
        # what the stages read after homing, and corners of the rectangle somewhere in which the arm is now
        self._marks: Standing = (0.0, 0.0)
        self._whereabouts = {self._marks}
        # of the arm when it is not slowed down for a sweep; None while it has it
        self._cruising: float | None = None
        # None until the first spectrum; they stay when devices are reopened, as the scan goes on
        self._pixels: int | None = None
        self._temperature: float | None = None
        self._last_spectrum: Spectrum | None = None

    @property
    def limits(self) -> Limits:
        """Where the sample stage and the detector stage may be sent, degrees."""
        return raised((self._sample_stage.limits, self._detector_stage.limits), self._backlash)

    @property
    def motion(self) -> Motion:
        """How the stages move, as far as it is known once they are open."""
        stages = self._sample_stage, self._detector_stage
        sample, detector = (
            StageMotion(stage.velocity, stage.acceleration, backlash, settling)
            for stage, backlash, settling in zip(stages, self._backlash, self._settling, strict=True)
        )
        return Motion(sample, detector)

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
        await self._sample_stage.open()
        await self._detector_stage.open()
        await self._set_shutter(False)
        await self._switch_lamp_on()
        await self._home()

    async def home(self) -> None:
        """Find both reference marks again; `open` has found them before.

        Raises `GeometryError` before anything moves where a forbidden region may lie on the way.
        """
        check_sweep(self._whereabouts | {self._marks}, self._regions)
        self._forget_targets()
        self._whereabouts.add(self._marks)
        await self._home()
        self._astray.clear()

    async def stages(self) -> tuple[StageState, StageState]:
        """What the sample and the detector stage do now, as they say; may be asked at any time."""
        return await self._sample_stage.state(), await self._detector_stage.state()

    async def temperature(self) -> float:
        """Of the detector now, degrees Celsius; waits for an integration to end."""
        return await self._spectrometer.temperature()

    async def constants(self) -> Constants:
        """What the devices say about themselves, with the configured values."""
        spectrometer = self._spectrometer
        return Constants(
            await spectrometer.identity(),
            {stage.name: await stage.identity() for stage in (self._sample_stage, self._detector_stage)},
            await spectrometer.wavelengths(),
            await spectrometer.nonlinearity(),
            spectrometer.saturation,
            self._data,
        )

    async def wavelengths(self) -> FloatArray:
        """[pixels] nanometres, as the spectrometer tells them."""
        return await self._spectrometer.wavelengths()

    def check(self, geometry: Geometry) -> None:
        """Raise `GeometryError` where the bench, its stages, a region or the blocked sector forbid `geometry`."""
        check(geometry)
        where = f"theta_in = {geometry.theta_in:g}, theta_out = {geometry.theta_out:g} deg"
        if geometry.blocked:
            raise GeometryError(
                f"{where} is not possible: the detector would stand in the beam; keep 5 deg away from the source axis"
            )
        try:
            check_standing((geometry.sample_angle, geometry.detector_angle), self.limits, self.forbidden)
        except GeometryError as error:
            raise GeometryError(f"{where}: {error}") from None

    async def goto(self, geometry: Geometry) -> Geometry:
        """Move the stages, each only if it must, and return the geometry that they read back.

        Both move at once where no forbidden region lies between, else one after the other; one that has backlash
        arrives upwards, and the arm has settled when this returns. Raises `GeometryError`
        before anything moves where the arm cannot go; `DeviceFault` where a stage is not ready, e.g. because it was
        switched off and on between two points, does not read what it read when it was left, or does not read back
        where it was sent; `ProtocolError` where it reads two different angles at rest.
        """
        self.check(geometry)
        return await self._go((geometry.sample_angle, geometry.detector_angle))

    async def standing(self) -> Standing:
        """What the two stages read at rest, degrees; raises `DeviceFault` for one that is not ready."""
        return await both(ready(self._sample_stage), ready(self._detector_stage))

    async def face_source(self, theta_in: float, detector_angle: float = 0.0) -> Geometry:
        """Stand with the detector in front of the source, where it sees stray light only, and return the read-back.

        `detector_angle` is measured from the source axis, degrees: the edges of the blocked sector show where the stage
        is zero. No sample is measured there. Raises as `goto` does.
        """
        wanted = theta_in, detector_angle
        check_standing(wanted, self.limits, self.forbidden)
        return await self._go(wanted)

    async def _go(self, wanted: Standing) -> Geometry:
        """What `goto` does, once it is known that the arm may stand where it is wanted."""
        left = targets = self._sample_target, self._detector_target
        self._forget_targets()
        await self._cruise()  # where a sweep before could not
        here = await both(ready(self._sample_stage), ready(self._detector_stage))
        self._whereabouts.add(here)  # a stage that has lost count is perhaps still where it was left
        self._check_left(targets, here)
        first = approach(here, wanted, targets, self._backlash)
        stops = safe_path(here, first, self._regions)
        for stop in [*stops, *([wanted] if first != wanted else [])]:
            # on the way only the stage moves whose turn it is; in the end each that was not sent there before
            fixed = targets if stop in (first, wanted) else here
            stays = [fixed[axis] == stop[axis] for axis in range(2)]
            self._whereabouts = {here, stop}
            stages = self._sample_stage, self._detector_stage
            moves = [Move(stages[axis], here[axis], stop[axis], stays[axis]) for axis in range(2)]
            sample, detector = await bring(self.clock, moves)
            targets = (
                targets[0] if stays[0] else stop[0],
                targets[1] if stays[1] else stop[1],
            )
            here = sample, detector
        self._whereabouts = {here}
        settling = [self._settling[axis] for axis in range(2) if left[axis] != wanted[axis]]
        if any(settling):
            await self.clock.sleep(max(settling))
        self._sample_target, self._detector_target = wanted
        return from_stages(*here)

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
        ends = [check(Geometry(theta_in, theta_out)) for theta_out in (start, stop)]
        (_, begin), (_, end) = way = [(g.sample_angle, g.detector_angle) for g in ends]
        for standing in way:
            check_standing(standing, self.limits, self.forbidden)
        safe_path(way[0], way[1], self.forbidden)
        stage, spectrometer = self._detector_stage, self._spectrometer
        sample = (await self._go(way[0])).sample_angle
        await self._set_shutter(True)
        self._forget_targets()
        self._whereabouts = {(sample, begin), (sample, end)}
        seconds = travel_time(end - begin, velocity, stage.acceleration)
        self._cruising = stage.velocity
        faults: list[DriverError] = []
        try:
            await stage.set_velocity(velocity)
            track = [(self.clock.now(), await stage.position())]
            scans = math.ceil((seconds + SWEEP_MARGIN) / integration_time)
            begun = await spectrometer.begin_sequence(integration_time, scans)
            await stage.begin_move(end)
            track += await followed(stage, self.clock, end, seconds, look=integration_time / 2)
            spectra = await spectrometer.collect_sequence(begun)
            await self.clock.sleep(self._settling[1])  # the next point may lie where the sweep ends
        finally:
            faults = await faults_of(self._cruise())
        if faults:
            raise faults[0]
        self._whereabouts = {(sample, track[-1][1])}
        # a stage with backlash that came from above does not stand where it is wanted
        self._sample_target = theta_in
        self._detector_target = None if end < begin and self._backlash[1] else end
        if len(spectra) != scans:
            raise ProtocolError(f"{spectrometer.name}: delivered {len(spectra)} spectra where {scans} were asked")
        checked = [await self._checked(spectrum, integration_time) for spectrum in spectra]
        step = velocity * integration_time
        return passages(stage.name, checked, track, step), sample

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
        stages = self._sample_stage, self._detector_stage
        # tasks begin in this order, and a stop is on the wire before it first waits
        faults = await faults_of(*(stage.stop() for stage in stages), self._set_shutter(False))
        faults += await faults_of(*(self._rest(stage) for stage in stages))
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
        faults = await faults_of(self._sample_stage.close(), self._detector_stage.close(), self._spectrometer.close())
        if faults:
            raise faults[0]

    def _check_left(self, left: tuple[float | None, float | None], here: tuple[float, float]) -> None:
        """Raise `DeviceFault` where a stage has lost count since it was left; one without encoder shows it only now."""
        for stage, angle, reads in zip((self._sample_stage, self._detector_stage), left, here, strict=True):
            if angle is not None and not abs(reads - angle) <= ARRIVAL:
                self._astray.add(stage.name)
                raise DeviceFault(f"{stage.name}: reads {reads:.3f}° where it was left at {angle:.3f}°; home it")

    def _forget_targets(self) -> None:
        self._sample_target = self._detector_target = None

    def _forget(self) -> None:
        """Nothing is known of the devices any more."""
        self._forget_targets()
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

    async def _home(self) -> None:
        """Find both reference marks; the detector stage first where regions are forbidden."""
        if self._regions:
            detector = await home(self._detector_stage)
            sample = await home(self._sample_stage)
            unbounded = (-math.inf, math.inf)  # a mark may lie outside the range that is used
            check_standing((sample, detector), (unbounded, unbounded), self._regions)
        else:
            sample, detector = await both(home(self._sample_stage), home(self._detector_stage))
        self._marks = sample, detector
        self._whereabouts = {self._marks}

    async def _cruise(self) -> None:
        """Give the arm the velocity back that it had before a sweep."""
        if self._cruising is not None:
            await self._detector_stage.set_velocity(self._cruising)
            self._cruising = None

    async def _rest(self, stage: RotationStage) -> None:
        """Return when `stage` rests. One that still moves is told to stop again.

        A command that another task had given before may have reached the device after the stop.
        """
        begin = self.clock.now()
        while (state := await stage.state()).phase in _MOVING:
            if self.clock.now() - begin > REST_TIME:
                raise DeviceTimeout(
                    f"{stage.name}: is still {state.phase.value} {REST_TIME:g} s after it was stopped; switch it off"
                )
            await stage.stop()
            await self.clock.sleep(REST_POLL)

    async def _revive(self) -> None:
        """One attempt to make every device usable."""
        self._forget()
        await self._spectrometer.open()
        await self._set_shutter(False)
        await self._switch_lamp_on()
        for axis, stage in ((1, self._detector_stage), (0, self._sample_stage)):
            try:
                state = await stage.state()
            except DriverError as error:
                log.warning("%s (reopening it)", error)
                await stage.close()
                await stage.open()
                state = await stage.state()
            if state.phase in _MOVING:
                await self._rest(stage)
                state = await stage.state()
            if state.phase is not StagePhase.READY:
                log.warning("%s (homing it)", not_ready(stage, state))
            if state.phase is not StagePhase.READY or stage.name in self._astray:
                mark = self._marks[axis]
                homed = {(s, mark) if axis else (mark, d) for s, d in self._whereabouts}
                check_sweep(self._whereabouts | homed, self._regions)
                self._whereabouts |= homed
                await stage.home()
                self._whereabouts = homed
                self._astray.discard(stage.name)
        await self._cruise()
