"""The arm: the two rotation stages as one, in degrees.

A stage that is not ready is not moved, and where it was sent it must read back; see `goniometer.bench.moves`. What is
known of where the arm stands is kept, so that it is never sent through a forbidden region, also not after a fault.
"""

import logging
import math
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from drivers.clock import Clock
from drivers.errors import DeviceFault, DeviceTimeout, DriverError
from drivers.interfaces import RotationStage, StagePhase, StageState
from goniometer.bench.moves import ARRIVAL, Move, both, bring, faults_of, followed, home, not_ready, ready
from goniometer.bench.route import Motion, StageMotion, approach
from goniometer.bench.safety import Forbidden, Limits, Standing, check_standing, check_sweep, grown, raised, safe_path
from goniometer.errors import GeometryError
from goniometer.geometry import Geometry, check, from_stages

REST_TIME = 5.0
"""Seconds in which a stage that was told to stop must rest."""

REST_POLL = 0.05
"""Seconds between two looks at a stage that should come to rest."""

_MOVING = {StagePhase.MOVING, StagePhase.HOMING}

log = logging.getLogger(__name__)


class Arm:
    """Two stages, of which what is said in pairs is that of the sample and that of the detector stage.

    All methods raise `DriverError`; stage names and angles are those of `goniometer.geometry`.
    """

    def __init__(
        self,
        sample_stage: RotationStage,
        detector_stage: RotationStage,
        clock: Clock,
        *,
        forbidden: tuple[Forbidden, ...] = (),
        backlash: Standing = (0.0, 0.0),
        settling: Standing = (0.0, 0.0),
    ) -> None:
        """`backlash` (degrees) and `settling` (seconds after a move) are those of the sample and the detector stage."""
        self.stages = sample_stage, detector_stage
        """The sample stage and the detector stage; only what neither moves nor homes them is asked of them directly."""
        self.forbidden = grown(forbidden, backlash)
        """Where the arm must never be sent, and through which it must not pass; with the room that backlash takes."""
        self._clock = clock
        self._regions = forbidden
        self._backlash = backlash
        self._settling = settling
        # None where it is not known, as at the start and after anything went wrong.
        self._targets: tuple[float | None, float | None] = (None, None)
        # names of stages that did not read what they read when they were left
        self._astray: set[str] = set()
        # what the stages read after homing, and corners of the rectangle somewhere in which the arm is now
        self._marks: Standing = (0.0, 0.0)
        self._whereabouts = {self._marks}
        # velocity of the detector stage when it is not slowed down; None while it has it
        self._cruising: float | None = None

    @property
    def limits(self) -> Limits:
        """Where the stages may be sent, degrees."""
        sample_stage, detector_stage = self.stages
        return raised((sample_stage.limits, detector_stage.limits), self._backlash)

    @property
    def motion(self) -> Motion:
        """How the stages move, as far as it is known once they are open."""
        sample, detector = (
            StageMotion(stage.velocity, stage.acceleration, backlash, settling)
            for stage, backlash, settling in zip(self.stages, self._backlash, self._settling, strict=True)
        )
        return Motion(sample, detector)

    async def open(self) -> None:
        """Connect to both stages; their reference marks are not found yet."""
        self.forget()
        for stage in self.stages:
            await stage.open()

    async def find_marks(self) -> None:
        """Find both reference marks, the detector stage's first where regions are forbidden.

        Nothing is checked before; raises `GeometryError` where the marks lie in a forbidden region.
        """
        sample_stage, detector_stage = self.stages
        if self._regions:
            detector = await home(detector_stage)
            sample = await home(sample_stage)
            unbounded = (-math.inf, math.inf)  # a mark may lie outside the range that is used
            check_standing((sample, detector), (unbounded, unbounded), self._regions)
        else:
            sample, detector = await both(home(sample_stage), home(detector_stage))
        self._marks = sample, detector
        self._whereabouts = {self._marks}

    async def home(self) -> None:
        """Find both reference marks again.

        Raises `GeometryError` before anything moves where a forbidden region may lie on the way.
        """
        check_sweep(self._whereabouts | {self._marks}, self._regions)
        self.forget()
        self._whereabouts.add(self._marks)
        await self.find_marks()
        self._astray.clear()

    async def states(self) -> tuple[StageState, StageState]:
        """What the stages do now, as they say; may be asked at any time."""
        sample_stage, detector_stage = self.stages
        return await sample_stage.state(), await detector_stage.state()

    async def standing(self) -> Standing:
        """What the stages read at rest, degrees; raises `DeviceFault` for one that is not ready."""
        sample_stage, detector_stage = self.stages
        return await both(ready(sample_stage), ready(detector_stage))

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

    async def face_source(self, theta_in: float, detector_angle: float = 0.0) -> Geometry:
        """Stand with the detector in front of the source, where it sees stray light only, and return the read-back.

        `detector_angle` is measured from the source axis, degrees: the edges of the blocked sector show where the stage
        is zero. No sample is measured there. Raises as `goto` does.
        """
        wanted = theta_in, detector_angle
        check_standing(wanted, self.limits, self.forbidden)
        return await self._go(wanted)

    async def begin_sweep(self, start: Geometry, stop: Geometry) -> float:
        """Go to `start` and return what the sample stage reads there, degrees.

        Either may lie in the blocked sector. Raises as `goto` does, and `GeometryError` before anything moves where the
        arm cannot go on to `stop`.
        """
        begin, end = ((g.sample_angle, g.detector_angle) for g in (check(start), check(stop)))
        for standing in (begin, end):
            check_standing(standing, self.limits, self.forbidden)
        safe_path(begin, end, self.forbidden)
        return (await self._go(begin)).sample_angle

    @asynccontextmanager
    async def slowed(self, velocity: float) -> AsyncIterator[None]:
        """Move the detector stage at `velocity`, degrees/s, within; it has settled when this ends.

        It has its former velocity again afterwards, or, where it cannot be told so, after `revive`. Raises
        `DeviceRefused` for a velocity that it cannot have.
        """
        stage = self.stages[1]
        faults: list[DriverError] = []
        self._cruising = stage.velocity
        try:
            await stage.set_velocity(velocity)
            yield
            await self._clock.sleep(self._settling[1])  # the next point may lie where the sweep ends
        finally:
            faults = await faults_of(self._cruise())
        if faults:
            raise faults[0]

    async def reading(self) -> tuple[float, float]:
        """Moment, seconds on the clock, and what the detector stage reads, degrees, also while it moves."""
        return self._clock.now(), await self.stages[1].position()

    async def sweep(self, stop: Geometry, seconds: float, look: float) -> list[tuple[float, float]]:
        """Move from where `begin_sweep` went to `stop` and return where the detector stage was on the way.

        As `goniometer.bench.moves.followed`, whose `seconds` and `look` these are.
        """
        theta_in, begin = self._targets
        assert begin is not None  # where `begin_sweep` went
        end = stop.detector_angle
        self.forget()
        self._whereabouts |= {(sample, end) for sample, _ in self._whereabouts}
        await self.stages[1].begin_move(end)
        track = await followed(self.stages[1], self._clock, end, seconds, look)
        self._whereabouts = {(sample, track[-1][1]) for sample, _ in self._whereabouts}
        # a stage with backlash that came from above does not stand where it is wanted
        self._targets = theta_in, None if end < begin and self._backlash[1] else end
        return track

    async def rest(self, stage: RotationStage) -> None:
        """Return when `stage` rests. One that still moves is told to stop again.

        A command that another task had given before may have reached the device after the stop. Raises `DeviceTimeout`
        where it goes on moving.
        """
        begin = self._clock.now()
        while (state := await stage.state()).phase in _MOVING:
            if self._clock.now() - begin > REST_TIME:
                raise DeviceTimeout(
                    f"{stage.name}: is still {state.phase.value} {REST_TIME:g} s after it was stopped; switch it off"
                )
            await stage.stop()
            await self._clock.sleep(REST_POLL)

    async def revive(self) -> None:
        """Reopen a stage that does not answer, and home one that is not ready or has lost count; one attempt.

        Raises `GeometryError` before a stage is homed where a forbidden region may lie between where the arm was last
        known to be and the mark; how a stage searches beyond its mark is not known here.
        """
        for axis, stage in reversed(list(enumerate(self.stages))):
            try:
                state = await stage.state()
            except DriverError as error:
                log.warning("%s (reopening it)", error)
                await stage.close()
                await stage.open()
                state = await stage.state()
            if state.phase in _MOVING:
                await self.rest(stage)
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

    def forget(self) -> None:
        """Believe no longer that the stages stand where they were sent."""
        self._targets = (None, None)

    async def _go(self, wanted: Standing) -> Geometry:
        """What `goto` does, once it is known that the arm may stand where it is wanted."""
        left = targets = self._targets
        self.forget()
        await self._cruise()  # where a sweep before could not
        here = await self.standing()
        self._whereabouts.add(here)  # a stage that has lost count is perhaps still where it was left
        self._check_left(targets, here)
        first = approach(here, wanted, targets, self._backlash)
        stops = safe_path(here, first, self._regions)
        for stop in [*stops, *([wanted] if first != wanted else [])]:
            # on the way only the stage moves whose turn it is; in the end each that was not sent there before
            fixed = targets if stop in (first, wanted) else here
            stays = [fixed[axis] == stop[axis] for axis in range(2)]
            self._whereabouts = {here, stop}
            moves = [Move(self.stages[axis], here[axis], stop[axis], stays[axis]) for axis in range(2)]
            sample, detector = await bring(self._clock, moves)
            targets = (
                targets[0] if stays[0] else stop[0],
                targets[1] if stays[1] else stop[1],
            )
            here = sample, detector
        self._whereabouts = {here}
        settling = [self._settling[axis] for axis in range(2) if left[axis] != wanted[axis]]
        if any(settling):
            await self._clock.sleep(max(settling))
        self._targets = wanted
        return from_stages(*here)

    def _check_left(self, left: tuple[float | None, float | None], here: Standing) -> None:
        """Raise `DeviceFault` where a stage has lost count since it was left; one without encoder shows it only now."""
        for stage, angle, reads in zip(self.stages, left, here, strict=True):
            if angle is not None and not abs(reads - angle) <= ARRIVAL:
                self._astray.add(stage.name)
                raise DeviceFault(f"{stage.name}: reads {reads:.3f}° where it was left at {angle:.3f}°; home it")

    async def _cruise(self) -> None:
        """Give the detector stage the velocity back that it had before it was slowed down."""
        if self._cruising is not None:
            await self.stages[1].set_velocity(self._cruising)
            self._cruising = None
