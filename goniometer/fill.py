"""What can be said of directions that the bench cannot measure; never taken for a measurement.

Reciprocity, f(i, o) = f(o, i), and for a surface that looks alike from the left and from the right f(-i, -o) = f(i, o),
fill a direction whose partner was measured: one beyond the range of the arm, or a point that failed. They cannot fill
the sector in which the detector blocks the source: both leave |theta_in + theta_out| as it is, so the partner of a
blocked direction is blocked, too. There the process interpolates between both edges and from the other incident angles.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from drivers.arrays import FloatArray
from goniometer.geometry import BLOCKED_HALF_WIDTH, Geometry
from goniometer.interpolant import Interpolant, predict_values
from goniometer.plan import Measured
from goniometer.plan_spec import PlanSpec

SAME_DIRECTION = 0.05
"""Degrees within which a measured direction counts as the partner of another."""


@dataclass(frozen=True)
class Filled:
    """A value that was not measured."""

    geometry: Geometry
    values: FloatArray
    """[bands] cos(theta_in) f, 1/sr."""
    u: FloatArray
    """[bands] standard uncertainty of `values`."""
    by: Literal["reciprocity", "interpolation"]
    """Where it comes from."""
    partner: Geometry | None
    """The measured direction that it was taken from; None where it was interpolated."""


def partner(geometry: Geometry) -> Geometry:
    """The other direction pair with the same BRDF, its incident angle not negative.

    Exchange of both directions, and where that makes the incident angle negative the mirror image of it.
    """
    swapped = Geometry(geometry.theta_out, geometry.theta_in)
    return swapped if swapped.theta_in >= 0 else Geometry(-swapped.theta_in, -swapped.theta_out)


def reciprocal(wanted: Sequence[Geometry], measured: Sequence[Measured]) -> list[Filled]:
    """Values of those `wanted` directions whose partner was measured within `SAME_DIRECTION`.

    The uncertainty is the partner's noise and, beside it, by how much pairs of which both were measured disagree
    beyond their noise: a surface need not be symmetric, nor a bench well adjusted.
    """
    valued = [p for p in measured if np.all(np.isfinite(p.values))]
    disagreement = _disagreement(valued)
    found = []
    for geometry in wanted:
        source = _nearest(partner(geometry), valued)
        if source is None:
            continue
        ratio = np.cos(np.radians(geometry.theta_in)) / np.cos(np.radians(source.geometry.theta_in))
        values = source.values * ratio
        u = np.hypot(source.noise * ratio, disagreement * np.abs(values))
        found.append(Filled(geometry, values, u, "reciprocity", source.geometry))
    return found


def blocked_directions(spec: PlanSpec, step: float = 1.0) -> list[Geometry]:
    """Directions in the blocked sectors of all incident angles, at most `step` degrees apart, edges left out."""
    count = int(np.ceil(2 * BLOCKED_HALF_WIDTH / step)) - 1
    inside = -BLOCKED_HALF_WIDTH + 2 * BLOCKED_HALF_WIDTH * (np.arange(count) + 1) / (count + 1)
    grid = [Geometry(t, float(a - t)) for t in spec.theta_in for a in inside]
    return [g for g in grid if spec.lowest <= g.theta_out <= spec.highest]


def interpolated(wanted: Sequence[Geometry], process: Interpolant) -> list[Filled]:
    """Values of `wanted` directions as the process reads them between the measured ones."""
    if not wanted:
        return []
    theta_in, theta_out = np.array([g.theta_in for g in wanted]), np.array([g.theta_out for g in wanted])
    values, u = predict_values(process, theta_in, theta_out)
    return [Filled(g, v, s, "interpolation", None) for g, v, s in zip(wanted, values, u, strict=True)]


def _nearest(geometry: Geometry, measured: Sequence[Measured]) -> Measured | None:
    near = [
        p
        for p in measured
        if abs(p.geometry.theta_in - geometry.theta_in) <= SAME_DIRECTION
        and abs(p.geometry.theta_out - geometry.theta_out) <= SAME_DIRECTION
    ]
    return near[0] if near else None


def _disagreement(measured: Sequence[Measured]) -> float:
    """Relative standard deviation of f between partners, beyond their noise; 0 where there are no pairs."""
    squares = []
    for point in measured:
        other = _nearest(partner(point.geometry), measured)
        if other is None or other.geometry <= point.geometry:
            continue
        f, u = (values / np.cos(np.radians(point.geometry.theta_in)) for values in (point.values, point.noise))
        g, v = (values / np.cos(np.radians(other.geometry.theta_in)) for values in (other.values, other.noise))
        middle = np.maximum(np.abs(f + g) / 2, 1e-12)
        squares.append(np.mean(((f - g) ** 2 - u**2 - v**2) / middle**2))
    return float(np.sqrt(max(np.mean(squares), 0.0))) if squares else 0.0
