"""What a campaign will do, told before anything moves."""

import math
from dataclasses import dataclass, replace

from analysis.figures.plan import arm_view, polar_view
from analysis.figures.svg import side_by_side
from api.display import duration, span
from goniometer.bench.route import Motion, travel
from goniometer.campaigns.campaign import Campaign, Integration
from goniometer.campaigns.conditions import Conditions
from goniometer.geometry import Geometry
from goniometer.plans.plan import first_points
from goniometer.plans.plan_spec import (
    ORDINARY,
    PlanSpec,
    blocked_ranges,
    plan_spec,
    reference_points,
    uniform_grid_size,
)
from goniometer.scans.duration import DEAD_TIME, EARLIER, besides, expected, unknown_darks, unknown_exposure
from goniometer.scans.exposure import once
from goniometer.scans.prescan import cost
from goniometer.storage.records import Expected


@dataclass(frozen=True)
class Leg:
    """One scan as far as it is known beforehand."""

    name: str
    points: int
    """Directions that are certain: all of a reference scan, the coarse pass of a sample."""
    most_points: int
    """Directions that there may be in the end."""
    sample_travel: float
    """Degrees that the sample stage turns between those that are certain."""
    detector_travel: float
    """Degrees that the detector stage turns between them, a pre-scan included."""
    time: Expected
    """Until the scan is complete, seconds, with what it waits for."""
    waiting: float
    """Least time of that which it waits before it measures, seconds."""


@dataclass(frozen=True)
class Preview:
    """A whole campaign."""

    campaign: str
    legs: tuple[Leg, ...]
    blocked: dict[float, tuple[float, float]]
    """Incident angle -> range of theta_out in which the detector would block the source, degrees; of those that have
    something of it within the range of the campaign."""
    mode: str
    """Of the resolution, "dynamic" or "uniform"."""
    minimum_step: float
    """Refinement brings no two directions closer than this, degrees."""
    tolerance: float
    """Wanted root mean square error of reading ln(1 + cos(theta_in) f) between the points."""
    colour_tolerance: float | None
    """Wanted mean dE00 of the same."""
    scene: str
    """In which colours are to be known, and nothing else; empty where all directions matter alike."""
    uniform_1_degree_points: int
    """How many points a uniform grid of 1 degree would have, per sample."""
    doubt: str
    """What the time depends on that nobody knows before, as a sentence."""
    besides: tuple[str, ...]
    """What is measured besides, the time of which is in that of the legs but for comparing spots, and what must hold;
    as sentences."""

    def lines(self) -> list[str]:
        """The preview as sentences."""
        told = [f"Campaign {self.campaign}"]
        for leg in self.legs:
            refined = leg.points != leg.most_points
            points = f"{leg.points} to about {leg.most_points}" if refined else f"{leg.points}"
            first = f" for the first {leg.points}" if refined else ""
            waiting = f", {duration(leg.waiting)} of it waiting" if leg.waiting else ""
            told.append(
                f"  {leg.name}: {points} points, sample stage {leg.sample_travel:.0f}°, detector stage "
                f"{leg.detector_travel:.0f}° of travel{first}, about {span(leg.time)}{waiting}"
            )
        whole = sum((leg.time for leg in self.legs), start=Expected(0.0, 0.0, 0.0))
        told.append(f"In all about {span(whole)}. {self.doubt}")
        if self.scene:
            told.append(
                f"Samples are refined until the mean dE00 in the scene {self.scene} is expected to be "
                f"{self.colour_tolerance:g}; directions that it does not ask for are left out."
            )
        elif self.mode == "dynamic":
            wanted = self.colour_tolerance
            colours = "" if wanted is None else f" and colours to a mean dE00 of {wanted:g}"
            told.append(
                f"Samples are refined until ln(1 + cos(theta_in) BRDF) is known everywhere to {self.tolerance:g} (rms)"
                f"{colours}, as far as the noise supports it; a uniform 1° grid has {self.uniform_1_degree_points} "
                f"points a sample."
            )
        told += self.besides
        if self.blocked:
            told.append("Left out because the detector would stand in the beam:")
        told += [f"  theta_in {t:g}°: theta_out {low:g}° to {high:g}°" for t, (low, high) in self.blocked.items()]
        return told


def drawing(campaign: Campaign, motion: Motion = ORDINARY) -> str:
    """The certain directions of a sample as one SVG: around the sample, and as the way of the arm."""
    first = first_points(plan_spec(campaign, motion))
    return side_by_side([polar_view(first, "polar"), arm_view(first, "arm")])


