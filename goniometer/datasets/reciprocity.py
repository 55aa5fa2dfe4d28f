"""Helmholtz reciprocity of a dataset: light that goes a way back is reflected as much as on the way there.

In plane the reverse of (theta_in, theta_out) = (a, b) is (b, a) where the light goes on forward, b > 0, and
(-b, -a) where it comes back, b < 0. The forward case exchanges the sides of the sample, which must look the same when
turned by 180 degrees about its normal.

The reverse of a measured direction is hardly ever measured itself, but close to many there is a measured incident
angle. There f is interpolated along theta_out. What is interpolated is ln(f cos(theta_in) cos(theta_out)), at the
same angle theta_h = (theta_out - theta_in) / 2 of the half vector as the first direction has: of a microfacet surface
that depends on theta_h steeply, and on a few tenths of a degree of (theta_out + theta_in) / 2 hardly at all.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.arrays import FloatArray
from goniometer.datasets.angular import SAME_PLANNED_INCIDENCE, incidence_groups
from goniometer.datasets.averages import averages, middle
from goniometer.datasets.dataset import Dataset
from goniometer.uncertainty import combined, variance

NEAR = 0.3
"""Degrees within which an incident angle must have been measured."""

_BEYOND = 0.05
"""Degrees that the reverse direction may lie beyond the outermost measured one: the stages' error."""

_SAME = 1e-3
"""Degrees within which two values of theta_out are one direction, measured twice."""

_LEAST_SIGNAL = 5.0
"""Signal over standard uncertainty below which a value says nothing about a ratio."""


class Reciprocity(NamedTuple):
    """Measured pairs of a direction and its reverse, of the mean over the middle half of the wavelengths."""

    theta_in: FloatArray
    """[pairs] of the direction that was measured itself, degrees."""
    theta_out: FloatArray
    """[pairs] of the same, degrees."""
    difference: FloatArray
    """[pairs] ln f there minus ln f at the reverse direction: about the relative difference."""
    u: FloatArray
    """[pairs] standard uncertainty of `difference`, from all sources with what they share, and of interpolating."""

    @property
    def z(self) -> FloatArray:
        """[pairs] difference over its standard uncertainty."""
        return self.difference / self.u


class Row(NamedTuple):
    """The points of one incident angle."""

    theta_in: float
    """Their mean, degrees."""
    points: NDArray[np.intp]
    """Numbers in the dataset, those that are good for a ratio."""


class Reverse(NamedTuple):
    """What was measured of the reverse of a direction: ln(f cos(theta_in) cos(theta_out)) as a weighted sum."""

    theta_in: float
    """Incident angle of the reverse direction, degrees."""
    points: NDArray[np.intp]
    """[nodes] numbers in the dataset."""
    weights: FloatArray
    """[nodes]"""
    u: float
    """Standard uncertainty by interpolation, of the logarithm."""


class _Pair(NamedTuple):
    point: int
    reverse: Reverse
    difference: float


def reciprocity(dataset: Dataset) -> Reciprocity:
    """All pairs of a dataset, one for every two incident angles and side; there may be none.

    Values below five of their standard uncertainties are left out.
    """
    mean = averages(dataset, middle(dataset.wavelengths))
    f = mean.values[:, 0]
    u = combined(mean.sources, mean.values.shape)[:, 0]
    clear = np.isfinite(f) & (f > _LEAST_SIGNAL * u)
    cosines = np.cos(np.radians(dataset.theta_in)) * np.cos(np.radians(dataset.theta_out))
    logarithm = np.log(np.where(clear, f * cosines, 1.0))
    pairs = list(_pairs(dataset, logarithm, clear).values())
    gain = np.zeros((len(pairs), f.size, 1))
    for row, pair in zip(gain, pairs, strict=True):
        row[pair.reverse.points, 0] = -pair.reverse.weights / f[pair.reverse.points]
        row[pair.point, 0] = 1 / f[pair.point]  # another incident angle than that of the nodes
    by_interpolation = np.array([pair.reverse.u for pair in pairs])
    points = np.array([pair.point for pair in pairs], dtype=np.intp)
    return Reciprocity(
        dataset.theta_in[points],
        dataset.theta_out[points],
        np.array([pair.difference for pair in pairs]),
        np.sqrt(variance(gain, mean.sources) + by_interpolation**2),
    )


