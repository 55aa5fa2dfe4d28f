"""How long a scan takes: moves, exposures and dead time, with how well that is known beforehand and on the way."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import ceil, floor, hypot, inf, log

import numpy as np

from drivers.arrays import FloatArray
from goniometer.bench.route import Motion, travel
from goniometer.campaigns.campaign import Campaign, Integration
from goniometer.geometry import Geometry
from goniometer.scans.exposure import PROBE_FRACTION, ladder, once
from goniometer.storage.records import Expected, ExposureTime, Point

DEAD_TIME = 0.5
"""Seconds at each point for commands, shutter and read-out, before any point has told."""

EARLIER = (8.0, 20.0)
"""Points an incident angle that dynamic resolution needed on simulated materials, from a smooth sheet to a structured
lobe (`tests/benchmarks/sampling.py`); what is expected of a sample before it is known."""

DARKS = 4
"""Dark spectra of each integration time and temperature."""

STRAY_SCANS = 2
"""Spectra of stray light at each incident angle."""

FEWEST = 3
"""Visits from which something is learnt."""

LATEST = 300
"""So many of the latest visits tell what the next ones will be like."""


@dataclass(frozen=True)
class Foreseen:
    """How many points a scan will have, those that are done included, and between which limits that lies."""

    points: int
    low: int
    high: int


@dataclass(frozen=True)
class Visit:
    """What one measured point took at the bench."""

    geometry: Geometry
    exposure: float
    """Seconds of integration that were kept."""
    dead: float
    """Seconds beyond its moves, that integration, and the darks, stray light and monitors before it."""


def latest(exposures: Sequence[ExposureTime]) -> Sequence[ExposureTime]:
    """Those of `exposures` that make the `LATEST` latest visits, and of the point from where the arm came to these."""
    points: set[int] = set()
    for i in reversed(range(len(exposures))):
        point = exposures[i].point_id
        if point is not None and point not in points:
            if len(points) > LATEST:
                return exposures[i + 1 :]
            points.add(point)
    return exposures


def visits(points: Sequence[Point], exposures: Sequence[ExposureTime], motion: Motion) -> list[Visit]:
    """What the points of a scan took, in the order in which they were measured, on a bench that moves like `motion`.

    `exposures` are all of the scan or the latest of them, in the order in which they were written. Left out are points
    of which nobody knows from where the arm came, as the first one of a session, those that were tried more than once,
    and the first one after a sweep, which takes longer than its spectra.
    """
    measured = {point.id: point for point in points if point.status == "done"}
    integrated: dict[int, float] = {}
    for exposure in exposures:
        if exposure.point_id is not None:
            integrated[exposure.point_id] = integrated.get(exposure.point_id, 0.0) + exposure.integration_time
    found: list[Visit] = []
    here: tuple[str, Geometry] | None = None  # session, and where the arm stood then
    way: list[Geometry] = []
    besides = 0.0
    swept = False
    for i, exposure in enumerate(exposures):
        point = measured.get(exposure.point_id or 0)
        if point is None:
            besides += exposure.integration_time
            swept |= exposure.kind == "sweep"
            way += [exposure.geometry] if exposure.geometry is not None else []
        elif i == 0 or exposures[i - 1].point_id != point.id:
            there = exposure.geometry or point.geometry
            if here is not None and here[0] == exposure.session and point.attempts == 1 and not swept:
                kept = integrated[point.id]
                moving = sum(motion.seconds(a, b) for a, b in pairwise([here[1], *way, there]))
                found.append(Visit(point.geometry, kept, point.seconds - kept - besides - moving))
            here, way, besides, swept = (exposure.session, there), [], 0.0, False
    return found


def expected(
    path: Sequence[Geometry], motion: Motion, integration: Integration, dead_time: float = DEAD_TIME
) -> Expected:
    """Time to visit `path` in its order before anything of the sample is known; `dead_time` in seconds at a point.

    The limits are those of `unknown_exposure`, which is alike for all points: a sample is bright or dark.
    """
    fixed = travel(path, motion).seconds + len(path) * (dead_time + integration.maximum * PROBE_FRACTION)
    each = unknown_exposure(integration)
    return Expected(*(float(fixed + len(path) * time) for time in (each.seconds, each.low, each.high)))


def unknown_exposure(integration: Integration) -> Expected:
    """Integration of a point of which nothing is known but what is allowed, seconds; the limits are all of that.

    Half of all points are too dim to fill the detector in the longest time, and get that; of the others all magnitudes
    are equally likely. On simulated materials points get half to all of the longest time on average
    (`tests/benchmarks/time_left.py`).
    """
    low, high = integration.minimum, integration.time_limit
    if integration.signal_to_noise is None:
        low, high = integration.scans * integration.minimum, integration.scans * integration.maximum
    high += (integration.exposures - 1) * integration.maximum
    mean = (high - low) / log(high / low) if high > low else low
    return Expected((mean + high) / 2, low, high)


def besides(
    campaign: Campaign, motion: Motion, angles: int, lasts: Expected, stray: float, look: Expected, darks: Expected
) -> Expected:
    """Time of a scan for what belongs to no point.

    Stray light at so many incident `angles`, in spectra of `stray` seconds; looks at the lamp that last as `look` says
    while the points last as `lasts` does, and at the end; and `darks`. Each detour turns the arm by 45 degrees and
    back.
    """
    detour = 2 * motion.seconds(Geometry(0.0, 0.0), Geometry(0.0, 45.0))
    facing = angles * (STRAY_SCANS * stray + detour) if campaign.stray_light else 0.0
    parts = []
    for time, dark, each, whole in (
        (lasts.seconds, darks.seconds, look.seconds, float),
        (lasts.low, darks.low, look.low, floor),
        (lasts.high, darks.high, look.high, ceil),
    ):
        looks = 0.0 if campaign.monitor is None else 1 + whole((time + facing + dark) / campaign.monitor.every)
        parts.append(facing + looks * (each + detour) + dark)
    return Expected(*parts)


def unknown_darks(campaign: Campaign) -> Expected:
    """Integration of darks, seconds, of a scan that has none: of all times up to that of a point.

    And of the longest one, with which stray light is taken.
    """
    alone = once(campaign.integration)
    each, times = unknown_exposure(alone), ladder(alone)
    longest = campaign.integration.maximum if campaign.stray_light else 0.0
    return Expected(
        *(DARKS * sum(t for t in times if t <= time or t == longest) for time in (each.seconds, each.low, each.high))
    )


def remaining(
    seen: Sequence[Visit],
    batch: Sequence[Geometry],
    moving: Sequence[float],
    pending: int,
    total: Foreseen,
    done: int,
) -> Expected:
    """Time for the points to come, as those that were seen tell; needs `FEWEST` of these.

    `batch` are the directions that the plan asked for last, of which the last `pending` are still to be visited, and
    `moving` the seconds of the moves there. Each takes as long to expose as the seen one that is nearest to it: in
    incident angle, and in distance from the mirror direction. Points beyond the batch, until there are as many as are
    foreseen, are like those of the batch: the plan goes on where it is. The limits are those of the number of points,
    and two standard deviations of the exposures, which err alike at one incident angle.
    """
    exposure = np.array([visit.exposure for visit in seen])
    places = _places([visit.geometry for visit in seen])
    each = exposure[_distances(_places(batch), places).argmin(axis=1)]
    apart = _distances(places, places)
    np.fill_diagonal(apart, inf)
    error = float(np.sqrt(np.mean((exposure - exposure[apart.argmin(axis=1)]) ** 2)))
    dead = dead_time(seen) or 0.0
    first = len(batch) - pending
    on_the_way, typical = sum(moving[first:]), sum(moving) / len(moving)
    groups = len({geometry.theta_in for geometry in batch})
    parts = []
    for points, side in ((total.points, 0), (total.low, -1), (total.high, 1)):
        more = max(points - done - pending, 0)
        exposing = float(each[first:].sum() + more * each.mean())
        deviation = error * hypot((pending + more) / np.sqrt(groups), np.sqrt(pending + more))
        exposing = max(exposing + 2 * side * deviation, 0.0)
        parts.append(on_the_way + more * typical + (pending + more) * dead + exposing)
    return Expected(*parts)


def dead_time(seen: Sequence[Visit]) -> float | None:
    """Mean seconds at a point beyond its moves and integration; None where too few have told."""
    return max(float(np.mean([visit.dead for visit in seen])), 0.0) if len(seen) >= FEWEST else None


def _places(path: Sequence[Geometry]) -> FloatArray:
    """[directions, 2] incident angle, and distance from the mirror direction, degrees."""
    return np.array([(geometry.theta_in, geometry.theta_out - geometry.theta_in) for geometry in path])


def _distances(some: FloatArray, others: FloatArray) -> FloatArray:
    """[some, others] degrees."""
    return np.abs(some[:, None, 0] - others[:, 0]) + np.abs(some[:, None, 1] - others[:, 1])
