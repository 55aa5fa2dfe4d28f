"""Diffraction of a coarse height map as a sum of Gaussian elements, as Yan et al. (2018, section 4) have it.

Each point of the map stands for an element of Gaussian amplitude, as wide at half its height as the pitch, which is
flat and tilted by the central difference of its neighbours. Its transform is a Gaussian about its own mirror direction,

    I = sum over j of w_j pitch^2 exp(i (k . r_j + kz h_j)) exp(-sigma^2 |k + kz grad h_j|^2 / 2),   w_j = w(r_j)

and the window w does not grow with the wavelength. Part of `claims`.
"""

from math import log, sqrt

import numba
import numpy as np

from drivers.arrays import FloatArray
from simulators.topographies.heights import HeightField, complete

SIGMA = 1 / (2 * sqrt(2 * log(2)))
"""Of an element over the pitch."""

REACH = 3.0
"""Elements farther than this many s from the middle of a window, or tilted by this many widths of their transform from
the wanted direction, are left out."""


def mean_squares(field: HeightField, s_um: float, apart_um: float, kx: FloatArray, kz: FloatArray) -> FloatArray:
    """[targets] mean |I|^2 in um^2 over windows `apart_um` from each other on a periodic map; `kx`, `kz` in 1/um."""
    heights, size = complete(field), field.heights_um.shape[0]
    tilt_y, tilt_x = ((np.roll(heights, -1, a) - np.roll(heights, 1, a)) / (2 * field.pitch_um) for a in (0, 1))
    half = int(REACH * s_um / field.pitch_um)
    place = np.arange(-half, half + 1) * field.pitch_um
    squared = place**2 + place[:, None] ** 2
    near = squared <= (REACH * s_um) ** 2
    window = np.exp(-squared[near] / (2 * s_um**2)) / (sqrt(np.pi) * s_um) * field.pitch_um**2
    x = np.broadcast_to(place, near.shape)[near]
    middles = np.arange(0, size, apart_um / field.pitch_um)[: int(size * field.pitch_um / apart_um)].astype(int)
    total = np.zeros(kx.size)
    for row in middles:
        for column in middles:
            there = np.ix_(*(np.arange(c - half, c + half + 1) % size for c in (row, column)))
            height, along_x, along_y = (each[there][near] for each in (heights, tilt_x, tilt_y))
            total += _squares(x, window, height, along_x, along_y, kx, kz, SIGMA * field.pitch_um)
    return total / middles.size**2


@numba.njit(fastmath=True)
def _squares(x, weight, height, tilt_x, tilt_y, kx, kz, sigma):
    """[targets] |I|^2."""
    out = np.empty(kx.size)
    for t in range(kx.size):
        re, im = 0.0, 0.0
        for j in range(x.size):
            away = sigma**2 * ((kx[t] + kz[t] * tilt_x[j]) ** 2 + (kz[t] * tilt_y[j]) ** 2)
            if away < REACH**2:
                phase = kx[t] * x[j] + kz[t] * height[j]
                amplitude = weight[j] * np.exp(-away / 2)
                re += amplitude * np.cos(phase)
                im += amplitude * np.sin(phase)
        out[t] = re**2 + im**2
    return out
