"""How much a small error in a few wavelength bands shows as a colour difference.

The derivative of CIEDE2000 at zero difference: with L, a, b of CIELAB (CIE 15:2004, section 8.2) and S_L, S_C, G of
Sharma, Wu & Dalal 2005 (Eq. 2-22), dE00^2 = (dL / S_L)^2 + ((1 + G) da / S_C)^2 + (db / S_C)^2. S_H is taken equal to
S_C, which for colours of little chroma, such as a metal's, it nearly is.
"""

import numpy as np

from drivers.arrays import FloatArray

BAND_COLOUR = np.array(
    [[0.1765, 0.1315, 0.9584], [0.4292, 0.6705, 0.1302], [0.3448, 0.1980, 0.0002]]
)  # rows are bands, columns X, Y, Z
"""[bands, 3] X, Y, Z under D65 (CIE 1931, 2 degrees; white has Y = 1) of bands at 450, 550 and 650 nm.

For a spectrum that is linear between the bands and constant beyond them.
"""

_KNEE = 6 / 29


def band_colours(bands: int) -> FloatArray:
    """[bands, 3] weights that turn cos(theta_in) f in so many bands into XYZ.

    The first three are at 450, 550 and 650 nm and the eye does not see the others; fewer than three are grey.
    """
    weights = np.zeros((bands, 3))
    if bands < len(BAND_COLOUR):
        weights[:] = BAND_COLOUR.sum(axis=0) / bands
    else:
        weights[: len(BAND_COLOUR)] = BAND_COLOUR
    return weights


def colour_slopes(values: FloatArray) -> FloatArray:
    """[points, 3, bands] derivative of the three terms of dE00 by `values` [points, bands], cos(theta_in) f in 1/sr."""
    weights = band_colours(values.shape[1])
    white = weights.sum(axis=0)
    t = np.maximum(values @ weights / white, 0.0)
    root = np.cbrt(np.maximum(t, _KNEE**3))
    bright = t > _KNEE**3
    response = np.where(bright, root, t / (3 * _KNEE**2) + 4 / 29)
    slope = np.where(bright, 1 / (3 * root**2), 1 / (3 * _KNEE**2)) / white
    L = 116 * response[:, 1] - 16
    a = 500 * (response[:, 0] - response[:, 1])
    b = 200 * (response[:, 1] - response[:, 2])
    chroma7 = np.hypot(a, b) ** 7
    stretch = 1.5 - 0.5 * np.sqrt(chroma7 / (chroma7 + 25.0**7))
    S_L = 1 + 0.015 * (L - 50) ** 2 / np.sqrt(20 + (L - 50) ** 2)
    S_C = 1 + 0.045 * np.hypot(stretch * a, b)
    by_response = np.zeros((len(values), 3, 3))
    by_response[:, 0, 1] = 116 / S_L
    by_response[:, 1, 0] = 500 * stretch / S_C
    by_response[:, 1, 1] = -500 * stretch / S_C
    by_response[:, 2, 1] = 200 / S_C
    by_response[:, 2, 2] = -200 / S_C
    return np.asarray(np.einsum("pak,pk,bk->pab", by_response, slope, weights))