def rows_of(dataset: Dataset, good: NDArray[np.bool_]) -> list[Row]:
    """Every incident angle with those of its points that are `good` [points]."""
    groups = incidence_groups(dataset.theta_in, SAME_PLANNED_INCIDENCE)
    members = [groups == g for g in range(int(groups.max(initial=-1)) + 1)]
    return [Row(float(dataset.theta_in[mine].mean()), np.flatnonzero(mine & good)) for mine in members]


def reverse(
    dataset: Dataset, rows: list[Row], logarithm: FloatArray, theta_in: float, theta_out: float
) -> Reverse | None:
    """The reverse of a direction, degrees, from points that were measured of another incident angle; None without any.

    `logarithm` [points] is ln(f cos(theta_in) cos(theta_out)), by which the interpolation is judged.
    """
    other = min(rows, key=lambda row: abs(row.theta_in - abs(theta_out)))
    if abs(other.theta_in - abs(theta_out)) > NEAR or abs(other.theta_in - theta_in) <= SAME_PLANNED_INCIDENCE:
        return None  # the mirror direction and the way back to the lamp are their own reverse
    # theta_h of the reverse direction is that of this one with its sign changed forward, and the same backward
    target = other.theta_in + (theta_in - theta_out if theta_out > 0 else theta_out - theta_in)
    found = _through_neighbours(dataset.theta_out[other.points], logarithm[other.points], target)
    if found is None:
        return None
    chosen, weights, u = found
    # what (theta_in + theta_out) / 2 does: shadowing makes f cos cos fall at most as a cosine does
    aside = np.radians(abs(other.theta_in - abs(theta_out)))
    u = float(np.hypot(u, aside * np.tan(np.radians(max(theta_in, abs(theta_out)))) / np.sqrt(3)))
    return Reverse(other.theta_in, other.points[chosen], weights, u)


def _pairs(dataset: Dataset, logarithm: FloatArray, clear: NDArray[np.bool_]) -> dict[tuple[float, float, bool], _Pair]:
    """The best pair for each two incident angles and side: the one that needs least interpolation."""
    rows = rows_of(dataset, clear)
    found: dict[tuple[float, float, bool], _Pair] = {}
    for row in rows:
        for point in row.points.tolist():
            theta_out = float(dataset.theta_out[point])
            told = reverse(dataset, rows, logarithm, float(dataset.theta_in[point]), theta_out)
            if told is None:
                continue
            pair = _Pair(point, told, float(logarithm[point] - told.weights @ logarithm[told.points]))
            key = (min(row.theta_in, told.theta_in), max(row.theta_in, told.theta_in), theta_out > 0)
            if key not in found or told.u < found[key].reverse.u:
                found[key] = pair
    return found


def _through_neighbours(x: FloatArray, y: FloatArray, at: float) -> tuple[NDArray[np.intp], FloatArray, float] | None:
    """Nodes and weights of Lagrange's polynomial through up to four neighbours, and its standard uncertainty.

    The uncertainty is half of what the parabolas through the first three and the last three nodes differ by there;
    at an end, where there are only three nodes, what parabola and straight line differ by. None beyond the nodes, or
    where there are fewer than three.
    """
    order = np.argsort(x, kind="stable")
    order = order[np.diff(x[order], prepend=-np.inf) > _SAME]  # a direction that was measured twice
    x = x[order]
    if x.size < 3 or not x[0] - _BEYOND <= at <= x[-1] + _BEYOND:
        return None
    right = int(np.clip(np.searchsorted(x, at), 1, x.size - 1))
    first, last = max(right - 2, 0), min(right + 2, x.size)
    chosen = order[first:last]
    nodes, values = x[first:last], y[chosen]
    weights = _lagrange(nodes, at)
    if nodes.size == 4:
        parts = float(_lagrange(nodes[:3], at) @ values[:3]), float(_lagrange(nodes[1:], at) @ values[1:])
        return chosen, weights, 0.5 * abs(parts[0] - parts[1])
    near = slice(right - 1 - first, right + 1 - first)
    return chosen, weights, abs(float(weights @ values - _lagrange(nodes[near], at) @ values[near]))


def _lagrange(nodes: FloatArray, at: float) -> FloatArray:
    """[nodes] weights of Lagrange's polynomial at `at`."""
    weights = np.ones(nodes.size)
    for i, node in enumerate(nodes):
        others = np.delete(nodes, i)
        weights[i] = np.prod((at - others) / (node - others))
    return weights
