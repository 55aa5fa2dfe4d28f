"""The mean |I|^2 over all places of the coherence window on a height map, exactly and without speckle.

With d_b = mean of exp(i (k_b . r + kz h(r))) over a periodic map, k_b the harmonics of its size, the window of width s
at all places sees on average (Parseval's theorem)

    S(k, kz) = 4 pi s^2 sum over b of |d_b|^2 exp(-|k - k_b|^2 s^2)

|d_b|^2 as a function of kz is band-limited by the range of heights H, so a grid of spacing pi / (2 H) holds all of it.
"""

from dataclasses import dataclass
from math import ceil, pi

import numpy as np
import scipy
from scipy import fft

from drivers.arrays import FloatArray
from goniometer.errors import InputError
from simulators.errors import UnfitTopography
from simulators.topographies.heights import HeightField, complete
from simulators.waves.kz_grid import TAPS, SingleArray, grid_for, range_of, taps, transformed_columns

_ACROSS = 3.0
"""Harmonics across the plane of incidence up to this many 1/s count; beyond is 2e-5 of a white spectrum."""

_ALONG = 4.0
"""The same along it."""

_EDGE = 3.0
"""Over this many s a map that is not periodic fades at each of its four edges."""

_AT_ONCE = 30_000_000
"""Values that are computed together, of as many harmonics across the plane as that makes: some hundred megabytes."""


@dataclass(frozen=True)
class PowerSpectrum:
    """|d_b|^2 of a height map, from which directions and wavelengths within its reach are cheap."""

    power: SingleArray
    """[harmonics across, harmonics along, kz] |d_b|^2; those across at +b and -b are added; those along are in the
    order of a discrete Fourier transform."""
    across_um: float
    """Size of the map across the plane of incidence, um: its harmonics are 2 pi b / size."""
    along_um: float
    """Size of the map along the plane of incidence, um."""
    kz_step: float
    """Spacing of the kz grid, 1/um."""
    kz_first: int
    """The grid begins at this multiple of its spacing."""
    smallest_window_um: float
    """The smallest s in um for which there are harmonics enough across the plane."""

    def mean_square(self, kx: FloatArray, kz: FloatArray, s_um: float) -> FloatArray:
        """S = mean |I|^2 in um^2 for a window of width `s_um`, in the plane of incidence; `kx`, `kz` [targets] in 1/um.

        Raises `InputError` beyond what the spectrum was computed for.
        """
        first, weight_up = taps(kz, self.kz_step)
        column = first - self.kz_first
        if column.min() < 0 or column.max() + TAPS > self.power.shape[2] or s_um < self.smallest_window_um * (1 - 1e-9):
            low, high = (
                (self.kz_first + end) * self.kz_step for end in (TAPS // 2 - 1, self.power.shape[2] - TAPS // 2)
            )
            raise InputError(
                f"The power spectrum of the topography holds k_z from {low:.3g} to {high:.3g} 1/um and windows from "
                f"{self.smallest_window_um:.3g} um, but {kz.min():.3g} to {kz.max():.3g} 1/um and {s_um:.3g} um were "
                f"asked for; compute it for these directions and wavelengths."
            )
        step_across, step_along = 2 * pi / self.across_um, 2 * pi / self.along_um
        weight_across = np.exp(-((step_across * np.arange(self.power.shape[0]) * s_um) ** 2)).astype(np.float32)
        across = np.tensordot(weight_across, self.power, axes=1)
        reach = ceil(_ALONG / (s_um * step_along))
        harmonic = np.round(kx / step_along).astype(int)[:, None] + np.arange(-reach, reach + 1)
        weight_along = np.exp(-(((kx[:, None] - harmonic * step_along) * s_um) ** 2))
        near = across[(harmonic % across.shape[0])[:, :, None], (column[:, None] + np.arange(TAPS))[:, None, :]]
        seen = np.einsum("th,thk,tk->t", weight_along, near, weight_up, optimize=True)
        # the interpolation swings below zero by its error where the light vanishes
        return np.asarray(4 * pi * s_um**2 * np.maximum(seen, 0))


def power_spectrum(field: HeightField, smallest_window_um: float, kz_min: float, kz_max: float) -> PowerSpectrum:
    """Of `field`, for windows from `smallest_window_um` upward and kz from `kz_min` to `kz_max`, 1/um.

    A field that is not periodic fades out at its edges over three windows each, and the mean is over what is left.
    Raises `UnfitTopography` where heights are missing, or where that leaves nothing.
    """
    heights = complete(field) - 0.5 * (np.max(field.heights_um) + np.min(field.heights_um))
    ny, nx = heights.shape
    step = pi / (2 * range_of(heights))
    first, count = grid_for(kz_min, kz_max, step)
    across_um, along_um = ny * field.pitch_um, nx * field.pitch_um
    harmonics = min((ny - 1) // 2, ceil(_ACROSS / smallest_window_um * across_um / (2 * pi)))
    fade_across, fade_along = (_fade(field, points, smallest_window_um) for points in (ny, nx))
    power = np.zeros((harmonics + 1, nx, count), dtype=np.float32)
    together = max(1, _AT_ONCE // (nx * count))
    for low in range(-harmonics, harmonics + 1, together):
        high = min(low + together - 1, harmonics)
        columns = transformed_columns(heights, fade_across, (low, high), (first, count), step)
        columns *= fade_along[:, None, None].astype(np.float32)
        for index, harmonic in enumerate(range(low, high + 1)):
            along = fft.ifft(columns[:, index, :], axis=0)
            power[abs(harmonic)] += along.real**2 + along.imag**2
    return PowerSpectrum(power, across_um, along_um, step, first, smallest_window_um)


def _fade(field: HeightField, points: int, s_um: float) -> FloatArray:
    """[points] a weight of mean square one that falls to nothing at both ends of a field that is not periodic."""
    if field.periodic:
        return np.ones(points)
    length = points * field.pitch_um
    if 2 * _EDGE * s_um > length:
        raise UnfitTopography(
            f"The topography is {length:.3g} um wide, but a coherence window of {s_um:.3g} um needs at least "
            f"{2 * _EDGE * s_um:.3g} um to be averaged over one that is not periodic; take a smaller window."
        )
    weight = scipy.signal.windows.tukey(points, 2 * _EDGE * s_um / length)
    return np.asarray(weight / np.sqrt((weight**2).mean()))
