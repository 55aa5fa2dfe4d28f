"""The reflectance models of Clausen et al. 2022 as plain functions.

One shape convention: directions have any shape [...], wavelengths are [wavelengths], and a spectral value is
[..., wavelengths]. Wavelengths are nanometres, slopes 1/um, BRDF 1/sr. Equation numbers are the paper's.
"""

import numpy as np

from analysis.directions import Aperture, Directions, in_plane, through_aperture
from analysis.fresnel import Conductor, fresnel_conductor
from drivers.arrays import BoolArray, FloatArray

LAMBDA_N = 600.0
"""Wavelength at which the shift is one, nm."""


def ggx_ndf(cos_m: FloatArray, alpha: float) -> FloatArray:
    """GGX distribution of normals, 1/sr. Source: Walter et al. 2007, Eq. 33."""
    cos2 = cos_m**2
    return np.asarray(alpha**2 / (np.pi * (cos2 * (alpha**2 - 1) + 1) ** 2))


def ggx_g1(cos_v: FloatArray, alpha: float) -> FloatArray:
    """Smith masking of GGX for one direction. Source: Walter et al. 2007, Eq. 34."""
    tan2 = (1 - cos_v**2) / np.maximum(cos_v**2, 1e-300)
    return np.asarray(2 / (1 + np.sqrt(1 + alpha**2 * tan2)))


def ggx_lobe(directions: Directions, alpha: float) -> FloatArray:
    """G D / (4 cos_i cos_o), 1/sr: Cook-Torrance (Eq. 6) without its Fresnel term; zero below the horizon."""
    cos_i, cos_o, cos_m, _ = directions
    above = (cos_i > 0) & (cos_o > 0)
    ci, co = np.where(above, cos_i, 1.0), np.where(above, cos_o, 1.0)
    value = ggx_ndf(cos_m, alpha) * ggx_g1(ci, alpha) * ggx_g1(co, alpha) / (4 * ci * co)
    return np.asarray(np.where(above, value, 0.0))


def cosine_slope(theta_m: FloatArray, h: float, w: float, t_y: float = 0.0) -> FloatArray:
    """Slope m of the shift (Eq. 5), 1/um; `theta_m` in degrees."""
    return np.asarray(h * np.cos(w * np.radians(theta_m)) + t_y)


def shift(slope: FloatArray, wavelengths: FloatArray, lambda_n: float = LAMBDA_N) -> FloatArray:
    """Shift function 1 + m (lambda - lambda_n) (Eq. 4), [..., wavelengths]; negative values become zero."""
    return np.asarray(np.maximum(1 + np.asarray(slope)[..., None] * (wavelengths - lambda_n) * 1e-3, 0.0))


def shift_is_clamped(slope: FloatArray, wavelengths: FloatArray, lambda_n: float = LAMBDA_N) -> BoolArray:
    """[...] whether `shift` had to be clamped at zero somewhere in `wavelengths`."""
    return np.asarray(np.any(1 + np.asarray(slope)[..., None] * (wavelengths - lambda_n) * 1e-3 < 0, axis=-1))


def theta_m(directions: Directions) -> FloatArray:
    """Angle between half vector and surface normal, degrees."""
    return np.asarray(np.degrees(np.arccos(np.clip(directions.cos_m, -1, 1))))


def cook_torrance(
    directions: Directions,
    wavelengths: FloatArray,
    alpha: float,
    conductor: Conductor,
    h: float = 0.0,
    w: float = 0.0,
) -> FloatArray:
    """Cook-Torrance with GGX (Eq. 6) times the shift (Eq. 7), 1/sr, [..., wavelengths].

    With `h` = 0 it is plain Cook-Torrance. Raises `OutOfRange` beyond the conductor's table.
    """
    n, k = conductor.index(wavelengths)
    value = ggx_lobe(directions, alpha)[..., None] * fresnel_conductor(directions.cos_d[..., None], n, k)
    if h != 0:
        value = value * shift(cosine_slope(theta_m(directions), h, w), wavelengths)
    return np.asarray(value)


def measured_cook_torrance(
    theta_in: FloatArray,
    theta_out: FloatArray,
    wavelengths: FloatArray,
    alpha: float,
    conductor: Conductor,
    aperture: Aperture,
    h: float = 0.0,
    w: float = 0.0,
) -> FloatArray:
    """What an instrument with a finite aperture reads of `cook_torrance`, [points, wavelengths], 1/sr.

    The lobe and the slope are averaged over the aperture, weighted as the light is; Fresnel reflectance is
    taken at the centre, which changes a 1 degree aperture's reading by at most 4e-4 (alpha 0.0045, at
    70 degrees) and by less than 4e-5 for alpha >= 0.18.
    """
    directions = through_aperture(theta_in, theta_out, aperture)
    lobe = ggx_lobe(directions, alpha) * aperture.weights
    total = lobe.sum(axis=-1)
    n, k = conductor.index(wavelengths)
    centre = in_plane(theta_in, theta_out)
    value = total[:, None] * fresnel_conductor(centre.cos_d[:, None], n, k)
    if h != 0:
        slope = (lobe * cosine_slope(theta_m(directions), h, w)).sum(axis=-1) / np.where(total > 0, total, 1.0)
        value = value * shift(slope, wavelengths)
    return np.asarray(value)
