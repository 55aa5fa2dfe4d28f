"""The noise of a spectrum, from how its neighbouring wavelengths scatter."""

import numpy as np
import scipy

from drivers.arrays import FloatArray

FEWEST_WAVELENGTHS = 8
"""Wavelengths below which scatter cannot be told from shape."""

WINDOW = 21
"""Wavelengths over which the scatter is averaged."""


def scatter(wavelengths: FloatArray, values: FloatArray) -> FloatArray:
    """[points, wavelengths] standard deviation of each value's own error; NaN where a point has too few values.

    Every value is compared with the parabola through one neighbour before it and two after it, which leaves of a smooth
    spectrum its third derivative alone; the mean square over `WINDOW` wavelengths, divided by what the four errors of
    one comparison add up to, is the variance. Errors that neighbours share do not show, and features as sharp as the
    step between wavelengths count as noise. `wavelengths` ascending; NaN among `values` is passed over.
    """
    found = np.full(values.shape, np.nan)
    patterns, which = np.unique(np.isfinite(values), axis=0, return_inverse=True)
    for i, known in enumerate(patterns):
        if np.count_nonzero(known) < FEWEST_WAVELENGTHS:
            continue
        rows = np.flatnonzero(which.ravel() == i)
        found[np.ix_(rows, np.flatnonzero(known))] = _of_complete(wavelengths[known], values[np.ix_(rows, known)])
    return found


def _of_complete(x: FloatArray, y: FloatArray) -> FloatArray:
    a, b, c, here = x[:-3], x[2:-1], x[3:], x[1:-2]
    weights = np.stack(
        [
            (here - b) * (here - c) / ((a - b) * (a - c)),
            (here - a) * (here - c) / ((b - a) * (b - c)),
            (here - a) * (here - b) / ((c - a) * (c - b)),
        ]
    )
    parabola = weights[0] * y[:, :-3] + weights[1] * y[:, 2:-1] + weights[2] * y[:, 3:]
    square = (y[:, 1:-2] - parabola) ** 2 / (1 + (weights**2).sum(axis=0))
    mean = scipy.ndimage.uniform_filter1d(square, min(WINDOW, square.shape[1]), axis=1, mode="reflect")
    # the running sums of the filter may round a zero to less; the ends have no comparison of their own
    return np.asarray(np.pad(np.sqrt(np.maximum(mean, 0.0)), ((0, 0), (1, 2)), mode="edge"))
