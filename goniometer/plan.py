"""Where to measure next: a pure function of what was asked for and what has been measured.

For each incident angle a coarse sweep comes first: a grid in theta_out, the mirror direction with close
neighbours so that a narrow lobe is noticed, the edges of the blocked sector and both ends of the range.
Then an interval is halved wherever the interpolation is not yet known to be good at its middle. Everything
happens in y = ln(1 + cos(theta_in) f), the scale on which the fits compare a model with a measurement (Loew
et al. 2012). Nothing moves and nothing is remembered here, so a preview, a dry run and a resume after a
power cut are the same call.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.interpolate import Akima1DInterpolator, PchipInterpolator

from drivers.arrays import FloatArray
from goniometer.campaign import Campaign
from goniometer.geometry import BLOCKED_HALF_WIDTH, LARGEST_ANGLE, Geometry

MIRROR_OFFSETS = (-3.0, -1.0, 0.0, 1.0, 3.0)
"""Degrees from the mirror direction that the coarse sweep always visits, if the range allows."""

MONITOR_INCIDENCE = 30.0
"""Degrees; the lamp is monitored at the incident angle nearest to it, in the mirror direction, where light is."""

GOOD_SIGNAL = 20.0
"""Signal over noise of a direction in which two places of a sample are compared."""

_SAME = 1e-6
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
    tolerance: float = 0.02
    """Largest wanted interpolation error of ln(1 + cos(theta_in) f)."""
    coarse_step: float = 10.0
    """Distance of the directions of the coarse sweep."""
    minimum_step: float = 0.5
    """Refinement brings no two directions closer than this."""


@dataclass(frozen=True)
class Measured:
    """One point that needs no further visit."""

    geometry: Geometry
    """As planned, not as read back: the plan recognises its own points by it."""
    values: FloatArray
    """[bands] cos(theta_in) f averaged over a few wavelength bands; NaN where the point failed."""
    noise: FloatArray
    """[bands] standard uncertainty of `values`."""


def plan_spec(campaign: Campaign) -> PlanSpec:
    """What a campaign wants sampled on each of its samples."""
    return PlanSpec(
        campaign.theta_in,
        campaign.outgoing.start,
        campaign.outgoing.stop,
        campaign.resolution.tolerance,
        campaign.resolution.coarse_step,
        campaign.resolution.minimum_step,
    )


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


def next_points(spec: PlanSpec, measured: list[Measured]) -> list[Geometry]:
    """The next batch of directions, in the order in which to visit them; empty when the sampling is done.

    Blocked directions never appear. Give all of the batch back as measured before asking again: the same
    measured points always give the same batch.
    """
    done = _by_incidence(spec, measured)
    missing = {t: _without(_coarse(spec, t), [p.geometry.theta_out for p in done[t]]) for t in spec.theta_in}
    if not any(missing.values()):
        missing = {t: [0.5 * (a + b) for a, b, _ in _open_intervals(spec, t, done[t])] for t in spec.theta_in}
    return _sweep(missing)


def expected_total(spec: PlanSpec, measured: list[Measured]) -> int:
    """How many points there will be in the end, judged from the intervals that are still open.

    An interval whose error is e becomes good after about log2(e / tolerance) / 2 halvings, because the error
    of the interpolation falls with the square of the distance. Where the coarse sweep is not complete, its
    missing points are counted, and no refinement.
    """
    done = _by_incidence(spec, measured)
    total = len(measured)
    for t in spec.theta_in:
        missing = _without(_coarse(spec, t), [p.geometry.theta_out for p in done[t]])
        total += len(missing)
        if missing:
            continue
        for a, b, excess in _open_intervals(spec, t, done[t]):
            halvings = min(np.ceil(0.5 * np.log2(excess)), np.floor(np.log2((b - a) / spec.minimum_step) + _SAME))
            total += int(2 ** max(halvings, 1)) - 1
    return total


def uniform_grid_size(spec: PlanSpec, step: float = 1.0) -> int:
    """How many measurable directions a uniform grid of `step` degrees in theta_out has, for comparison."""
    return len(_uniform(spec, step))


def reference_points(spec: PlanSpec, step: float = 10.0) -> list[Geometry]:
    """The directions of the reference scan: every `step` degrees from one end, and all edges; in visiting order.

    A sample's point finds the instrument's response by interpolation between them. The default range avoids
    theta_out = 0, where the azimuth of the reflected light turns over and the panel's nominal BRDF jumps.
    """
    count = int(np.floor((spec.highest - spec.lowest) / step + _SAME)) + 1
    wanted = [float(spec.lowest + step * i) for i in range(count)]
    return _sweep({t: _within(spec, t, wanted) for t in spec.theta_in})


def monitor_direction(spec: PlanSpec) -> Geometry:
    """Where the lamp is monitored: the measurable direction that is nearest to a mirror direction."""
    theta_in = min(spec.theta_in, key=lambda t: abs(t - MONITOR_INCIDENCE))
    nearest = [min(max(theta_in, low), high) for low, high in segments(spec, theta_in)]
    return Geometry(theta_in, min(nearest, key=lambda a: abs(a - theta_in)))


def spot_points(measured: list[Measured], count: int) -> list[Geometry]:
    """Up to `count` measured directions in which another place of the sample is compared, by ascending theta_out.

    They lie at the middle incident angle, are spread from backward to forward scattering and include the one nearest
    to the mirror direction. Dark directions are left out while there are others.
    """
    valued = [p for p in measured if np.all(np.isfinite(p.values))]
    if not valued:
        return []
    incident = sorted({p.geometry.theta_in for p in valued})
    theta_in = incident[(len(incident) - 1) // 2]
    here = [p for p in valued if p.geometry.theta_in == theta_in]
    here.sort(key=lambda p: float(np.median(p.values / np.maximum(p.noise, 1e-12))), reverse=True)
    good = [p for p in here if np.median(p.values) > GOOD_SIGNAL * np.median(p.noise)]
    angles = sorted(p.geometry.theta_out for p in (good if len(good) >= count else here[:count]))
    chosen = [min(angles, key=lambda a: abs(a - theta_in))]
    # of evenly spread directions the one at the mirror direction has been chosen already
    wanted = sorted(np.linspace(angles[0], angles[-1], count), key=lambda a: -abs(a - chosen[0]))
    for target in wanted[: min(count, len(angles)) - 1]:
        chosen.append(min((a for a in angles if a not in chosen), key=lambda a: abs(a - target)))
    return [Geometry(theta_in, a) for a in sorted(chosen)]


def _uniform(spec: PlanSpec, step: float) -> list[Geometry]:
    count = int(np.floor((spec.highest - spec.lowest) / step + _SAME)) + 1
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


def _coarse(spec: PlanSpec, theta_in: float) -> list[float]:
    """Directions of the coarse sweep, ascending; grid points next to a mirror neighbour give way to it."""
    near = [theta_in + offset for offset in MIRROR_OFFSETS]
    step = spec.coarse_step
    grid = [float(a) for a in step * np.arange(np.ceil(spec.lowest / step), np.floor(spec.highest / step) + 1)]
    return _within(spec, theta_in, near + [a for a in grid if min(abs(a - b) for b in near) >= 1.0])


def _without(angles: list[float], others: list[float]) -> list[float]:
    """`angles` that are none of `others`."""
    return [a for a in angles if all(abs(a - b) > _SAME for b in others)]


def _by_incidence(spec: PlanSpec, measured: list[Measured]) -> dict[float, list[Measured]]:
    """Measured points of each incident angle, by ascending theta_out."""
    ordered = sorted(measured, key=lambda p: p.geometry.theta_out)
    return {t: [p for p in ordered if abs(p.geometry.theta_in - t) <= _SAME] for t in spec.theta_in}


def _sweep(angles: dict[float, list[float]]) -> list[Geometry]:
    """All directions of one incident angle in one sweep, every other sweep backwards; the sample moves rarely."""
    path: list[Geometry] = []
    for theta_in, outgoing in angles.items():
        if outgoing:
            backwards = bool(path) and path[-1].theta_out > 0.5 * (outgoing[0] + outgoing[-1])
            path += [Geometry(theta_in, a) for a in sorted(outgoing, reverse=backwards)]
    return path


def _open_intervals(spec: PlanSpec, theta_in: float, points: list[Measured]) -> list[tuple[float, float, float]]:
    """Intervals (from, to, error / allowed error) that need a point in their middle."""
    found = []
    for low, high in segments(spec, theta_in):
        inside = [p for p in points if low - _SAME <= p.geometry.theta_out <= high + _SAME]
        visited = np.array([p.geometry.theta_out for p in inside])
        valued = [p for p in inside if np.all(np.isfinite(p.values))]
        if len(valued) < 2:
            continue
        x = np.array([p.geometry.theta_out for p in valued])
        values = np.maximum(np.array([p.values for p in valued]), 0.0)
        y, noise = np.log1p(values), np.array([p.noise for p in valued]) / (1 + values)
        allowed = np.maximum(spec.tolerance, 2 * np.maximum(noise[1:], noise[:-1]))
        excess = np.max(_middle_error(x, y) / allowed, axis=1)
        for (a, b), ratio in zip(pairwise(x), excess, strict=True):
            middle = 0.5 * (a + b)
            untried = np.min(np.abs(visited - middle)) > _SAME
            if ratio > 1 and 0.5 * (b - a) >= spec.minimum_step - _SAME and untried:
                found.append((float(a), float(b), float(ratio)))
    return found


def _middle_error(x: FloatArray, y: FloatArray) -> FloatArray:
    """[intervals, bands] how far a monotone cubic through (x, y[points, bands]) may be wrong at each middle.

    Judged by how far it departs from the chord there. The monotone cubic is flat at every extremum of the
    data and so says nothing about a summit between two points; the modified Akima cubic is not and does.
    """
    middle = 0.5 * (x[1:] + x[:-1])
    chord = 0.5 * (y[1:] + y[:-1])
    monotone = np.abs(PchipInterpolator(x, y)(middle) - chord)
    return np.maximum(monotone, np.abs(Akima1DInterpolator(x, y, method="makima")(middle) - chord))
