"""Where to measure next: a pure function of what was asked for and what has been measured.

In mode "dynamic" a coarse pass comes first: at each incident angle the mirror direction, the edges of the blocked
sector, both ends of the range, one direction far from these, and two beside the mirror direction whose distances
differ from one incident angle to the next, because all of them together describe one sample. Then a process that
interpolates between all points (`goniometer.interpolation.interpolant`) says how large the error of reading the BRDF
between them is, and the directions that reduce it most are added, a batch at a time, until it is as small as asked for
or a budget is spent. Nothing moves and nothing is remembered here, so a preview, a dry run and a resume after a power
cut are the same call.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from drivers.arrays import BoolArray, FloatArray
from goniometer.bench.route import ordered
from goniometer.datasets.sector import beside
from goniometer.geometry import Geometry
from goniometer.interpolation.interpolant import Interpolant, Prediction, latent, predict
from goniometer.plans.learning import learnt_process
from goniometer.plans.plan_spec import (
    SAME,
    SMALLEST_BATCH,
    PlanSpec,
    coarse,
    confirming,
    incident,
    segments,
    uniform,
)
from goniometer.plans.refinement import Candidates, Errors, candidates, choose, expected_errors, total
from goniometer.plans.sweep import Swept, searched, summits, unexplained

BATCH = 2
"""Directions of a batch for each incident angle."""

CONFIRMED = 2.0
"""The same of predictions that were made before their points were measured, up to which they confirm the process."""

FEWEST = 5
"""Points that a process needs."""

GOOD_SIGNAL = 20.0
"""Signal over noise of a direction in which two places of a sample are compared."""

Stop = Literal["accuracy", "noise", "step", "grid", "points", "seconds"]
"""Why no more points are wanted: errors as small as asked for; as small as the noise of a point supports; directions as
close as allowed; the uniform grid is complete; the budget of points or of time is spent."""


@dataclass(frozen=True)
class Measured:
    """One point that needs no further visit."""

    geometry: Geometry
    """As planned, not as read back: the plan recognises its own points by it."""
    values: FloatArray
    """[bands] cos(theta_in) f averaged over a few wavelength bands; NaN where the point failed."""
    noise: FloatArray
    """[bands] standard uncertainty of `values`."""
    seconds: float = 0.0
    """Time that it took at the bench, with its move."""


@dataclass(frozen=True)
class Reached:
    """How far a sampling has come. Errors are NaN while too little is measured to tell."""

    points: int
    seconds: float
    """At the bench."""
    error: float
    """Expected root mean square error of ln(1 + cos(theta_in) f) over all directions."""
    largest_error: float
    """Three times the largest standard uncertainty of it at any direction."""
    colour_error: float
    """Expected mean dE00 over all directions."""
    noise_error: float
    """What the noise of a measured point makes of `error`: less cannot be asked for."""
    stopped: Stop | None
    """Why no more points are wanted; None while some are."""


def next_points(
    spec: PlanSpec, measured: Sequence[Measured], swept: Sequence[Swept] = (), pending: Sequence[Geometry] = ()
) -> list[Geometry]:
    """The next batch of directions, in the order in which to visit them; empty when the sampling is done.

    Blocked directions never appear. `measured` is in the order of measuring: the same points in the same order always
    give the same batch. `swept` are the readings of a pre-scan, if there was one. `pending` are directions that were
    planned before and not yet measured: with them the next batch can be planned while the stages still move.
    """
    return _next(spec, list(measured), swept, pending)[0]


def reached(spec: PlanSpec, measured: Sequence[Measured], swept: Sequence[Swept] = ()) -> Reached:
    """How accurate the sampling is by now, and why it ended if it did: `next_points` is empty exactly then."""
    _, stopped, known = _next(spec, list(measured), swept, ())
    return replace(_reached(measured, known or _known(spec, measured)), stopped=stopped)


def first_points(spec: PlanSpec) -> list[Geometry]:
    """What is measured of a sample of which nothing is known, if there is time: the even grid, or the coarse pass."""
    return next_points(replace(spec, most_seconds=None), [])


def expected_total(spec: PlanSpec, measured: Sequence[Measured]) -> int:
    """How many points there will be in the end.

    As many as the process expects to need, which is learnt from the points that there are. Where the coarse pass is
    not complete its missing points are counted, and no refinement.
    """
    if spec.mode == "uniform":
        wanted = len(uniform(spec, spec.step))
    else:
        missing = _missing(spec, measured, ())
        known = _known(spec, measured)
        wanted = len(measured) + len(missing)
        if known is not None and not missing:
            wanted += len(_chosen(spec, known, measured, (), _LOOKAHEAD))
    return min([wanted, *([spec.most_points] if spec.most_points is not None else [])])


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


_LOOKAHEAD = 150
"""Points up to which the length of a sampling is foreseen."""


def interpolation(spec: PlanSpec, measured: Sequence[Measured]) -> Interpolant | None:
    """The process by which the plan judges, conditioned on all points so far; None where they are too few."""
    known = _known(spec, measured)
    return None if known is None else known.process


@dataclass(frozen=True)
class _Known:
    """What the measured points tell."""

    process: Interpolant
    where: Candidates
    predicted: Prediction
    errors: Errors
    goals: FloatArray
    """[2] wanted errors, or what the noise supports where that is more."""
    totals: FloatArray
    """[2] expected errors."""


def _next(
    spec: PlanSpec, measured: list[Measured], swept: Sequence[Swept], pending: Sequence[Geometry]
) -> tuple[list[Geometry], Stop | None, _Known | None]:
    """The next batch, why there is none, and what is known of the sample, if that had to be asked."""
    here = pending[-1] if pending else measured[-1].geometry if measured else None
    room, exhausted = _room(spec, measured, pending)
    missing = _missing(spec, measured, pending)
    known = None if missing or spec.mode == "uniform" else _known(spec, measured)
    if known is None:
        # Where nearly all points failed there is nothing to learn from, and the coarse pass is all there is.
        batch = missing
        stop: Stop | None = None if missing or pending else "grid" if spec.mode == "uniform" else "step"
    else:
        batch, stop = _batch(spec, known, measured, swept, pending)
    if batch and room <= 0:
        batch, stop = [], exhausted
    return ordered(batch, spec.motion, here)[: max(room, 0)], stop, known


def _batch(
    spec: PlanSpec,
    known: _Known,
    measured: list[Measured],
    swept: Sequence[Swept],
    pending: Sequence[Geometry],
) -> tuple[list[Geometry], Stop | None]:
    """The next directions after the coarse pass in any order, without regard to budgets; where there are none, why."""
    hidden = _hidden(spec, known, measured, swept, pending)
    accurate = not hidden and bool(np.all(known.totals <= known.goals))
    if accurate and _confirmed(spec, measured):
        visited = [*(p.geometry for p in measured), *pending]
        more = beside(known.process, spec.theta_in, spec.tolerance, visited)
        batch = [g for g in more if spec.lowest <= g.theta_out <= spec.highest]
    else:
        each = confirming(spec)
        most = max(BATCH * each, SMALLEST_BATCH)
        batch = (hidden + _peaks(spec, known, measured, [*pending, *hidden]))[: 2 * most]
        most = each if accurate else max(most - len(batch), 0)
        batch += _chosen(spec, known, measured, [*pending, *batch], most, most if accurate else 1)
    if batch or pending:
        return list(dict.fromkeys(batch)), None
    if np.all(known.totals <= _wanted(spec)):
        return [], "accuracy"
    useful = (known.errors.sigma > known.errors.noise) & (known.where.share > 0)
    return [], "step" if not accurate and np.any(useful) else "noise"


def _confirmed(spec: PlanSpec, measured: list[Measured]) -> bool:
    """Whether the latest points were where those before them said they would be, twice running.

    As many points each time as there are incident angles, of a scene half as many. What the coarse pass says of itself
    is not believed: a lobe can go through a few points and be wrong between them.
    """
    each = confirming(spec)
    return _foretold(spec, measured, each) and _foretold(spec, measured[:-each], each)


def _foretold(spec: PlanSpec, measured: list[Measured], count: int) -> bool:
    """Whether the last `count` points lie where the others predict them, in a scene as nearly as it asks for."""
    before, latest = measured[:-count], measured[-count:]
    latest = [p for p in latest if np.all(np.isfinite(p.values))]
    known = _known(spec, before)
    if len(before) < len(coarse(spec)) or known is None or not latest:
        return False
    process = known.process
    at = np.array([p.geometry.theta_in for p in latest]), np.array([p.geometry.theta_out for p in latest])
    there = predict(process, *at)
    values, noise = np.array([p.values for p in latest]), np.array([p.noise for p in latest])
    if spec.colour_slope is not None and spec.colour_tolerance is not None and spec.importance is not None:
        # as if all directions were as wrong as these, which were the least known ones
        wrong = np.mean((latent(values, process.shape.offset) - there.latent) ** 2, axis=1)
        seen = np.average(wrong, weights=spec.importance(*at))
        return bool(spec.colour_slope * np.sqrt(seen) <= spec.colour_tolerance)
    read_noise = process.shape.read_noise(*at, values, noise)[:, None]
    u2 = (there.sigma * there.trust)[:, None] ** 2 * np.diag(process.spread) + read_noise**2
    return bool(np.mean((latent(values, process.shape.offset) - there.latent) ** 2 / u2) < CONFIRMED)


def _room(spec: PlanSpec, measured: list[Measured], pending: Sequence[Geometry]) -> tuple[int, Stop]:
    """How many more points the budgets allow for now, and which budget is the tighter one.

    How many fit into a time is told by what the points before took. Others may take longer, so of many only half are
    allowed at once, and a few before any has told.
    """
    count, spent = len(measured), sum(p.seconds for p in measured)
    by_points = math.inf if spec.most_points is None else spec.most_points - count - len(pending)
    by_time = math.inf
    if spec.most_seconds is not None and spent > 0:
        fitting = math.floor((spec.most_seconds - spent) * count / spent) - len(pending)
        by_time = min(fitting, max(SMALLEST_BATCH, fitting // 2))
    elif spec.most_seconds is not None:
        by_time = SMALLEST_BATCH
    room = min(by_points, by_time, 10**6)
    return int(room), "points" if by_points <= by_time else "seconds"


def _wanted(spec: PlanSpec) -> FloatArray:
    return np.array([spec.tolerance, math.inf if spec.colour_tolerance is None else spec.colour_tolerance])


def _known(spec: PlanSpec, measured: Sequence[Measured]) -> _Known | None:
    """The process conditioned on the measured points and its errors; None where they are too few."""
    # a failed point may have another number of bands
    valued = [p for p in measured if math.isfinite(p.values.sum() + p.noise.sum())]
    if len(valued) < FEWEST:
        return None
    theta_in = np.array([p.geometry.theta_in for p in valued])
    theta_out = np.array([p.geometry.theta_out for p in valued])
    values, noise = np.array([p.values for p in valued]), np.array([p.noise for p in valued])
    process = learnt_process(theta_in, theta_out, values, noise, max(len(coarse(spec)), FEWEST), spec.u_angle)
    shape = process.shape
    where = candidates({t: segments(spec, t) for t in incident(spec)}, shape)
    if spec.importance is not None:
        share = where.share * spec.importance(where.theta_in, where.theta_out)
        where = replace(where, share=share / share.sum())
    predicted = predict(process, where.theta_in, where.theta_out)
    errors = expected_errors(process, where, predicted, spec.colour_slope)
    goals = np.maximum(_wanted(spec), errors.noise_floor)
    return _Known(process, where, predicted, errors, goals, total(where, errors, errors.sigma))


def _reached(measured: Sequence[Measured], known: _Known | None) -> Reached:
    seconds = sum(p.seconds for p in measured)
    if known is None:
        return Reached(len(measured), seconds, math.nan, math.nan, math.nan, math.nan, None)
    largest = 3 * float(np.max(known.errors.sigma * known.errors.per_sigma[:, 0]))
    error, colour = (float(v) for v in known.totals)
    return Reached(len(measured), seconds, error, largest, colour, float(known.errors.noise_floor[0]), None)


def _chosen(
    spec: PlanSpec, known: _Known, measured: Sequence[Measured], pending: Sequence[Geometry], most: int, least: int = 1
) -> list[Geometry]:
    """The directions that reduce the errors most, when those of `pending` are measured, too."""
    where, predicted, errors = known.where, known.predicted, known.errors
    count = where.theta_in.size
    if pending:
        where = Candidates(
            np.append(where.theta_in, [g.theta_in for g in pending]),
            np.append(where.theta_out, [g.theta_out for g in pending]),
            np.append(where.share, np.zeros(len(pending))),
        )
        predicted = predict(known.process, where.theta_in, where.theta_out)
        errors = expected_errors(known.process, where, predicted, spec.colour_slope)
    allowed = _apart(where, [*(p.geometry for p in measured), *pending], spec.minimum_step)
    later = range(count, count + len(pending))
    picked = choose(
        known.process, where, predicted, errors, known.goals, allowed, spec.minimum_step, most, least, later
    )
    return [Geometry(float(where.theta_in[i]), float(where.theta_out[i])) for i in picked]


def _apart(where: Candidates, visited: Sequence[Geometry], minimum_step: float) -> BoolArray:
    """[candidates] which lie at least `minimum_step` from every visited direction of their incident angle."""
    allowed = np.ones(where.theta_in.size, dtype=bool)
    visited_in, visited_out = np.array([(g.theta_in, g.theta_out) for g in visited]).reshape(-1, 2).T
    for t in np.unique(where.theta_in):
        there, taken = where.theta_in == t, visited_out[np.abs(visited_in - t) <= SAME]
        if taken.size:
            distance = np.abs(where.theta_out[there, None] - taken).min(axis=1)
            allowed[there] = distance >= minimum_step - SAME
    return allowed


def _hidden(
    spec: PlanSpec, known: _Known, measured: list[Measured], swept: Sequence[Swept], pending: Sequence[Geometry]
) -> list[Geometry]:
    """Directions that search for what the pre-scan saw and the points do not explain."""
    visited = [*(p.geometry for p in measured), *pending]
    found: list[Geometry] = []
    for reading in dict.fromkeys([*unexplained(known.process, swept, visited), *summits(swept, visited)]):
        there = np.array([g.theta_out for g in visited if abs(g.theta_in - reading.theta_in) <= SAME])
        place = searched(reading, there, spec.minimum_step)
        if place is not None and not place.blocked:
            found.append(place)
    return found


def _peaks(spec: PlanSpec, known: _Known, measured: list[Measured], pending: Sequence[Geometry]) -> list[Geometry]:
    """The brightest direction of each incident angle, where nothing near it was measured.

    Between rough facets that shade each other it lies beyond the mirror direction.
    """
    if spec.colour_slope is not None:
        return []  # a scene says itself where it needs to know
    level = known.predicted.latent.mean(axis=1)
    near = max(spec.minimum_step, 0.5 * known.process.shape.lobe.half_width)
    allowed = _apart(known.where, [*(p.geometry for p in measured), *pending], near)
    found = []
    for t in spec.theta_in:
        there = np.flatnonzero(known.where.theta_in == t)
        if there.size and allowed[best := there[np.argmax(level[there])]]:
            found.append(Geometry(t, float(known.where.theta_out[best])))
    return found


def _missing(spec: PlanSpec, measured: Sequence[Measured], pending: Sequence[Geometry]) -> list[Geometry]:
    """Directions of the coarse pass, or of the uniform grid, that nobody has visited."""
    wanted = uniform(spec, spec.step) if spec.mode == "uniform" else coarse(spec)
    visited = {_key(p.geometry) for p in measured} | {_key(g) for g in pending}
    return [g for g in wanted if _key(g) not in visited]


def _key(geometry: Geometry) -> tuple[int, int]:
    return round(geometry.theta_in / SAME), round(geometry.theta_out / SAME)