def preview(campaign: Campaign, motion: Motion = ORDINARY, dead_time: float = DEAD_TIME) -> Preview:
    """Preview of `campaign` on a bench that moves like `motion`; touches no device.

    `dead_time` is that of a point, seconds.
    """
    spec = plan_spec(campaign, motion)
    panel = reference_points(spec, campaign.reference.step)
    policy = campaign.integration
    bright = policy.model_copy(update={"scans": campaign.reference.scans, "signal_to_noise": None})
    first = first_points(spec)
    most = len(first) if spec.mode == "uniform" else max(round(EARLIER[1] * len(spec.theta_in)), len(first))
    most = most if spec.most_points is None else min(most, spec.most_points)
    # all samples are alike before anything is known of them
    of_panel = _leg("reference panel", panel, len(panel), campaign, spec, bright, dead_time)
    of_sample = _leg("", first, most, campaign, spec, policy, dead_time, is_sample=True)
    legs = [
        replace(of_panel, name=name.replace("reference", of_panel.name, 1))
        if sample is None
        else _delayed(replace(of_sample, name=name), sample.wait)
        for name, sample in campaign.series
    ]
    conditions = campaign.conditions
    if conditions.lamp_change is not None:
        legs = [_delayed(leg, conditions.lamp_change_within) for leg in legs]
    legs[0] = _delayed(legs[0], conditions.lamp_warm or 0.0)
    return Preview(
        campaign.name,
        tuple(legs),
        {t: (a, b) for t, (a, b) in blocked_ranges(spec).items() if a < spec.highest and b > spec.lowest},
        spec.mode,
        spec.minimum_step,
        campaign.resolution.tolerance,
        spec.colour_tolerance,
        "" if campaign.resolution.scene is None else campaign.resolution.scene.scene,
        uniform_grid_size(spec),
        _doubt(campaign, spec),
        (*_limited(spec), *_besides(campaign)),
    )


def _leg(
    name: str,
    path: list[Geometry],
    most: int,
    campaign: Campaign,
    spec: PlanSpec,
    integration: Integration,
    dead_time: float,
    *,
    is_sample: bool = False,
) -> Leg:
    """A scan of `path` and perhaps more points, which then take as long as those of `path` do.

    That of a sample has a pre-scan and a limit of time where these are asked for.
    """
    way = travel(path, spec.motion)
    alone = expected(path, spec.motion, integration, dead_time=dead_time)
    longest = most / len(path)
    time = Expected(alone.seconds * math.sqrt(longest), alone.low, alone.high * longest)
    look = unknown_exposure(once(campaign.integration))
    darks, longest_time = unknown_darks(campaign), campaign.integration.maximum
    time += besides(campaign, spec.motion, len(spec.theta_in), time, longest_time, look, darks)
    if campaign.monitor is not None:
        time += look  # at the lamp, before the first point
    sample, detector = way.sample, way.detector
    if is_sample and campaign.prescan is not None:
        swept = cost(path, spec, campaign.prescan, spec.motion)
        time += Expected(swept.seconds, swept.seconds, swept.seconds)
        sample, detector = sample + swept.sample, detector + swept.detector
    if is_sample and spec.most_seconds is not None:
        time = Expected(*(min(each, spec.most_seconds) for each in (time.seconds, time.low, time.high)))
    return Leg(name, len(path), most, sample, detector, time, 0.0)


def _delayed(leg: Leg, seconds: float) -> Leg:
    """A scan that waits for `seconds` (more) before it measures."""
    return replace(leg, time=leg.time + Expected(seconds, seconds, seconds), waiting=leg.waiting + seconds)


def _doubt(campaign: Campaign, spec: PlanSpec) -> str:
    """How certain the times of a preview are."""
    exposing = unknown_exposure(campaign.integration)
    many = " and how many directions it needs" if spec.mode == "dynamic" else ""
    return (
        f"That depends on how bright each sample is ({exposing.low:g} s to {exposing.high:g} s of integration a "
        f"point){many}; while it is measured, the time left is told from what its points take."
    )


def _limited(spec: PlanSpec) -> list[str]:
    """What the budgets cut off, as sentences."""
    told = []
    grid = uniform_grid_size(spec, spec.step)
    if spec.mode == "uniform" and spec.most_points is not None and spec.most_points < grid:
        told.append(
            f"A sample gets the first {spec.most_points} of the {grid} points of the grid; it may have no more."
        )
    if spec.most_seconds is not None:
        told.append(f"A sample ends after {duration(spec.most_seconds)}, with the points that it has by then.")
    return told


def _besides(campaign: Campaign) -> tuple[str, ...]:
    told = []
    if campaign.prescan is not None:
        told.append(
            f"Before the first point of an incident angle the arm sweeps over all its directions at "
            f"{campaign.prescan.velocity:.3g}°/s, with a reading every {campaign.prescan.step:g}°."
        )
    if campaign.stray_light:
        told.append("Stray light is measured once per incident angle of each scan.")
    if campaign.monitor is not None:
        told.append(
            f"One direction is looked at again every {duration(campaign.monitor.every)}, to see the lamp drift."
        )
    if campaign.homogeneity is not None:
        points = campaign.homogeneity.points
        told.append(f"After each sample somebody is asked to turn it, and {points} directions are measured again.")
    told += _demanded(campaign.conditions)
    return tuple(told)


def _demanded(conditions: Conditions) -> list[str]:
    """What must hold before every scan, as sentences."""
    demands = []
    if conditions.cooler_stable:
        demands.append("the detector rests at its set point")
    if conditions.lamp_warm is not None:
        demands.append(
            f"the lamp has been on for {duration(conditions.lamp_warm)}, which the first scan waits for where the lamp "
            f"is cold"
        )
    if conditions.lamp_change is not None:
        demands.append(
            f"the lamp changes by less than {100 * conditions.lamp_change:.3g} % in "
            f"{duration(conditions.lamp_change_within)}, which every scan takes at least that long to see"
        )
    if not demands:
        return []
    longest = duration(conditions.patience)
    return [f"No scan begins before {'; '.join(demands)}; one that would have to wait for more than {longest} fails."]
