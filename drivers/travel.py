"""Refusing an angle out of limits, how long a motion takes, and waiting for it to end: for all rotation stages."""

import math
from collections.abc import Awaitable, Callable

from drivers.clock import Clock
from drivers.errors import DeviceFault, DeviceRefused, DeviceTimeout
from drivers.interfaces import StagePhase, StageState

POLL_INTERVAL = 0.05
"""Seconds between two questions about a motion that should have ended."""
LONGEST_PAUSE = 2.0
"""Seconds after which a motion under way is looked at, so that a fault does not stay unseen until its end."""
ALLOWANCE = 5.0
"""Seconds that any motion may take beyond one and a half times its expected duration."""
HOMING_TIME = 120.0
"""Seconds that a search for the reference mark may take."""
HOMING_POLL = 0.5
"""Seconds between two questions while it searches."""
AT_TARGET = 0.1
"""Degrees between the commanded angle and the one read back, beyond which a motion has failed."""


def travel_time(distance: float, velocity: float, acceleration: float) -> float:
    """Seconds from rest to rest over `distance` degrees.

    Constant acceleration (degrees/s^2) up to `velocity` (degrees/s), cruise, constant deceleration; over a
    short way the velocity is never reached and the profile is a triangle.

    >>> travel_time(90.0, velocity=20.0, acceleration=40.0), travel_time(2.5, velocity=20.0, acceleration=40.0)
    (5.0, 0.5)
    """
    distance = abs(distance)
    if distance < velocity**2 / acceleration:
        return 2 * math.sqrt(distance / acceleration)
    return distance / velocity + velocity / acceleration


def check_limits(name: str, angle: float, limits: tuple[float, float]) -> None:
    """Raise `DeviceRefused` when `angle` lies outside `limits` or is no number; all in degrees."""
    if not limits[0] <= angle <= limits[1]:
        message = f"{name}: {angle:g}° is outside its limits; command an angle from {limits[0]:g}° to {limits[1]:g}°"
        raise DeviceRefused(message)


def check_arrival(name: str, angle: float, reached: float) -> None:
    """Raise `DeviceFault` when a stage that should rest at `angle` reads back `reached`, both in degrees."""
    if abs(reached - angle) > AT_TARGET:
        message = f"{name}: came to rest at {reached:.3f}° instead of {angle:.3f}°; look for an obstacle or a stop"
        raise DeviceFault(message)


async def wait_for_rest(
    name: str,
    clock: Clock,
    ask_state: Callable[[], Awaitable[StageState]],
    *,
    expected: float,
    at_most: float,
    poll: float = POLL_INTERVAL,
) -> StageState:
    """Wait until a stage neither moves nor homes, and return its state then.

    `expected` is how long the motion should take; a stage is seldom asked before that, because each question
    costs time on a slow line, and every `poll` after it. All in seconds. Raises `DeviceFault` as soon as the
    stage reports a fault and `DeviceTimeout` when it is not at rest after `at_most`.
    """
    begin = clock.now()
    pause = min(max(expected, poll), LONGEST_PAUSE)
    while True:
        await clock.sleep(pause)
        # the time is taken before the question: another task may let much of it pass before the answer
        elapsed = clock.now() - begin
        state = await ask_state()
        if state.phase is StagePhase.FAULT:
            raise DeviceFault(f"{name}: stopped with a fault: {state.message}; clear its cause, then home the stage")
        if state.phase not in {StagePhase.MOVING, StagePhase.HOMING}:
            return state
        if elapsed > at_most:
            message = f"{name}: still {state.phase.value} after {elapsed:.1f} s; it should rest after {at_most:.1f} s"
            raise DeviceTimeout(message + "; look for an obstacle or a wrong velocity")
        pause = min(max(expected - elapsed, poll), LONGEST_PAUSE)


def longest_travel(expected: float) -> float:
    """Seconds after which a motion that should take `expected` seconds has failed."""
    return 1.5 * expected + ALLOWANCE
