"""How long a scan takes: moves, exposures and dead time, with how well that is known beforehand."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from goniometer.campaign import Integration
from goniometer.exposure import PROBE_FRACTION
from goniometer.geometry import Geometry
from goniometer.route import Motion, travel

DEAD_TIME = 0.5
"""Seconds at each point for commands, shutter and read-out, before any point has told."""

EARLIER = (8.0, 20.0)
"""Points an incident angle that dynamic resolution needed on simulated materials, from a smooth sheet to a structured
lobe (`tests/benchmarks/sampling.py`); what is expected of a sample before it is known."""


@dataclass(frozen=True)
class Expected:
    """A time in seconds and between which limits it lies."""

    seconds: float
    low: float
    high: float

    def __add__(self, other: "Expected") -> "Expected":
        """Of two parts that are long or short for the same reason, such as a dark sample."""
        return Expected(self.seconds + other.seconds, self.low + other.low, self.high + other.high)


@dataclass(frozen=True)
class PointTime:
    """What measured points have told."""

    exposure: float
    """Mean seconds of integration at a point."""
    dead: float
    """Mean seconds at a point beyond its moves and integration."""
    exposure_spread: float
    """Standard deviation of the integration between points, seconds."""


def point_time(
    seconds: Sequence[float], integration: Sequence[float], path: Sequence[Geometry], motion: Motion
) -> PointTime:
    """From the time that each point took at the bench and its integration, in the order in which they were visited.

    The first point is left out, because nobody knows from where the arm came. Needs two points.
    """
    moving = np.array([motion.seconds(a, b) for a, b in pairwise(path)])
    taken, integrated = np.array(seconds[1:]), np.array(integration[1:])
    # Recovery from a fault makes single points long; it is not what a point takes.
    dead = float(np.median(taken - integrated - moving))
    return PointTime(float(integrated.mean()), max(dead, 0.0), float(integrated.std()))


def expected(
    path: Sequence[Geometry],
    motion: Motion,
    integration: Integration,
    scans: int,
    start: Geometry | None = None,
    known: PointTime | None = None,
) -> Expected:
    """Time to visit `path` in its order.

    Before anything is measured the integration time of a point may be anything that the campaign allows, all
    magnitudes being equally likely, and alike for all points: a sample is bright or dark. Afterwards it is as it was.
    The limits are two standard deviations away, but never beyond what the campaign allows.
    """
    count = len(path)
    moving = travel(path, motion, start).seconds
    low, high = integration.minimum, integration.maximum
    probe = high * PROBE_FRACTION
    if known is None:
        ratio = np.log(high / low) if high > low else 1.0
        mean = (high - low) / ratio if high > low else low
        deviation = np.sqrt(max((high**2 - low**2) / (2 * ratio) - mean**2, 0.0))
        dead = DEAD_TIME
        limits = max(mean - 2 * deviation, low), min(mean + 2 * deviation, high)
    else:
        mean, dead, probe = known.exposure / scans, known.dead, 0.0
        deviation = known.exposure_spread / scans / np.sqrt(max(count, 1))
        limits = max(mean - 2 * deviation, 0.0), mean + 2 * deviation
    fixed = moving + count * (dead + probe)
    return Expected(*(float(fixed + count * scans * each) for each in (mean, *limits)))
