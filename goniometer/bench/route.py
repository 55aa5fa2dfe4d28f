"""In which order to visit directions, and how long that takes: a model of both stages as they move.

A stage accelerates, cruises and brakes (`drivers.travel.travel_time`); both move at once. A stage with backlash is
always left standing after a move upwards, so on the way down it passes its target and comes back: sweeping upwards is
quick, and whether an incident angle is swept upwards or downwards is chosen so that the whole path is shortest. The
sample stage stands once at each incident angle of a batch.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby, pairwise, permutations

from drivers.travel import travel_time
from goniometer.geometry import Geometry

FEW = 4
"""Incident angles of which all orders are tried."""


@dataclass(frozen=True)
class StageMotion:
    """How one stage moves."""

    velocity: float = 20.0
    """Cruising speed, degrees/s."""
    acceleration: float = 40.0
    """Of the ramps up and down, degrees/s^2."""
    backlash: float = 0.0
    """Degrees by which a target is passed on the way down, to be approached upwards; 0 where the stage needs none."""
    settling: float = 0.0
    """Seconds that the arm swings after a move of this stage."""

    def seconds(self, start: float, end: float) -> float:
        """From rest at `start` to rest at `end`, degrees, approached upwards; without settling."""
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

    def seconds(self, start: Geometry, end: Geometry) -> float:
        """From one direction to another, until the arm rests; both stages move at once."""
        legs = (
            (self.sample, start.sample_angle, end.sample_angle),
            (self.detector, start.detector_angle, end.detector_angle),
        )
        moving = max(stage.seconds(here, there) for stage, here, there in legs)
        return moving + max((stage.settling for stage, here, there in legs if here != there), default=0.0)


def approach(
    here: tuple[float, float],
    wanted: tuple[float, float],
    targets: tuple[float | None, float | None],
    backlash: tuple[float, float],
) -> tuple[float, float]:
    """Where sample and detector stage stop first, on their way from `here` to `wanted`, to arrive upwards; degrees.

    A stage that is above its target, or nearer to it than its `backlash` while nobody knows from which side it came
    (its last target is None), stops below by its backlash. One whose target stays as it was, stays.
    """
    first = list(wanted)
    for axis, slack in enumerate(backlash):
        is_loose = here[axis] > wanted[axis] or (targets[axis] is None and here[axis] > wanted[axis] - slack)
        if targets[axis] != wanted[axis] and is_loose:
            first[axis] -= slack
    return first[0], first[1]


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

    All directions of one incident angle follow each other in one sweep, first those of the angle at which the sample
    stage stands, so that it moves as rarely as possible. The quickest of all such paths that take the other incident
    angles in ascending or descending order, or first those on one side of where the stage stands and then those on the
    other; of few incident angles, in any order.
    """
    groups = [list(group) for _, group in groupby(sorted(points), key=lambda g: g.theta_in)]
    stands = start.theta_in if start is not None else -math.inf
    here = [group for group in groups if group[0].theta_in == stands]
    below = [group for group in groups if group[0].theta_in < stands][::-1]
    above = [group for group in groups if group[0].theta_in > stands]
    if len(below) + len(above) <= FEW:
        others = [list(order) for order in permutations([*below, *above])]
    else:
        others = [[*below, *above], [*above, *below], [*below[::-1], *above], [*above[::-1], *below]]
    return min((_best_sweeps([*here, *order], motion, start) for order in others), key=lambda path: path[0])[1]


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
