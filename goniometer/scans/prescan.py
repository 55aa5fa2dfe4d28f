"""The pre-scan of a campaign: over which directions the arm sweeps, what its readings tell, and what it costs.

Before the first point of an incident angle the arm sweeps over all its directions. The readings go the same way from
counts to cos(theta_in) f as points do, each at the middle of its interval.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import groupby

import numpy as np

from drivers.travel import travel_time
from goniometer.bench.route import Motion, Travel, travel
from goniometer.bench.track import SWEEP_MARGIN
from goniometer.campaigns.campaign import Prescan
from goniometer.errors import CampaignError
from goniometer.geometry import BLOCKED_HALF_WIDTH, Geometry
from goniometer.plans.plan_spec import PlanSpec, segments
from goniometer.plans.sweep import Swept
from goniometer.radiometry.calibration import band_values
from goniometer.radiometry.raw import RawScan, Sweep
from goniometer.radiometry.response import Response


def way(spec: PlanSpec, point: Geometry) -> tuple[float, float]:
    """From where to where theta_out is swept before `point` is the first at its incident angle, degrees.

    Over the whole range, towards the end to which the point is nearer: so the arm is where it is wanted next, and
    a scan that was interrupted sweeps the same way again, wherever the arm stands. Upwards where the arm has backlash,
    for on the way down it is not where it reads.
    """
    parts = segments(spec, point.theta_in)
    low, high = parts[0][0], parts[-1][1]
    if spec.motion.detector.backlash:
        return low, high
    return (low, high) if high - point.theta_out <= point.theta_out - low else (high, low)


def check_prescan(prescan: Prescan, limits: tuple[float, float], motion: Motion) -> None:
    """Raise `CampaignError` where the spectrometer cannot take a reading, or the arm is too slow.

    `limits` are the shortest and longest integration time, seconds.
    """
    low, high = limits
    if not low <= prescan.integration < high:
        raise CampaignError(
            f"A pre-scan of {prescan.integration:g} s a reading is not possible: this spectrometer takes {low:g} s and "
            f"more, but less than {high:g} s; change prescan.integration"
        )
    if prescan.velocity > motion.detector.velocity:
        raise CampaignError(
            f"A pre-scan of {prescan.step:g} deg in {prescan.integration:g} s is not possible: the arm moves at "
            f"{motion.detector.velocity:g} deg/s; make prescan.integration "
            f"{math.ceil(1e3 * prescan.step / motion.detector.velocity) / 1e3:g} s or more"
        )


def swept(raw: RawScan, known: Response, spec: PlanSpec) -> list[Swept]:
    """What the readings of a scan tell the plan, in the order of time; those that touch the blocked sector do not.

    `known` is the response of the instrument. Raises as `goniometer.radiometry.calibration.band_values` does.
    """
    kept = [(_planned(spec, s), s) for s in raw.sweeps if not _is_blocked(s)]
    if not kept:
        return []
    shots = [replace(s.shot, geometry=_middle(s), point=i) for i, (_, s) in enumerate(kept)]
    alone = replace(
        raw,
        planned=tuple(
            Geometry(theta_in, shot.geometry.theta_out) for (theta_in, _), shot in zip(kept, shots, strict=True)
        ),
        read_back=tuple(shot.geometry for shot in shots),
        shots=tuple(shots),
    )
    values, noise = band_values(alone, known)
    saturation = raw.constants.saturation
    return [
        Swept(theta_in, *_interval(s), value, u, saturated=bool(s.shot.counts.max() >= saturation))
        for (theta_in, s), value, u in zip(kept, values, noise, strict=True)
        if np.isfinite(value.sum())
    ]


def cost(path: Sequence[Geometry], spec: PlanSpec, prescan: Prescan, motion: Motion) -> Travel:
    """What the sweeps add to visiting `path` in its order: seconds, and degrees of both stages."""
    with_sweeps: list[Geometry] = []
    known: set[float] = set()
    seconds = 0.0
    for theta_in, group in groupby(path, lambda g: g.theta_in):
        points = list(group)
        if theta_in not in known:
            known.add(theta_in)
            start, stop = way(spec, points[0])
            with_sweeps += [Geometry(theta_in, start), Geometry(theta_in, stop)]
            slow = travel_time(stop - start, prescan.velocity, motion.detector.acceleration)
            seconds += slow - motion.seconds(*with_sweeps[-2:]) + motion.detector.settling + SWEEP_MARGIN
        with_sweeps += points
    bare, whole = travel(path, motion), travel(with_sweeps, motion)
    return Travel(
        whole.seconds - bare.seconds + seconds,
        whole.sample - bare.sample,
        whole.detector - bare.detector,
        whole.sample_moves - bare.sample_moves,
    )


def _interval(reading: Sweep) -> tuple[float, float]:
    """Lower and upper end, degrees."""
    start, stop = sorted((reading.shot.geometry.theta_out, reading.theta_out_end))
    return start, stop


def _middle(reading: Sweep) -> Geometry:
    return Geometry(reading.shot.geometry.theta_in, sum(_interval(reading)) / 2)


def _planned(spec: PlanSpec, reading: Sweep) -> float:
    """The incident angle as planned, degrees, of a reading that holds it as read back."""
    return min(spec.theta_in, key=lambda t: abs(t - reading.shot.geometry.theta_in))


def _is_blocked(reading: Sweep) -> bool:
    """Whether the detector stood in the beam for a part of the reading."""
    low, high = (reading.shot.geometry.theta_in + end for end in _interval(reading))
    return low < BLOCKED_HALF_WIDTH and high > -BLOCKED_HALF_WIDTH
