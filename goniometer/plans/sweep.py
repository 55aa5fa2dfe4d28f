"""The pre-scan: what a detector sees that integrates while the arm sweeps, and what a plan makes of it.

Points cannot reveal a lobe that lies between all of them. A sweep sees every direction, each reading being an average
over the interval that the arm passed meanwhile: too coarse to measure a narrow lobe, but no lobe can hide in it that
stands above its noise. Where a reading is not what the interpolation predicts, the plan sends points into the interval.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers.arrays import FloatArray
from goniometer.geometry import Geometry
from goniometer.interpolation.interpolant import Interpolant, predict_values

NODE_DISTANCE = 0.5
"""Degrees between the directions over which a predicted reading is averaged: half the width of the aperture."""

_SIGNIFICANT = 4.0
"""Standard deviations by which a reading must differ from the prediction."""

_CLEAR = 3.0
"""The same of a reading and its neighbours: a needless look is cheaper than a lobe that is missed."""

_ALIKE = 0.02
"""Relative difference between reading and prediction that may come from the motion."""

_EXAMINED = 3
"""Points in an interval that see every lobe in it which is as wide as the aperture, the interval being 2 degrees."""

_ROUGHLY = 0.15
"""Relative difference that is left to the points where an interval has been examined."""


@dataclass(frozen=True, eq=False)
class Swept:
    """One reading of the moving detector."""

    theta_in: float
    """Degrees."""
    start: float
    """Lower end of the interval of theta_out, degrees."""
    stop: float
    """Upper end, degrees."""
    values: FloatArray
    """[bands] cos(theta_in) f averaged over the interval, 1/sr."""
    noise: FloatArray
    """[bands] standard uncertainty of `values`."""
    saturated: bool = False
    """Whether `values` are lower bounds, because the detector had no room for more."""


def unexplained(process: Interpolant, swept: Sequence[Swept], visited: Sequence[Geometry]) -> list[Swept]:
    """The readings that the process does not explain by what it knows, worst first.

    It is looked at less closely where an interval contains enough of the directions `visited`: the lobe in it is known
    then, and how accurately is for the plan to judge.
    """
    counts = [max(int(np.ceil((s.stop - s.start) / NODE_DISTANCE - 1e-9)), 1) for s in swept]
    if not counts:
        return []
    theta_in = np.repeat([s.theta_in for s in swept], counts)
    theta_out = np.concatenate(
        [s.start + (np.arange(n) + 0.5) * (s.stop - s.start) / n for s, n in zip(swept, counts, strict=True)]
    )
    begins = np.concatenate([[0], np.cumsum(counts)[:-1]])
    values, u = predict_values(process, theta_in, theta_out)
    size = np.array(counts)[:, None]
    predicted, doubt = np.add.reduceat(values, begins) / size, np.add.reduceat(u, begins) / size
    read, noise = np.array([s.values for s in swept]), np.array([s.noise for s in swept])
    inside = [sum(s.theta_in == g.theta_in and s.start < g.theta_out < s.stop for g in visited) for s in swept]
    alike = np.where(np.array(inside) >= _EXAMINED, _ROUGHLY, _ALIKE)[:, None]
    allowed = np.sqrt(noise**2 + doubt**2 + (alike / _SIGNIFICANT * np.maximum(read, predicted)) ** 2)
    # The bands see the same lobe: their mean is judged, with the noise that the mean has at the most.
    differs = np.mean(read - predicted, axis=1)
    differs[[s.saturated for s in swept]] = np.maximum(differs[[s.saturated for s in swept]], 0.0)
    score = np.abs(differs) / np.mean(allowed, axis=1)
    return [swept[i] for i in np.argsort(-score) if score[i] > _SIGNIFICANT]


def summits(swept: Sequence[Swept], visited: Sequence[Geometry]) -> list[Swept]:
    """The readings that are brighter than both their neighbours and have not been examined.

    A few points on the flank of a narrow lobe can explain a reading by another lobe than the one that is there. So
    what stands above its neighbours is examined, whether it is explained or not.
    """
    ordered = sorted(swept, key=lambda s: (s.theta_in, s.start))
    found = []
    for left, middle, right in zip(ordered, ordered[1:], ordered[2:], strict=False):
        if not left.theta_in == middle.theta_in == right.theta_in:
            continue
        values = [float(s.values.mean()) for s in (left, middle, right)]
        rise = values[1] - min(values)
        noise = float(np.hypot(middle.noise.mean(), max(left.noise.mean(), right.noise.mean())))
        if values[1] == max(values) and rise > max(_CLEAR * noise, 0.75 * _ALIKE * values[1]):
            inside = sum(middle.theta_in == g.theta_in and middle.start < g.theta_out < middle.stop for g in visited)
            if inside < _EXAMINED:
                found.append(middle)
    return found


def searched(reading: Swept, visited: FloatArray, minimum_step: float) -> Geometry | None:
    """The direction in the interval of a reading that splits the largest gap between `visited`, degrees.

    None where no gap is left that is twice as wide as `minimum_step`.
    """
    marks = np.array([reading.start, *sorted(v for v in visited if reading.start < v < reading.stop), reading.stop])
    gaps = np.diff(marks)
    widest = int(np.argmax(gaps))
    if gaps[widest] < 2 * minimum_step:
        return None
    return Geometry(reading.theta_in, float(round(marks[widest] + gaps[widest] / 2, 3)))
