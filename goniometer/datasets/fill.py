"""What can be said of directions that were not measured; never taken for a measurement.

Reciprocity, f(i, o) = f(o, i), and for a surface that looks alike from the left and from the right f(-i, -o) = f(i, o),
fill a direction whose partner was measured: one beyond the range of the campaign, or one whose point has no value. They
cannot fill the sector in which the detector blocks the source: both leave |theta_in + theta_out| as it is, so the
partner of a blocked direction is blocked, too. There the process of `goniometer.datasets.between` reads the BRDF
between both edges, with what the other incident angles say of the sample.

Nobody looks into the sector, so its uncertainty rests on an assumption: nothing in it is steeper than at its edges.
What rises towards the sector beyond what the lobes explain is allowed to rise on to the middle as steeply, or not at
all. A peak that is narrower than the sector, and has no foot outside of it, is not excluded by anything.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from drivers.arrays import BoolArray, FloatArray
from goniometer.datasets.between import interpolate
from goniometer.datasets.dataset import Dataset
from goniometer.datasets.reciprocity import Row, reciprocity, reverse, rows_of
from goniometer.datasets.sector import edges, is_hidden, rise, unseen
from goniometer.geometry import BLOCKED_HALF_WIDTH, LARGEST_ANGLE
from goniometer.uncertainty import variance_of_readings

TELLS = 0.3
"""Relative standard uncertainty, as the median over wavelengths, above which a filled spectrum says nothing."""

_GAP = 1.6
"""How much larger than the process believes its errors in the sector may be: it judges itself by predicting each point
from its neighbours, but there no neighbour is near (`python -m tests.benchmarks.sector` shows both)."""

_STAGES = 0.2
"""Degrees by which a point may stand beside its planned direction, and a sector's edge be off by that."""

By = Literal["reciprocity", "interpolation", "nothing"]


@dataclass(frozen=True)
class Filled:
    """Spectra of directions that were not measured."""

    theta_in: FloatArray
    """[directions] degrees."""
    theta_out: FloatArray
    """[directions] degrees."""
    wavelengths: FloatArray
    """[wavelengths] nm, those of the dataset."""
    brdf: FloatArray
    """[directions, wavelengths] 1/sr; NaN where nothing fills it."""
    u: FloatArray
    """[directions, wavelengths] combined standard uncertainty, 1/sr: of the measured points that it comes from, of
    interpolating between them, and by how much measured pairs break reciprocity."""
    by: tuple[By, ...]
    """[directions] where it comes from; "nothing" where neither will do."""
    points: tuple[tuple[int, ...], ...]
    """[directions] numbers of the dataset's points that it comes from; where the process interpolates, those that
    have at least half the weight of the weightiest."""

    @property
    def tells(self) -> BoolArray:
        """[directions] whether it is known well enough to say anything: to `TELLS`."""
        return _relative(self.brdf, self.u) <= TELLS


def unmeasured(dataset: Dataset, step: float = 1.0) -> tuple[FloatArray, FloatArray]:
    """theta_in and theta_out [directions], degrees, of what lacks in a dataset and `fill` may say something about.

    Of every incident angle whose blocked sector nobody saw, that without its edges, at most `step` degrees apart; the
    points without any value; and beyond the outermost usable points the directions whose reverse has a measured
    incident angle.
    """
    rows = _rows(dataset)
    incident = np.array([row.theta_in for row in rows])
    count = int(np.ceil(2 * BLOCKED_HALF_WIDTH / step)) - 1
    inside = BLOCKED_HALF_WIDTH * (2 * (np.arange(count) + 1) / (count + 1) - 1)
    valued = np.isfinite(dataset.brdf).any(axis=1)
    found = [np.column_stack([dataset.theta_in, dataset.theta_out])[~valued]]
    for angle, points in rows:
        measured = dataset.theta_out[points]
        both = np.unique(np.concatenate([incident, -incident]))
        beyond = both[(both < measured.min() - 1) | (both > measured.max() + 1)]
        beyond = beyond[np.abs(beyond + angle) >= BLOCKED_HALF_WIDTH]
        angles = np.concatenate([inside - angle if is_hidden(dataset, angle) else inside[:0], beyond])
        angles = angles[np.abs(angles) <= LARGEST_ANGLE]
        found.append(np.column_stack([np.full(angles.size, angle), angles]))
    theta_in, theta_out = np.concatenate(found).T
    return theta_in, theta_out


