"""In-plane geometry of the bench.

`theta_in >= 0` and `theta_out` are signed angles from the surface normal, degrees: the mirror direction is
`theta_out = +theta_in`, the retro direction `theta_out = -theta_in`. The light source is fixed; the sample
stage stands at `theta_in` and the detector arm at `theta_in + theta_out`, both measured from the source
axis, so the detector stands in the beam where `|theta_in + theta_out| < 5`.
"""

from dataclasses import dataclass

from goniometer.errors import GeometryError

BLOCKED_HALF_WIDTH = 5.0
"""Degrees on each side of the source axis in which the detector blocks the source."""

LARGEST_ANGLE = 85.0
"""Degrees from the normal beyond which the measurement spot leaves the sample."""


@dataclass(frozen=True, order=True)
class Geometry:
    """One pair of incident and reflected directions, degrees."""

    theta_in: float
    theta_out: float

    @property
    def sample_angle(self) -> float:
        """Where the sample stage stands, degrees."""
        return self.theta_in

    @property
    def detector_angle(self) -> float:
        """Where the detector arm stands, degrees from the source axis."""
        return self.theta_in + self.theta_out

    @property
    def blocked(self) -> bool:
        """Whether the detector blocks the source."""
        return abs(self.detector_angle) < BLOCKED_HALF_WIDTH


def from_stages(sample_angle: float, detector_angle: float) -> Geometry:
    """Geometry of two stage angles, degrees.

    >>> from_stages(30.0, 50.0)
    Geometry(theta_in=30.0, theta_out=20.0)
    >>> from_stages(30.0, 4.0).blocked
    True
    """
    return Geometry(sample_angle, detector_angle - sample_angle)


def check(geometry: Geometry) -> Geometry:
    """Return `geometry` unchanged, or raise `GeometryError` where the bench cannot go."""
    if not 0 <= geometry.theta_in <= LARGEST_ANGLE:
        raise GeometryError(
            f"theta_in = {geometry.theta_in:g} deg is not possible: it must lie between 0 and {LARGEST_ANGLE:g} deg"
        )
    if not -LARGEST_ANGLE <= geometry.theta_out <= LARGEST_ANGLE:
        raise GeometryError(
            f"theta_out = {geometry.theta_out:g} deg is not possible: it must lie between "
            f"{-LARGEST_ANGLE:g} and {LARGEST_ANGLE:g} deg"
        )
    return geometry
