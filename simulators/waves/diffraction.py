"""The diffraction integral of a height map under one coherence window: the plain sum, and the same by fast transform.

    I(kx, ky, kz) = integral of w(x, y) exp(i (kx x + ky y + kz h(x, y))) dx dy,    integral of w^2 = 1

In the plane of incidence, ky = 0, this is a two-dimensional Fourier transform from the places (x, h) to the
wave vectors (kx, kz), neither on a grid: a non-uniform transform of type 3 (Dutt & Rokhlin 1993; Barnett et al. 2019).
"""

from dataclasses import dataclass
from math import pi, radians, sqrt

import finufft
import numpy as np
from numpy.typing import NDArray

from drivers.arrays import FloatArray
from goniometer.errors import InputError
from simulators.topographies.heights import HeightField, complete

ComplexArray = NDArray[np.complex128]

PRECISION = 1e-8
"""Usually asked of the fast transform; the dark directions of a patch are some 1000 times weaker than its brightest."""

_AT_ONCE = 4_000_000
"""Points of a height map that are transformed together, which bounds the memory to some hundred megabytes."""


@dataclass(frozen=True)
class Coherence:
    """A Gaussian coherence window w(r) = exp(-r^2 / (2 s^2)) / (sqrt(pi) s); the integral of w^2 is one."""

    s_um: float
    """s at 600 nm, um, or at all wavelengths if it does not grow."""
    grows: bool = True
    """Whether s is proportional to the wavelength, so that all are seen with the same angular resolution, as by a
    detector of one aperture. A window of one size resolves short wavelengths better, and turns mirrors blue."""

    def __post_init__(self) -> None:
        if not self.s_um > 0:
            raise InputError(f"A coherence window has a positive size, but {self.s_um:g} um was given.")

    def size(self, wavelengths: FloatArray) -> FloatArray:
        """s in um at `wavelengths`, nm."""
        return self.s_um * (wavelengths / 600 if self.grows else np.ones_like(wavelengths))


def seen_through(aperture: float) -> Coherence:
    """The window that resolves angles like a round detector aperture of full angle `aperture`, degrees: same variance.

    |I|^2 of a plane has the variance 1 / (2 k^2 s^2) along each axis, a disc of radius R that of R^2 / 4.
    """
    radius = radians(aperture / 2)
    return Coherence(0.6 / (sqrt(2) * pi * radius))


def window(field: HeightField, s_um: float, centre_um: tuple[float, float] | None = None) -> FloatArray:
    """[y, x] w of width `s_um` in 1/um on the points of `field`, cut off at its edge and normalised there.

    `centre_um` is (x, y) from the first point; by default the middle. A periodic field is taken from half a period
    before the centre to half a period after it.
    """
    ny, nx = field.heights_um.shape
    x, y = _middle_out(field)
    if centre_um is not None:
        x = x + (nx - 1) / 2 * field.pitch_um - centre_um[0]
        y = y + (ny - 1) / 2 * field.pitch_um - centre_um[1]
        if field.periodic:
            x, y = _wrapped(x, nx * field.pitch_um), _wrapped(y, ny * field.pitch_um)
    amplitude = np.exp(-(x**2 + y[:, None] ** 2) / (2 * s_um**2))
    return np.asarray(amplitude / (field.pitch_um * sqrt(float((amplitude**2).sum()))))


def direct_integral(
    field: HeightField, amplitude: FloatArray, kx: FloatArray, kz: FloatArray, ky: float = 0.0
) -> ComplexArray:
    """I in um, of the shape of `kx` and `kz` (1/um), summed point by point: the definition, and slow.

    `amplitude` [y, x] is w in 1/um, see `window`; `ky` in 1/um tilts the plane of observation. Places count from the
    middle of the field. Raises `UnfitTopography` where heights are missing.
    """
    heights = complete(field)
    x, y = _middle_out(field)
    terms = amplitude * np.exp(1j * ky * y)[:, None] * field.pitch_um**2
    pairs = zip(kx.ravel(), kz.ravel(), strict=True)
    sums = [np.sum(terms * np.exp(1j * (along * x + up * heights))) for along, up in pairs]
    return np.asarray(sums, dtype=np.complex128).reshape(kx.shape)


def diffraction_integral(
    field: HeightField,
    amplitude: FloatArray,
    kx: FloatArray,
    kz: FloatArray,
    ky: float = 0.0,
    precision: float = PRECISION,
) -> ComplexArray:
    """What `direct_integral` returns, to about `precision` of its largest values, in a small fraction of the time.

    Raises `UnfitTopography` where heights are missing.
    """
    heights = complete(field)
    x, y = _middle_out(field)
    total = np.zeros(kx.size, dtype=np.complex128)
    rows = max(1, _AT_ONCE // x.size)
    for first in range(0, y.size, rows):
        part = slice(first, first + rows)
        strengths = (amplitude[part] * field.pitch_um**2) * np.exp(1j * ky * y[part])[:, None]
        places = np.broadcast_to(x, strengths.shape).ravel()
        # on one thread: a second one gains nothing here, and in a small transform costs many times what it saves
        total += finufft.nufft2d3(
            places, heights[part].ravel(), strengths.ravel(), kx.ravel(), kz.ravel(), eps=precision, isign=1, nthreads=1
        )
    return total.reshape(kx.shape)


def _middle_out(field: HeightField) -> tuple[FloatArray, FloatArray]:
    """Places along x and along y from the middle of the field, um."""
    ny, nx = field.heights_um.shape
    return (np.arange(nx) - (nx - 1) / 2) * field.pitch_um, (np.arange(ny) - (ny - 1) / 2) * field.pitch_um


def _wrapped(place: FloatArray, period: float) -> FloatArray:
    """The nearest of all repetitions of `place`."""
    return place - period * np.round(place / period)
