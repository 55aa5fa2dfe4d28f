"""What a campaign will do, told before anything moves."""

from dataclasses import dataclass
from itertools import pairwise

from api.display import duration
from goniometer.campaign import Campaign
from goniometer.geometry import Geometry
from goniometer.plan import blocked_ranges, next_points, plan_spec, reference_points, uniform_grid_size


@dataclass(frozen=True)
class Leg:
    """One scan as far as it is known beforehand."""

    name: str
    points: int
    """Directions that are certain: all of a reference scan, the coarse sweep of a sample."""
    sample_travel: float
    """Degrees that the sample stage turns between them."""
    detector_travel: float
    """Degrees that the detector stage turns between them."""
    longest_exposure: float
    """Seconds of integration if every point needed as much as the campaign allows; darks, stray light and looks at the
    lamp not counted."""


@dataclass(frozen=True)
class Preview:
    """A whole campaign."""

    campaign: str
    legs: tuple[Leg, ...]
    blocked: dict[float, tuple[float, float]]
    """Incident angle -> range of theta_out in which the detector would block the source, degrees."""
    minimum_step: float
    """Refinement brings no two directions closer than this, degrees."""
    tolerance: float
    """Largest wanted interpolation error of ln(1 + cos(theta_in) f)."""
    uniform_1_degree_points: int
    """How many points a uniform grid of 1 degree would have, per sample."""
    besides: tuple[str, ...]
    """What is measured besides, as sentences."""

    def lines(self) -> list[str]:
        """The preview as sentences."""
        told = [f"Campaign {self.campaign}"]
        for leg in self.legs:
            told.append(
                f"  {leg.name}: {leg.points} points, sample stage {leg.sample_travel:.0f}°, detector stage "
                f"{leg.detector_travel:.0f}° of travel, at most {duration(leg.longest_exposure)} of integration"
            )
        told.append(
            f"Samples are then refined until ln(1 + cos(theta_in) f) is known to {self.tolerance:g} or directions lie "
            f"{self.minimum_step:g}° apart; a uniform 1° grid has {self.uniform_1_degree_points} points a sample."
        )
        told += self.besides
        told.append("Left out because the detector would stand in the beam:")
        told += [f"  theta_in {t:g}°: theta_out {low:g}° to {high:g}°" for t, (low, high) in self.blocked.items()]
        return told


def preview(campaign: Campaign) -> Preview:
    """Preview of `campaign`; touches no device."""
    spec = plan_spec(campaign)
    wanted = campaign.integration
    longest = wanted.maximum * wanted.exposures
    a_point = longest * wanted.scans if wanted.signal_to_noise is None else wanted.time_limit
    reference = _leg(
        "reference panel", reference_points(spec, campaign.reference.step), longest * campaign.reference.scans
    )
    coarse = next_points(spec, [])
    samples = [_leg(f"{s.name}, coarse sweep", coarse, a_point) for s in campaign.samples]
    return Preview(
        campaign.name,
        (reference, *samples),
        blocked_ranges(spec),
        spec.minimum_step,
        spec.tolerance,
        uniform_grid_size(spec),
        _besides(campaign),
    )


def _besides(campaign: Campaign) -> tuple[str, ...]:
    told = []
    if campaign.stray_light:
        told.append("Stray light is measured once per incident angle of each scan.")
    if campaign.monitor is not None:
        told.append(
            f"One direction is looked at again every {duration(campaign.monitor.every)}, to see the lamp drift."
        )
    if campaign.homogeneity is not None:
        points = campaign.homogeneity.points
        told.append(f"After each sample somebody is asked to turn it, and {points} directions are measured again.")
    return tuple(told)


def _leg(name: str, points: list[Geometry], seconds_a_point: float) -> Leg:
    return Leg(
        name,
        len(points),
        sum(abs(b.sample_angle - a.sample_angle) for a, b in pairwise(points)),
        sum(abs(b.detector_angle - a.detector_angle) for a, b in pairwise(points)),
        len(points) * seconds_a_point,
    )
