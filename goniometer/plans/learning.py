"""When the lobes and scales of a sample are learnt anew while it is being sampled."""

import math
from functools import lru_cache

import numpy as np

from drivers.arrays import FloatArray
from goniometer.interpolation.interpolant import Interpolant, Shape, condition, learn
from goniometer.interpolation.kernel import Scales

GROWTH = 1.25
"""What is known of the sample as a whole is learnt anew when there are so many times more points."""

SURPRISE = 3.0
"""Mean square of normalised residuals, which ought to be 1, from which on points contradict what was learnt."""

MOST_LEARNT = 400
"""Points from which a sample's lobe and scales are learnt; of more points every second, third, ... is used."""


def learnt_process(
    theta_in: FloatArray, theta_out: FloatArray, values: FloatArray, noise: FloatArray, first: int, u_angle: float
) -> Interpolant:
    """The process conditioned on points, with lobes and scales by those that there were when these were last learnt.

    They are learnt from `first` points, anew whenever there are `GROWTH` times more, and at once when a point comes
    as a surprise. Each time they are found from the ones before, so the answer depends on the points in their order
    and on nothing else; it is kept because it takes a while to find. `theta_in`, `theta_out` [points] in degrees,
    `values` and `noise` [points, bands] of cos(theta_in) f in 1/sr, `u_angle` as
    `goniometer.interpolation.interpolant.learn`.
    """
    milestone = min(first, len(theta_in))
    milestones = [milestone]
    while (milestone := math.ceil(milestone * GROWTH)) <= len(theta_in):
        milestones.append(milestone)
    table = np.column_stack([theta_in, theta_out, values, noise])
    shape: Shape | None = None
    for count in milestones:
        shape = _learnt(table, count, u_angle, shape)
    assert shape is not None
    process = condition(shape, theta_in, theta_out, values, noise)
    if milestones[-1] < len(theta_in) and np.mean(np.diag(process.spread)) > SURPRISE:
        process = condition(_learnt(table, len(table), u_angle, shape), theta_in, theta_out, values, noise)
    return process


def _learnt(table: FloatArray, count: int, u_angle: float, before: Shape | None) -> Shape:
    stride = math.ceil(count / MOST_LEARNT)
    return learnt_from(table[:count:stride].tobytes(), table.shape[1], u_angle, before.scales if before else None)


@lru_cache(maxsize=64)
def learnt_from(table: bytes, columns: int, u_angle: float, start: Scales | None) -> Shape:
    """What `table` of `columns` (theta_in, theta_out, values, noise) tells, sought from the scales `start`; kept."""
    points = np.frombuffer(table).reshape(-1, columns)
    bands = (columns - 2) // 2
    return learn(points[:, 0], points[:, 1], points[:, 2 : 2 + bands], points[:, 2 + bands :], u_angle, start)
