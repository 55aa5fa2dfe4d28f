"""Where the arm may stand and which way it may go: pure functions of stage angles.

Two things bound the arm: the limits of each stage, and forbidden regions, rectangles in the plane of both stage
angles in which the arm would hit the source or the sample holder. A region is open: the arm may stand at its edge
and slide along it, so a region is given with the margin that it needs. All angles are degrees, as on the stages:
`sample` of the sample stage, `detector` of the arm, from the source axis.

Two stages that move at once do not keep step, so such a move may pass through any point of the rectangle that start
and end span. It is allowed when all of that rectangle is free; else the stages move one after the other.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from itertools import pairwise

from goniometer.errors import ConfigurationError, GeometryError

Range = tuple[float, float]
"""From, to."""
Limits = tuple[Range, Range]
"""Where the sample stage and where the detector stage may stand, ends included."""
Standing = tuple[float, float]
"""Angles of the sample stage and of the detector stage."""

AT_EDGE = 0.1
"""Degrees inside a forbidden region that a stage may read back when it was sent to the region's edge."""


@dataclass(frozen=True)
class Forbidden:
    """A rectangle in which the arm must never be. Raises `ConfigurationError` where it is empty."""

    sample: Range
    """Angles of the sample stage, lower one first."""
    detector: Range
    """Angles of the detector stage, lower one first."""

    def __post_init__(self) -> None:
        for name, (low, high) in (("sample", self.sample), ("detector", self.detector)):
            if not low < high:  # also where one of them is no number
                raise ConfigurationError(
                    f"A forbidden region from {low:g} to {high:g} deg of the {name} stage is empty; "
                    f"give the lower angle first"
                )

    def __str__(self) -> str:
        """In words, e.g. for an error."""
        (a, b), (c, d) = self.sample, self.detector
        return f"the forbidden region with the sample stage at {a:g} to {b:g} and the detector stage at {c:g} to {d:g}"


def check_standing(standing: Standing, limits: Limits, forbidden: Sequence[Forbidden]) -> None:
    """Raise `GeometryError` where the arm must not stand so."""
    sample, detector = standing
    for name, angle, (low, high) in zip(("sample", "detector"), standing, limits, strict=True):
        if not low <= angle <= high:
            raise GeometryError(
                f"sample stage at {sample:g}, detector stage at {detector:g} deg is not possible: "
                f"the {name} stage would have to stand at {angle:g} deg, outside {low:g} to {high:g} deg"
            )
    for region in forbidden:
        if _touches(region, standing, standing):
            raise GeometryError(
                f"sample stage at {sample:g}, detector stage at {detector:g} deg is not possible: "
                f"that lies in {region} deg"
            )


def safe_path(start: Standing, end: Standing, forbidden: Sequence[Forbidden]) -> list[Standing]:
    """Where to stop on the way from `start` to `end`, which is the last of them.

    Both stages at once where that is free, else the detector stage first, else the sample stage first. Raises
    `GeometryError` that names the region in the way where none of these is free.
    """
    begin = _at_edge(start, forbidden)
    ways: tuple[tuple[Standing, ...], ...] = ((), ((start[0], end[1]),), ((end[0], start[1]),))
    in_the_way: list[Forbidden] = []
    for way in ways:
        # what is checked begins at the edge, what is commanded where the stages are
        corners = [begin, *((s if s == end[0] else begin[0], d if d == end[1] else begin[1]) for s, d in way), end]
        hit = [r for a, b in pairwise(corners) for r in forbidden if _touches(r, a, b)]
        if not hit:
            return [*way, end]
        in_the_way += hit
    raise GeometryError(
        f"The arm cannot go from sample stage {start[0]:g}, detector stage {start[1]:g} to {end[0]:g}, {end[1]:g} deg: "
        f"{in_the_way[-1]} deg is in the way; measure both sides of it in campaigns of their own"
    )


def raised(limits: Limits, backlash: Standing) -> Limits:
    """Where stages may be sent that pass a target on the way down by `backlash` degrees, to approach it upwards."""
    (sample_low, sample_high), (detector_low, detector_high) = limits
    return (sample_low + backlash[0], sample_high), (detector_low + backlash[1], detector_high)


def grown(forbidden: Sequence[Forbidden], backlash: Standing) -> tuple[Forbidden, ...]:
    """Where such stages must not be sent, and between which they must not go, so that they stay out of `forbidden`."""
    return tuple(
        Forbidden(
            sample=(region.sample[0], region.sample[1] + backlash[0]),
            detector=(region.detector[0], region.detector[1] + backlash[1]),
        )
        for region in forbidden
    )


def check_sweep(standings: Collection[Standing], forbidden: Sequence[Forbidden]) -> None:
    """Raise `GeometryError` unless all of the rectangle that `standings` span is free.

    For an arm of which nobody knows where in that rectangle it stands.
    """
    corners = [_at_edge(standing, forbidden) for standing in standings]
    low = min(sample for sample, _ in corners), min(detector for _, detector in corners)
    high = max(sample for sample, _ in corners), max(detector for _, detector in corners)
    for region in forbidden:
        if _touches(region, low, high):
            raise GeometryError(
                f"The arm must not go anywhere between sample stage {low[0]:g}, detector stage {low[1]:g} and "
                f"{high[0]:g}, {high[1]:g} deg: {region} deg lies there; turn the stages past it by hand, then run the "
                f"campaign again"
            )


def _touches(region: Forbidden, a: Standing, b: Standing) -> bool:
    """Whether the rectangle that `a` and `b` span has a point inside `region`."""
    return all(
        min(a[axis], b[axis]) < high and max(a[axis], b[axis]) > low
        for axis, (low, high) in enumerate((region.sample, region.detector))
    )


def _at_edge(standing: Standing, forbidden: Sequence[Forbidden]) -> Standing:
    """`standing`, moved onto the edge of a region inside which it lies by no more than `AT_EDGE`."""
    for region in forbidden:
        if not _touches(region, standing, standing):
            continue
        edges = [
            (abs(angle - edge), axis, edge)
            for axis, (angle, ends) in enumerate(zip(standing, (region.sample, region.detector), strict=True))
            for edge in ends
        ]
        depth, axis, edge = min(edges)
        if depth <= AT_EDGE:
            standing = (edge, standing[1]) if axis == 0 else (standing[0], edge)
    return standing
