"""The noise of spectra that come without a stated uncertainty, such as imported ones."""

import numpy as np

from drivers.arrays import FloatArray

SMALLEST_RELATIVE_NOISE = 1e-6
"""Noise below this share of the signal is rounding, not measurement."""


def noise_between_neighbours(brdf: FloatArray) -> FloatArray:
    """[points, wavelengths] standard uncertainty of smooth spectra [points, wavelengths], from their own scatter.

    The second difference of a smooth spectrum is nearly all noise, with 6 times its variance; its median absolute
    value over the wavelengths is scaled to a standard deviation (1.4826, for a Gaussian) and one value is given to the
    whole spectrum. Errors that neighbouring wavelengths share stay unseen. NaN where a spectrum has no
    three valid neighbours.
    """
    differences = np.abs(brdf[:, :-2] - 2 * brdf[:, 1:-1] + brdf[:, 2:])
    known = np.isfinite(differences).any(axis=1)
    noise = np.full(brdf.shape[0], np.nan)
    noise[known] = 1.4826 / np.sqrt(6) * np.nanmedian(differences[known], axis=1)
    noise[known] = np.maximum(noise[known], SMALLEST_RELATIVE_NOISE * np.nanmedian(np.abs(brdf[known]), axis=1))
    return np.broadcast_to(noise[:, None], brdf.shape).copy()
