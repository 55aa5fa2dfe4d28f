"""What a plan is asked for, and the directions that are certain before anything is measured."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np

from drivers.arrays import FloatArray
from goniometer.bench.route import Motion, ordered
from goniometer.campaigns.campaign import Campaign
from goniometer.geometry import BLOCKED_HALF_WIDTH, LARGEST_ANGLE, Geometry

OFFSETS = (1.0, 2.5, 6.0, 14.0, 30.0)
"""Degrees beside the mirror direction that the coarse pass visits, shared out among the incident angles."""

ORDINARY = Motion()
"""A bench of ordinary speed."""

SMALLEST_BATCH = 4
"""Directions that are measured between two looks at the errors, at the least."""

LEAST_COARSE = 7
"""Directions of a coarse pass over all incident angles, at the least, if they may lie so close."""

SAME = 1e-6
"""Degrees below which two planned angles are the same."""


@dataclass(frozen=True)
class PlanSpec:
    """What is to be sampled; angles in degrees."""

    theta_in: tuple[float, ...]
    """Incident angles, ascending."""
    lowest: float = -LARGEST_ANGLE
    """Lowest theta_out."""
    highest: float = LARGEST_ANGLE
    """Highest theta_out."""
    tolerance: float = 0.005
    """Wanted root mean square error, over all directions, of reading ln(1 + cos(theta_in) f) between the points."""
    step: float = 1.0
    """Distance of directions in mode "uniform"."""
    minimum_step: float = 0.2
    """Dynamic resolution brings no two directions closer than this."""
    colour_tolerance: float | None = 0.2
    """Wanted mean dE00 of reading a colour between the points; None where colour does not matter."""
    mode: Literal["dynamic", "uniform"] = "dynamic"
    """Whether the plan finds the directions or takes an even grid."""
    most_points: int | None = None
    """Budget of points; None for no limit."""
    most_seconds: float | None = None
    """Budget of time at the bench, seconds; None for no limit."""
    importance: Callable[[FloatArray, FloatArray], FloatArray] | None = None
    """How much directions matter: a non-negative number [points] for each theta_in and theta_out [points]; None where
    all matter alike. Errors are averaged with it, so directions of importance 0 are not measured for their own sake."""
    colour_slope: float | None = None
    """Mean dE00 for each unit of error of ln(cos f), alike in all directions, where these are seen in a scene and not
    each by itself; None where they are."""
    u_angle: float = 0.0
    """Standard uncertainty of a stage's position: a point on a steep flank cannot tell more than that."""
    motion: Motion = ORDINARY
    """How the bench moves, for the order of a batch."""


def plan_spec(campaign: Campaign, motion: Motion = ORDINARY, u_angle: float = 0.0) -> PlanSpec:
    """What a campaign wants sampled on each of its samples, on a bench that moves like `motion`.

    `u_angle` is the standard uncertainty of a stage's position, degrees.
    """
    wanted = campaign.resolution
    scene = wanted.scene
    return PlanSpec(
        campaign.theta_in,
        campaign.outgoing.start,
        campaign.outgoing.stop,
        wanted.tolerance if scene is None else math.inf,
        wanted.step,
        wanted.minimum_step,
        wanted.colour_tolerance,
        wanted.mode,
        wanted.points,
        wanted.time,
        importance=None if scene is None else scene.importance,
        colour_slope=None if scene is None else scene.colour_slope,
        u_angle=u_angle,
        motion=motion,
    )


MONITOR_INCIDENCE = 30.0
"""Degrees; the lamp is monitored at the incident angle nearest to it, in the mirror direction, where light is."""


def monitor_direction(spec: PlanSpec) -> Geometry:
    """Where the lamp is monitored: the measurable direction that is nearest to a mirror direction."""
    theta_in = min(spec.theta_in, key=lambda t: abs(t - MONITOR_INCIDENCE))
    nearest = [min(max(theta_in, low), high) for low, high in segments(spec, theta_in)]
    return Geometry(theta_in, min(nearest, key=lambda a: abs(a - theta_in)))


def blocked_ranges(spec: PlanSpec) -> dict[float, tuple[float, float]]:
    """For each incident angle the open interval of theta_out in which the detector blocks the source, degrees."""
    return {t: (-t - BLOCKED_HALF_WIDTH, -t + BLOCKED_HALF_WIDTH) for t in spec.theta_in}


def segments(spec: PlanSpec, theta_in: float) -> list[tuple[float, float]]:
    """The measurable ranges of theta_out at one incident angle, degrees, ascending; ends belong to them."""
    low, high = -theta_in - BLOCKED_HALF_WIDTH, -theta_in + BLOCKED_HALF_WIDTH
    # Rounding must not put an edge into the sector that it bounds.
    low -= 1e-9 if Geometry(theta_in, low).blocked else 0.0
    high += 1e-9 if Geometry(theta_in, high).blocked else 0.0
    parts = [(spec.lowest, min(low, spec.highest)), (max(high, spec.lowest), spec.highest)]
    return [(a, b) for a, b in parts if a <= b]


def uniform_grid_size(spec: PlanSpec, step: float = 1.0) -> int:
    """How many measurable directions a uniform grid of `step` degrees in theta_out has, for comparison."""
    return len(uniform(spec, step))