def fill(dataset: Dataset, theta_in: FloatArray, theta_out: FloatArray) -> Filled:
    """Spectra of directions [directions], degrees, as if they had not been measured.

    By reciprocity or by interpolation, whichever is less uncertain there. Beyond the measured range of theta_in or
    theta_out only reciprocity fills, for an extrapolation does not know what it does not know. Raises
    `CalibrationError` where the dataset has too few usable points to interpolate between
    (`goniometer.datasets.between.FEWEST`).
    """
    count = theta_in.size
    incident = np.unique(theta_in)
    beside = edges(incident)
    read = interpolate(dataset, np.append(theta_in, beside[0]), np.append(theta_out, beside[1]))
    level = np.nanmedian(read.brdf[count:], axis=1) * np.cos(np.radians(beside[0]))
    steepness = rise(read.shape, *beside, level)[np.searchsorted(incident, theta_in)]
    hidden = unseen(steepness, theta_in, theta_out)[:, None]
    gap = np.where(np.abs(theta_in + theta_out) < BLOCKED_HALF_WIDTH, _GAP**2 - 1, 0.0)[:, None]
    between = _between_points(dataset, theta_in, theta_out)[:, None]
    brdf = np.where(between, read.brdf[:count], np.nan)
    variance = read.u_total[:count] ** 2 + gap * read.u[:count] ** 2 + (read.brdf[:count] * hidden) ** 2
    u = np.where(between, np.sqrt(variance), np.nan)
    by: list[By] = ["interpolation" if told else "nothing" for told in between[:, 0]]
    weights = np.abs(read.weights[:, :count] * between).max(axis=0)
    points = [tuple(np.flatnonzero((w > 0) & (w >= 0.5 * w.max())).tolist()) for w in weights]
    mirrored, u_mirrored, reverse_points = _by_reciprocity(dataset, theta_in, theta_out)
    for i in np.flatnonzero(_relative(mirrored, u_mirrored) < _relative(brdf, u)).tolist():
        brdf[i], u[i], by[i], points[i] = mirrored[i], u_mirrored[i], "reciprocity", reverse_points[i]
    return Filled(theta_in, theta_out, dataset.wavelengths, brdf, u, tuple(by), tuple(points))


def _rows(dataset: Dataset) -> list[Row]:
    """All incident angles with usable points, ascending."""
    return [r for r in rows_of(dataset, dataset.usable & np.isfinite(dataset.brdf).any(axis=1)) if r.points.size]


def _between_points(dataset: Dataset, theta_in: FloatArray, theta_out: FloatArray) -> BoolArray:
    """[directions] whether the incident angles beside each direction were measured on both sides of it.

    A blocked direction needs both edges of its sector, as far as these are within `LARGEST_ANGLE`.
    """
    rows = _rows(dataset)
    incident = np.array([row.theta_in for row in rows])
    lowest = np.array([dataset.theta_out[row.points].min() for row in rows])
    highest = np.array([dataset.theta_out[row.points].max() for row in rows])
    blocked = np.abs(theta_in + theta_out) < BLOCKED_HALF_WIDTH
    low = np.where(blocked, np.maximum(-theta_in - BLOCKED_HALF_WIDTH, -LARGEST_ANGLE), theta_out)
    high = np.where(blocked, np.minimum(-theta_in + BLOCKED_HALF_WIDTH, LARGEST_ANGLE), theta_out)
    found = (theta_in >= incident[0] - _STAGES) & (theta_in <= incident[-1] + _STAGES)
    before = np.searchsorted(incident, theta_in + _STAGES) - 1
    after = np.searchsorted(incident, theta_in - _STAGES)
    for row in (np.clip(before, 0, None), np.clip(after, None, incident.size - 1)):
        found &= (lowest[row] <= low + _STAGES) & (highest[row] >= high - _STAGES)
    return np.asarray(found)


def _by_reciprocity(
    dataset: Dataset, theta_in: FloatArray, theta_out: FloatArray
) -> tuple[FloatArray, FloatArray, tuple[tuple[int, ...], ...]]:
    """BRDF and standard uncertainty [directions, wavelengths], and from which points; NaN where no reverse is known.

    How far measured pairs differ beyond their uncertainty, if there are any, is the uncertainty of the law itself: a
    surface need not look alike from both sides, nor a bench be well adjusted.
    """
    known = dataset.usable[:, None] & (dataset.brdf > 0)
    cosines = (np.cos(np.radians(dataset.theta_in)) * np.cos(np.radians(dataset.theta_out)))[:, None]
    logarithm = np.log(np.where(known, dataset.brdf * cosines, 1.0))
    bright = np.mean(known, axis=1) > 0.5
    rows, typical = rows_of(dataset, bright), np.sum(logarithm, axis=1) / np.maximum(known.sum(axis=1), 1)
    weights, u_between = np.zeros((theta_in.size, dataset.theta_in.size)), np.full(theta_in.size, np.nan)
    points: list[tuple[int, ...]] = [()] * theta_in.size
    for i in np.flatnonzero(np.abs(theta_in + theta_out) >= BLOCKED_HALF_WIDTH).tolist():
        told = reverse(dataset, rows, typical, float(theta_in[i]), float(theta_out[i]))
        if told is not None:
            weights[i, told.points], u_between[i], points[i] = told.weights, told.u, tuple(told.points.tolist())
    target = (np.cos(np.radians(theta_in)) * np.cos(np.radians(theta_out)))[:, None]
    brdf = np.where((weights != 0) @ ~known, np.nan, np.exp(weights @ logarithm) / target)
    pairs = reciprocity(dataset)
    broken = max(float(np.mean(pairs.difference**2 - pairs.u**2)), 0.0) if pairs.u.size else 0.0
    per_brdf = np.where(known, 1 / np.where(known, dataset.brdf, 1.0), 0.0)
    variance = variance_of_readings(weights, per_brdf, dataset.sources) + u_between[:, None] ** 2 + broken
    return brdf, brdf * np.sqrt(variance), tuple(points)


def _relative(brdf: FloatArray, u: FloatArray) -> FloatArray:
    """[...] relative standard uncertainty of spectra [..., wavelengths], as the median over wavelengths."""
    known = np.isfinite(brdf * u) & (brdf > 0)
    return np.asarray(np.nanmedian(np.where(known, u / np.where(known, brdf, 1.0), np.inf), axis=-1))
