"""Whether the bench can take all that a plan could ever ask for."""

from collections.abc import Sequence
from itertools import pairwise, product

from goniometer.bench.safety import Forbidden, Limits, Range, Standing, safe_path
from goniometer.errors import GeometryError
from goniometer.geometry import Geometry
from goniometer.plans.plan_spec import PlanSpec, segments

_SAME = 1e-6
"""Degrees below which two angles are the same."""


def check_plan(spec: PlanSpec, limits: Limits, forbidden: Sequence[Forbidden]) -> None:
    """Raise `GeometryError` where the bench cannot take all that a plan could ever ask for.

    That is, for each incident angle, the whole range of theta_out outside the blocked sector: refinement may put a
    point anywhere in it, and points of the reference scan lie in it. The arm must be able to stand everywhere there,
    to go from end to end at one incident angle, and from each end to either end at the next.
    """
    for theta_in in spec.theta_in:
        for part in segments(spec, theta_in):
            _check_part(theta_in, part, limits, forbidden)
    ends = [_ends(spec, theta_in) for theta_in in spec.theta_in if segments(spec, theta_in)]
    for here in ends:
        safe_path(here[0], here[-1], forbidden)
    for here, there in pairwise(ends):
        for start, end in product(here, there):
            safe_path(start, end, forbidden)
            safe_path(end, start, forbidden)  # a new sample begins again at the first incident angle


def _ends(spec: PlanSpec, theta_in: float) -> tuple[Standing, Standing]:
    """Stage angles of the lowest and of the highest measurable direction of one incident angle."""
    parts = segments(spec, theta_in)
    lowest, highest = Geometry(theta_in, parts[0][0]), Geometry(theta_in, parts[-1][1])
    return (lowest.sample_angle, lowest.detector_angle), (highest.sample_angle, highest.detector_angle)


def _check_part(theta_in: float, part: Range, limits: Limits, forbidden: Sequence[Forbidden]) -> None:
    """Raise `GeometryError` unless the arm can stand in all of one range of theta_out."""
    (sample_low, sample_high), (detector_low, detector_high) = limits
    sample = Geometry(theta_in, 0.0).sample_angle
    if not sample_low <= sample <= sample_high:
        raise GeometryError(
            f"theta_in = {theta_in:g} deg is not possible: the sample stage would have to stand at {sample:g} deg, "
            f"outside {sample_low:g} to {sample_high:g} deg; leave this incident angle out"
        )
    # the ranges of theta_out that are taken away, each with its reason
    taken = [
        ((-float("inf"), detector_low - theta_in), f"outside {detector_low:g} to {detector_high:g} deg"),
        ((detector_high - theta_in, float("inf")), f"outside {detector_low:g} to {detector_high:g} deg"),
    ]
    taken += [
        ((region.detector[0] - theta_in, region.detector[1] - theta_in), f"in {region} deg")
        for region in forbidden
        if region.sample[0] < sample < region.sample[1]
    ]
    free = [part]
    for (low, high), _ in taken:
        free = [piece for a, b in free for piece in ((a, min(b, low)), (max(a, high), b)) if piece[0] <= piece[1]]
    for (low, high), reason in sorted(taken):
        first, last = max(low, part[0]), min(high, part[1])
        if last - first > _SAME or (part[0] == part[1] and low < part[0] < high):
            possible = ", ".join(f"{a:g} to {b:g} deg" for a, b in free) or "nothing"
            raise GeometryError(
                f"theta_in = {theta_in:g}, theta_out = {first:g} to {last:g} deg is not possible: the detector stage "
                f"would have to stand at {theta_in + first:g} to {theta_in + last:g} deg, {reason}; possible between "
                f"{part[0]:g} and {part[1]:g} deg is {possible}: change outgoing, or leave this incident angle out"
            )
