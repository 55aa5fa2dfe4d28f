"""Where a peak and an edge lie that were swept over, without assuming their shape."""

from collections.abc import Callable

import numpy as np

from drivers.arrays import FloatArray
from goniometer.errors import CharacterisationError

LEVELS = (0.3, 0.4, 0.5, 0.6, 0.7)
"""Parts of its height at which the middle of a peak is looked for: where its flanks are steep."""

PLATEAU = 3
"""Points at either end of a sweep over an edge that tell how bright it is there."""


def flanks(x: FloatArray, y: FloatArray, level: float) -> tuple[float, float]:
    """Where `y` [points] falls below `level` of its largest value on either side, by linear interpolation.

    `x` [points] need not be sorted. Raises `CharacterisationError` where the sweep ends before that.
    """
    order = np.argsort(x)
    x, y = x[order], y[order] / y.max()
    peak = int(np.argmax(y))
    below = y < level
    left = np.flatnonzero(below[:peak])
    right = np.flatnonzero(below[peak:])
    if not left.size or not right.size:
        raise CharacterisationError(
            f"The sweep from {x[0]:.2f}° to {x[-1]:.2f}° ends before the peak at {x[peak]:.2f}° has fallen off; look "
            f"whether the mirror is mounted, and make the zero readings of both stages right within a few degrees"
        )
    return _between(x, y, int(left[-1]), level), _between(x, y, peak + int(right[0]) - 1, level)


def _between(x: FloatArray, y: FloatArray, i: int, level: float) -> float:
    """Where the line from point `i` to the next takes the value `level`."""
    return float(x[i] + (level - y[i]) / (y[i + 1] - y[i]) * (x[i + 1] - x[i]))


def centre_and_width(x: FloatArray, y: FloatArray) -> FloatArray:
    """[2] the middle of a peak, mean over `LEVELS`, and its full width at half maximum, in the unit of `x`.

    Arguments, and what is raised, as for `flanks`.
    """
    pairs = np.array([flanks(x, y, level) for level in LEVELS])
    left, right = flanks(x, y, 0.5)
    return np.array([pairs.mean(), right - left])


def edge(x: FloatArray, y: FloatArray) -> float:
    """Where a step from dark to light lies, that is the mean of the distribution whose integral the step is.

    `x` [points] ascends from dark to light. A sharp step and a symmetric penumbra of any width and shape give their
    middle: x_n - integral of (y - dark) / (light - dark), by the trapezoid rule.
    """
    dark, light = y[:PLATEAU].mean(), y[-PLATEAU:].mean()
    return float(x[-1] - np.trapezoid((y - dark) / (light - dark), x))


def u_edge(x: FloatArray, u_x: float) -> float:
    """Standard uncertainty of `edge` for a sharp step; less for a penumbra.

    A point at a distance d from the step sees light with the probability Phi(d / u_x). The variance of its sum over
    points a step h apart is h u_x times the integral of Phi (1 - Phi), which is 1 / sqrt(pi). Steps that are too coarse
    for the scatter of positions to blur them add up to h^2 / 12 (first term of the Fourier series over the place of the
    step between two points).
    """
    step = float(np.mean(np.diff(x)))
    coarse = step**2 / 12 * np.exp(-((2 * np.pi * u_x / step) ** 2))
    return float(np.sqrt(step * u_x / np.sqrt(np.pi) + coarse))


def propagated(
    function: Callable[[FloatArray, FloatArray], FloatArray],
    x: FloatArray,
    y: FloatArray,
    u_x: float,
    u_y: FloatArray,
) -> FloatArray:
    """[results] standard uncertainties of `function(x, y)` for independent errors of all `x` and `y` [points].

    By differences over one standard uncertainty to either side (JCGM 100:2008, 5.1.3, note 2).
    """
    variance = np.zeros_like(function(x, y))
    for i in range(len(x)):
        at = np.arange(len(x)) == i
        variance += ((function(x + at * u_x, y) - function(x - at * u_x, y)) / 2) ** 2
        variance += ((function(x, y + at * u_y) - function(x, y - at * u_y)) / 2) ** 2
    return np.asarray(np.sqrt(variance))