def reference_points(spec: PlanSpec, step: float = 10.0) -> list[Geometry]:
    """The directions of the reference scan: every `step` degrees from one end, and all edges; in visiting order.

    A sample's point finds the instrument's response by interpolation between them. The incident angles are those that
    the samples' scans visit: in a scene the ones that matter to it. The default range avoids
    theta_out = 0, where the azimuth of the reflected light turns over and the panel's nominal BRDF jumps.
    """
    count = int(np.floor((spec.highest - spec.lowest) / step + SAME)) + 1
    wanted = [float(spec.lowest + step * i) for i in range(count)]
    return ordered([Geometry(t, a) for t in incident(spec) for a in _within(spec, t, wanted)], spec.motion)


def uniform(spec: PlanSpec, step: float) -> list[Geometry]:
    """The measurable directions of a grid of `step` degrees in theta_out."""
    count = int(np.floor((spec.highest - spec.lowest) / step + SAME)) + 1
    angles = spec.lowest + step * np.arange(count)
    grid = [Geometry(t, float(a)) for t in spec.theta_in for a in angles]
    return [geometry for geometry in grid if not geometry.blocked]


def _within(spec: PlanSpec, theta_in: float, wanted: list[float]) -> list[float]:
    """Those of `wanted` that lie in the measurable segments, and the segments' ends; ascending."""
    angles: list[float] = []
    for low, high in segments(spec, theta_in):
        inside = [a for a in sorted(wanted) if low < a < high]
        angles += [low, *_without(inside, [low, high]), *([high] if high > low else [])]
    return angles


def _without(angles: list[float], others: list[float]) -> list[float]:
    """`angles` that are none of `others`."""
    return [a for a in angles if all(abs(a - b) > SAME for b in others)]


MATTERS = 0.04
"""Part of the weight of all incident angles that one must have in a scene to be visited."""

FIRST_IN_SCENE = 8
"""About how many directions a scene is begun with, shared out by the weight of the incident angles."""

_MOST_OF_ONE = 3
"""Of which an incident angle gets no more."""


def incident(spec: PlanSpec) -> tuple[float, ...]:
    """The incident angles that are visited, degrees: all, or in a scene those that matter."""
    return spec.theta_in if spec.colour_slope is None else tuple(_first_in_scene(spec))


def confirming(spec: PlanSpec) -> int:
    """How many points must be where they were expected, twice running, before a sampling is called accurate."""
    return len(spec.theta_in) if spec.colour_slope is None else max(len(incident(spec)) // 2, SMALLEST_BATCH)


def _first_in_scene(spec: PlanSpec) -> dict[float, FloatArray]:
    """Of each incident angle that matters, one to three theta_out that divide what matters of it evenly, degrees."""
    importance = spec.importance
    assert importance is not None  # a scene has weights
    rows: dict[float, tuple[FloatArray, FloatArray]] = {}
    for t in spec.theta_in:
        angles = np.concatenate([np.linspace(a, b, max(round(b - a), 1) + 1) for a, b in segments(spec, t)])
        running = np.cumsum(importance(np.full_like(angles, t), angles))
        rows[t] = running, angles
    total = sum(float(running[-1]) for running, _ in rows.values())
    found: dict[float, FloatArray] = {}
    for t, (running, angles) in rows.items():
        share = float(running[-1]) / total
        if share >= MATTERS:
            count = min(max(round(FIRST_IN_SCENE * share), 1), _MOST_OF_ONE)
            at = (np.arange(count) + 0.5) / count * running[-1]
            found[t] = np.round(np.interp(at, running, angles), 2)
    return found


def coarse(spec: PlanSpec) -> list[Geometry]:
    """Directions of the coarse pass, by incident angle and theta_out; in a scene only such that matter."""
    if spec.colour_slope is not None:
        few = [Geometry(t, float(a)) for t, angles in _first_in_scene(spec).items() for a in angles]
        few = [g for g in dict.fromkeys(few) if not g.blocked]
        return sorted([*few, *_halved(spec, few)])
    number = len(OFFSETS) if len(spec.theta_in) < 4 else 1
    found: list[Geometry] = []
    for i, t in enumerate(spec.theta_in):
        side = 1 if i % 2 else -1
        chosen = [OFFSETS[(i + k) % len(OFFSETS)] for k in range(number)]
        opposite = [OFFSETS[(i + 2 + k) % len(OFFSETS)] for k in range(number)]
        beside = [t + side * offset for offset in chosen] + [t - side * offset for offset in opposite]
        angles = _within(spec, t, [t, *beside])
        gaps = [(b - a, a, b) for low, high in segments(spec, t) for a, b in _pairs(angles, low, high)]
        if gaps:
            _, a, b = max(gaps)
            angles.append(round((a + b) / 2, 2))
        found += [Geometry(t, a) for a in sorted(angles)]
    return sorted([*found, *_halved(spec, found)])


def _halved(spec: PlanSpec, found: list[Geometry]) -> list[Geometry]:
    """Middles of the widest gaps between `found`, until there is enough to learn from, however narrow the range."""
    middles: list[Geometry] = []
    while len(found) + len(middles) < LEAST_COARSE:
        rows = {t: sorted(g.theta_out for g in [*found, *middles] if g.theta_in == t) for t in spec.theta_in}
        gaps = [
            (b - a, t, (a + b) / 2)
            for t, angles in rows.items()
            for low, high in segments(spec, t)
            for a, b in _pairs(angles, low, high)
        ]
        widest = max(gaps, default=(0.0, 0.0, 0.0))
        if widest[0] < 2 * spec.minimum_step:
            break
        middles.append(Geometry(widest[1], widest[2]))
    return middles


def _pairs(angles: list[float], low: float, high: float) -> list[tuple[float, float]]:
    inside = [a for a in angles if low <= a <= high]
    return list(pairwise(inside))
