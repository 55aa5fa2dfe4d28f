"""One rotation axis in simulated time."""

import math
import threading
from collections.abc import Callable

import numpy as np

from drivers.arrays import FloatArray
from simulators.devices.clock import SimulatedClock


class Axis:
    """A motor that ramps up, cruises and ramps down on the clock; all stage simulators move one of these.

    Its state is computed from the clock whenever somebody asks, so nothing runs in between. Angles are
    degrees. `positioning_error(target)` is how far beyond the read-back the stage really stands (backlash,
    repeatability, a zero offset), in degrees. Thread-safe.
    """

    def __init__(
        self,
        clock: SimulatedClock,
        *,
        start: float = 0.0,
        velocity: float,
        acceleration: float,
        limits: tuple[float, float],
        positioning_error: Callable[[float], float] = lambda target: 0.0,
    ) -> None:
        self.velocity = velocity
        """Cruising speed of the next motion, degrees/s."""
        self.acceleration = acceleration
        """Of ramps up and down, degrees/s^2."""
        self.limits = limits
        """Lowest and highest angle that the mechanics allow, degrees."""
        self._clock = clock
        self._positioning_error = positioning_error
        self._lock = threading.RLock()
        self._begin = clock.now()
        self._from = start
        self._initial_velocity = 0.0
        self._ramps: list[tuple[float, float]] = []
        """What has been and is to be done since `_begin`: seconds, degrees/s^2."""
        self._target = start
        self._homing = False

    def move(self, target: float) -> None:
        """Begin to move to `target` degrees; a motion under way is first braked.

        Raises `ValueError` outside `limits`: it is for the device in front of the axis to refuse.
        """
        if not self.limits[0] <= target <= self.limits[1]:
            raise ValueError(
                f"the axis cannot stand at {target:g}°; it goes from {self.limits[0]:g}° to {self.limits[1]:g}°"
            )
        with self._lock:
            self.stop()
            rest = self._target
            self._ramps += _ramps_to(target - rest, self.velocity, self.acceleration)
            self._target = target

    def home(self) -> None:
        """Begin to move to the reference mark at 0 degrees. Raises `ValueError` where that lies outside `limits`."""
        with self._lock:
            self.move(0.0)
            self._homing = True

    def stop(self) -> None:
        """Begin to brake."""
        with self._lock:
            position, velocity = self._at(self._clock.now())
            self._begin = self._clock.now()
            self._from, self._initial_velocity, self._homing = position, velocity, False
            braking_time = abs(velocity) / self.acceleration
            self._ramps = [(braking_time, -math.copysign(self.acceleration, velocity))] if velocity else []
            self._target = position + velocity * braking_time / 2

    def position(self) -> float:
        """What the encoder reads now, degrees."""
        with self._lock:
            return self._at(self._clock.now())[0]

    def moving(self) -> bool:
        """Whether a motion, homing included, is under way."""
        with self._lock:
            return self._clock.now() - self._begin < sum(duration for duration, _ in self._ramps)

    def homing(self) -> bool:
        """Whether a search for the reference mark is under way."""
        with self._lock:
            return self._homing and self.moving()

    def true_positions(self, moments: FloatArray) -> FloatArray:
        """[moments] where the stage really stood or stands, degrees: the read-back plus the error at the last target.

        `moments` are seconds on the clock, none later than now. Of those before the present motion it is known only
        that it began where that one ended.
        """
        with self._lock:
            read = np.array([self._at(float(moment))[0] for moment in moments])
            return np.asarray(read + self._positioning_error(self._target))

    def _at(self, moment: float) -> tuple[float, float]:
        """Position in degrees and velocity in degrees/s."""
        left = max(moment - self._begin, 0.0)
        position, velocity = self._from, self._initial_velocity
        for duration, acceleration in self._ramps:
            step = min(duration, left)
            position += (velocity + acceleration * step / 2) * step
            velocity += acceleration * step
            left -= step
            if left <= 0:
                return position, velocity
        # exactly, without the rounding of the sum
        return self._target, 0.0


def _ramps_to(distance: float, velocity: float, acceleration: float) -> list[tuple[float, float]]:
    """Ramps from rest to rest over `distance` degrees: seconds, degrees/s^2.

    A ramp of t seconds reaches the speed a t and both together cover a t^2; what is left of the way is cruised at that
    speed. On a short way the two meet in the middle, and `velocity` is never reached.
    """
    ramp_time = min(velocity / acceleration, math.sqrt(abs(distance) / acceleration))
    cruise_time = (abs(distance) - acceleration * ramp_time**2) / (acceleration * ramp_time) if ramp_time else 0.0
    signed = math.copysign(acceleration, distance)
    return [(ramp_time, signed), (max(cruise_time, 0.0), 0.0), (ramp_time, -signed)]
