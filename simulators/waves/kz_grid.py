"""The harmonics of a phase screen exp(i kz h) on a grid of kz, and how to read between the points of that grid.

As a function of kz a harmonic is band-limited by the range of heights, and so is its square by twice that. Where the
points of a grid lie half as far apart as that asks for, values between them follow by interpolation.
"""

from math import floor, pi

import finufft
import numpy as np
from numpy.typing import NDArray

from drivers.arrays import FloatArray

SingleArray = NDArray[np.float32]

TAPS = 12
"""Points of the grid between which a value is interpolated, by a sinc under a Kaiser window."""

_KAISER = 9.4
"""Its shape: at twice the necessary density, errors of 2e-5 (Kaiser & Schafer 1980)."""

_FLAT_UM = 0.01
"""Range of heights in um below which a map is treated as if it had this range."""

_PRECISION = 1e-5
"""Of d_b against 1; that leaves a BRDF of some 1e-12 1/sr in directions that should be dark."""


def range_of(heights: FloatArray) -> float:
    """Range of `heights`, um, on which the spacing of the grid rests; of a flat map not zero."""
    return max(float(np.ptp(heights)), _FLAT_UM)


def grid_for(kz_min: float, kz_max: float, step: float) -> tuple[int, int]:
    """First point, in steps of `step` 1/um, and number of points of a grid that holds kz between two values, 1/um."""
    first = floor(kz_min / step) - (TAPS // 2 - 1)
    return first, floor(kz_max / step) + TAPS // 2 + 1 - first


def taps(kz: FloatArray, step: float) -> tuple[NDArray[np.intp], FloatArray]:
    """The first of the `TAPS` points [...] around each `kz` [...], 1/um, in steps, and their weights [..., TAPS]."""
    first = np.floor(kz / step).astype(np.intp) - (TAPS // 2 - 1)
    distance = kz[..., None] / step - (first[..., None] + np.arange(TAPS))
    weight = np.sinc(distance) * np.i0(_KAISER * np.sqrt(1 - (distance / (TAPS / 2)) ** 2)) / np.i0(_KAISER)
    return first, np.asarray(weight)


def transformed_columns(
    heights: FloatArray, fade: FloatArray, harmonics: tuple[int, int], grid: tuple[int, int], step: float
) -> NDArray[np.complex64]:
    """[x, harmonics, kz] mean over y of `fade` exp(i (k_b y + kz h)), b from the first to the last of `harmonics`.

    `grid` is the first kz, in steps of `step` 1/um, and their number.
    """
    ny, nx = heights.shape
    low, high = harmonics
    first, count = grid
    angle = 2 * pi * np.arange(ny) / ny
    places = _folded(angle)
    # a transform counts its frequencies from the middle of the grid, so the strengths carry the phase of that middle
    middle_across, middle_up = low + (high - low + 1) // 2, first + count // 2
    phase = np.exp(1j * middle_across * angle) * fade / ny
    plan = finufft.Plan(1, (high - low + 1, count), eps=_PRECISION, isign=1, dtype="complex64", nthreads=1)
    columns = np.empty((nx, high - low + 1, count), dtype=np.complex64)
    for x in range(nx):
        up = step * heights[:, x]
        plan.setpts(places, up.astype(np.float32))
        plan.execute((phase * np.exp(1j * middle_up * up)).astype(np.complex64), out=columns[x])
    return columns


def _folded(angle: FloatArray) -> SingleArray:
    """`angle` in [-pi, pi)."""
    return np.asarray((angle + pi) % (2 * pi) - pi, dtype=np.float32)
