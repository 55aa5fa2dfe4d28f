"""In which order to visit directions, and how long that takes: a model of both stages as they move.

A stage accelerates, cruises and brakes (`drivers.travel.travel_time`); both move at once. A stage with backlash is
always left standing after a move upwards, so on the way down it passes its target and comes back: sweeping upwards is
quick, and whether an incident angle is swept upwards or downwards is chosen so that the whole path is shortest. The
sample stage goes once through the incident angles of a batch, beginning at one end or the other.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby, pairwise

from drivers.travel import travel_time
from goniometer.geometry import Geometry


@dataclass(frozen=True)
class StageMotion:
    """How one stage moves."""

    velocity: float = 20.0
    """Cruising speed, degrees/s."""
    acceleration: float = 40.0
    """Of the ramps up and down, degrees/s^2."""
    backlash: float = 0.0
    """Degrees by which a target is passed on the way down, to be approached upwards; 0 where the stage needs none."""

    def seconds(self, start: float, end: float) -> float:
        """From rest at `start` to rest at `end`, degrees, approached upwards."""
        if end >= start or self.backlash == 0:
            return travel_time(end - start, self.velocity, self.acceleration)
        there = travel_time(start - end + self.backlash, self.velocity, self.acceleration)
        return there + travel_time(self.backlash, self.velocity, self.acceleration)

    def degrees(self, start: float, end: float) -> float:
        """Way from `start` to `end`, there and back where the target is passed."""
        return abs(end - start) + (2 * self.backlash if end < start else 0.0)


@dataclass(frozen=True)
class Motion:
    """How the bench moves; the default is a bench of ordinary speed without backlash."""

    sample: StageMotion = StageMotion()
    detector: StageMotion = StageMotion()
    settling: float = 0.2
    """Seconds that the arm swings after a move."""

    def seconds(self, start: Geometry, end: Geometry) -> float:
        """From one direction to another, until the arm rests; both stages move at once."""
        if start == end:
            return 0.0
        sample = self.sample.seconds(start.sample_angle, end.sample_angle)
        return max(sample, self.detector.seconds(start.detector_angle, end.detector_angle)) + self.settling


@dataclass(frozen=True)
class Travel:
    """What a path costs."""

    seconds: float
    """Of moving and settling."""
    sample: float
    """Degrees that the sample stage turns."""
    detector: float
    """Degrees that the detector stage turns."""
    sample_moves: int
    """How often the sample stage moves."""


def travel(path: Sequence[Geometry], motion: Motion, start: Geometry | None = None) -> Travel:
    """Cost of visiting `path` in its order, from `start` or from its first direction."""
    legs = list(pairwise([start, *path] if start is not None else path))
    return Travel(
        sum(motion.seconds(a, b) for a, b in legs),
        sum(motion.sample.degrees(a.sample_angle, b.sample_angle) for a, b in legs),
        sum(motion.detector.degrees(a.detector_angle, b.detector_angle) for a, b in legs),
        sum(a.sample_angle != b.sample_angle for a, b in legs),
    )


def ordered(points: Sequence[Geometry], motion: Motion = Motion(), start: Geometry | None = None) -> list[Geometry]:
    """`points` in the order in which to visit them, from `start` or from wherever is best.

    All directions of one incident angle follow each other in one sweep. The quickest of all such paths that take
    the incident angles in ascending or descending order.
    """
    ascending = sorted(points)
    groups = [list(group) for _, group in groupby(ascending, key=lambda g: g.theta_in)]
    paths = [_best_sweeps(order, motion, start) for order in (groups, groups[::-1]) if order]
    return min(paths, key=lambda path: path[0])[1] if paths else []


def _best_sweeps(groups: list[list[Geometry]], motion: Motion, start: Geometry | None) -> tuple[float, list[Geometry]]:
    """Seconds and path, each group swept upwards or downwards: dynamic programming over where the last one ended."""
    ends: list[tuple[float, list[Geometry]]] = [(0.0, [] if start is None else [start])]
    for group in groups:
        reached = []
        for sweep in (group, group[::-1]):
            inside = sum(motion.seconds(a, b) for a, b in pairwise(sweep))
            reached.append(
                min(
                    (cost + (motion.seconds(path[-1], sweep[0]) if path else 0.0) + inside, [*path, *sweep])
                    for cost, path in ends
                )
            )
        ends = reached
    cost, path = min(ends)
    return cost, path[(start is not None) :]
