"""What it does to the parameters that a model does not describe the measurement.

Of such a misfit the fit has absorbed a part, which nobody sees, and left the rest in the residuals. Neither is noise:
neighbours agree, so that it does not average out as a ratio of the residuals to their uncertainty (Birge) would have
it. What can be said is how far the parameters would move if as much as is seen had been absorbed, with signs as bad as
they can be among neighbours. That is taken as a standard uncertainty.
"""

import numpy as np

from drivers.arrays import FloatArray
from goniometer.uncertainty import PARTS, Groups

MISFIT = "model"
"""The part of a standard error that the misfit makes, beside those of the budget."""

PARTS_OF_FITS = (*PARTS, MISFIT)
"""All parts of a standard error, in the order in which they are shown."""


def excess(residual: FloatArray, stated: FloatArray) -> FloatArray:
    """[...] how far residuals go beyond their `stated` standard uncertainty; zero where they do not."""
    return np.asarray(np.sqrt(np.maximum(residual**2 - stated**2, 0.0)))


def moved_by(gain: FloatArray, beyond: FloatArray, groups: Groups | None = None) -> FloatArray:
    """[parameters] by how much errors of the size `beyond` [points, ...] move them where all conspire.

    `gain` [parameters, points, ...] is the derivative of the parameters by the data. With `groups` only the points of
    one group conspire, and groups are independent of each other.
    """
    effect = np.abs(gain) * beyond
    of_point = effect.sum(axis=tuple(range(2, effect.ndim)))
    if groups is None:
        return np.asarray(of_point.sum(axis=1))
    member = (np.arange(groups.max() + 1)[:, None] == groups).astype(float)
    return np.asarray(np.linalg.norm(of_point @ member.T, axis=1))
