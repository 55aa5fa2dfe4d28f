"""The white reference: a Spectralon panel, its certificate, and why it is not Lambertian.

A certificate gives one number per wavelength, the reflectance rho for light from 8 degrees into the whole
hemisphere. How this light is spread over directions is a five-term model of sintered PTFE panels (IEEE
TGRS 2024, DOI 10.1109/TGRS.2024.3361392): a fall-off towards grazing view, diffuse forward scattering,
subsurface scattering, a specular and a back-scattered lobe. We divide the model by its own cosine-weighted
integral over the hemisphere, so that for every incident angle the panel returns exactly the certified share
of the light; the published normalisation table does not.

Zenith angles enter in radians; phi is the azimuth between incident and reflected direction, 0 = back to the
source, pi = forward, so in plane `theta_out` > 0 means phi = pi.
"""

import math

import numpy as np
from scipy.special import erf

from drivers.arrays import FloatArray
from goniometer.errors import GeometryError

# The published coefficients c0 ... c26, in the paper's order and grouped as the terms below use them.
_SUBSURFACE = (0.5696875917173422, 0.27903122059147045, -1.7476750611608318, 2.5855843488200034)
_SUBSURFACE_POWERS = (8.263416395698357, 1.6450590437852088)
_FALL_OFF = (1.851701611373643, 0.09100373143807905)
_FORWARD = (0.5718024986324589, 0.009912786942804066, 0.04026383165673021, 1.1856631736844976)
_FORWARD_POWERS = (1.4094448692363608, 3.753748299350997)
_BACK = (0.26592501709914296, 0.25982186894746806, 4.719404248241861)
_BACK_WIDTHS = (0.8025276470171108, 0.29606885318487797)
_SPECULAR = (0.4965306551513434, 0.0, 5.866204408080527)
_SPECULAR_WIDTHS = (1.212578167338859, 0.4107185337489295)
_REDDENING = (0.02091690159556928, 0.9782260653794538, 2.944780616597054)

_BACK_CUT = (math.radians(10) / _BACK_WIDTHS[0]) ** 2 + (math.radians(5) / _BACK_WIDTHS[1]) ** 2
"""Exponent inside which the back-scattered lobe was never measured (10 degrees across, 5 along) and is cut flat."""

_SUBSURFACE_ENDS = -_SUBSURFACE[3] / _SUBSURFACE[2]
"""Zenith angle, radians, at which the azimuthal width d(t) reaches zero: H is continuous there, but not smooth."""

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(64)
"""Gauss's rule, for the azimuth and for each part of the zenith angles.

Against 1500 nodes it is right to 3e-7 for incident angles up to 84.5 degrees, and to 2e-5 where H has its edge.
"""

U_DIRECTIONAL = 0.009
"""Relative standard uncertainty of the spread over directions up to 70 degrees from the normal."""

U_DIRECTIONAL_GRAZING = 0.05
"""The same at 85 degrees."""


def _pos(x: FloatArray) -> FloatArray:
    """The paper's pos(): a floor under bases of powers that could become negative near grazing."""
    return np.asarray(np.maximum(x, 1e-8))


def _subsurface(t: FloatArray, forward2: FloatArray) -> FloatArray:
    """H(t): one direction's share of the subsurface term; `forward2` is (phi - pi)^2."""
    amplitude = _pos(_SUBSURFACE[0] * t + _SUBSURFACE[1]) ** _SUBSURFACE_POWERS[0]
    d = _pos(_SUBSURFACE[2] * t + _SUBSURFACE[3]) ** _SUBSURFACE_POWERS[1]
    return np.asarray(amplitude * (1 + forward2 / d) ** (-(d + 1) / 2))


def _diffuse_forward(t: FloatArray, forward2: FloatArray) -> FloatArray:
    """G(t): one direction's share of the diffuse forward term; `forward2` is (phi - pi)^2."""
    amplitude = _pos(_FORWARD[0] * t + _FORWARD[1]) ** _FORWARD_POWERS[0]
    width = _pos(_FORWARD[2] * t + _FORWARD[3]) ** _FORWARD_POWERS[1]
    return np.asarray(amplitude * np.exp(-forward2 / width**2))


def _specular_height(theta_i: FloatArray) -> FloatArray:
    """Height of the specular lobe."""
    return _pos(_SPECULAR[0] * theta_i + _SPECULAR[1]) ** _SPECULAR[2]


def _back_height(theta_i: FloatArray) -> FloatArray:
    """Height of the back-scattered lobe before it is cut."""
    return np.asarray((_BACK[0] * theta_i + _BACK[1]) ** _BACK[2])


def _terms(azimuth: FloatArray, theta_v: FloatArray, theta_i: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The part of K that reddens and the part that does not; all angles in radians, azimuth in [0, 2 pi)."""
    forward2 = (azimuth - np.pi) ** 2
    back2 = np.minimum(azimuth, 2 * np.pi - azimuth) ** 2
    apart2 = (theta_v - theta_i) ** 2
    specular = np.exp(-forward2 / _SPECULAR_WIDTHS[0] ** 2 - apart2 / _SPECULAR_WIDTHS[1] ** 2)
    reddening = (
        _diffuse_forward(theta_v, forward2) * _diffuse_forward(theta_i, forward2)
        + _subsurface(theta_v, forward2) * _subsurface(theta_i, forward2)
        + _specular_height(theta_i) * specular
    )
    back = np.exp(-np.maximum(back2 / _BACK_WIDTHS[0] ** 2 + apart2 / _BACK_WIDTHS[1] ** 2, _BACK_CUT))
    neutral = 1 - _FALL_OFF[1] * theta_v ** _FALL_OFF[0] + _back_height(theta_i) * back
    return np.asarray(reddening), np.asarray(neutral)


def _hemisphere(theta_i: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(1/pi) integral of both parts of K times cos(theta_v) over the hemisphere, [angles]; `theta_i` [angles] radians.

    The wavelength is no part of it, because it enters K only as a factor of the first part. Nor is a double sum
    for each angle: the diffuse terms are products of one factor for each direction, so that the sum over
    theta_v is the same for all angles, and the azimuth integrals of the two lobes are error functions. K is even
    in phi - pi, so half the azimuths will do.
    """
    azimuth, azimuth_weight = np.pi / 2 * (_NODES + 1), np.pi * _WEIGHTS
    forward2 = (azimuth - np.pi) ** 2
    halves = ((0.0, _SUBSURFACE_ENDS), (_SUBSURFACE_ENDS, np.pi / 2))
    theta_v = np.concatenate([low + (high - low) / 2 * (_NODES + 1) for low, high in halves])
    projected = (
        np.concatenate([(high - low) / 2 * _WEIGHTS for low, high in halves]) * np.cos(theta_v) * np.sin(theta_v)
    )

    viewed, lit = theta_v[:, None], theta_i[:, None]
    reddening = _diffuse_forward(lit, forward2) @ (azimuth_weight * (projected @ _diffuse_forward(viewed, forward2)))
    reddening += _subsurface(lit, forward2) @ (azimuth_weight * (projected @ _subsurface(viewed, forward2)))
    apart2 = (theta_v - lit) ** 2
    reddening += (
        _specular_height(theta_i)
        * _gaussian(_SPECULAR_WIDTHS[0])
        * (np.exp(-apart2 / _SPECULAR_WIDTHS[1] ** 2) @ projected)
    )
    exponent = apart2 / _BACK_WIDTHS[1] ** 2
    edge = _BACK_WIDTHS[0] * np.sqrt(np.maximum(_BACK_CUT - exponent, 0))  # azimuth where the cut lobe ends
    back = 2 * edge * math.exp(-_BACK_CUT) + np.exp(-exponent) * _gaussian(_BACK_WIDTHS[0], edge)
    fall_off = 2 * np.pi * (1 - _FALL_OFF[1] * theta_v ** _FALL_OFF[0]) @ projected
    neutral = fall_off + _back_height(theta_i) * (back @ projected)
    return np.asarray(reddening / np.pi), np.asarray(neutral / np.pi)


def _gaussian(width: float, inner: FloatArray | float = 0.0) -> FloatArray:
    """Integral of exp(-x^2 / width^2) over `inner` < |x| < pi, of the shape of `inner`; radians."""
    return np.asarray(width * math.sqrt(math.pi) * (erf(math.pi / width) - erf(inner / width)))


def brf_ratio(azimuth: FloatArray, theta_v: FloatArray, theta_i: FloatArray, wavelengths: FloatArray) -> FloatArray:
    """Radiance factor of the panel over its 8-degree/hemispherical reflectance, [points, wavelengths].

    `azimuth` [points] in [0, 360) with 180 = forward, `theta_v` and `theta_i` [points] unsigned angles of view
    and of incidence, all in degrees; `wavelengths` in nm. Raises `GeometryError` below the horizon.

    The model was not built to be reciprocal. With both angles up to 70 degrees, exchanging the directions of light
    and view changes the value, at 600 nm, by 0.58 % rms in plane and 0.46 % over the hemisphere (0.50 % weighted
    by solid angles), and by 1.4 % at most (1.5 % from 300 nm on; near 60 and 47.5 degrees, towards the source): within
    `U_DIRECTIONAL` for each of the two. Up to 85 degrees it is 1.8 % rms and 11 % at most.
    """
    theta_v, theta_i = np.radians(theta_v), np.radians(theta_i)
    for angle in (theta_v, theta_i):
        if not np.all((angle >= 0) & (angle <= np.pi / 2)):
            raise GeometryError(
                f"The reference panel reflects nothing at {np.degrees(angle).max():g} deg: "
                "the angles of incidence and view must lie within 90 deg of its normal"
            )
    reddening, neutral = _terms(np.radians(azimuth), theta_v, theta_i)
    distinct, position = np.unique(theta_i, return_inverse=True)
    total_reddening, total_neutral = (integral[position, None] for integral in _hemisphere(distinct))
    red = (_REDDENING[0] * wavelengths * 1e-3 + _REDDENING[1]) ** _REDDENING[2]
    return np.asarray((red * reddening[:, None] + neutral[:, None]) / (red * total_reddening + total_neutral))


def spectralon_brf_ratio(theta_in: FloatArray, theta_out: FloatArray, wavelengths: FloatArray) -> FloatArray:
    """`brf_ratio` for the signed in-plane angles of `goniometer.geometry`, [points, wavelengths].

    `theta_in` and `theta_out` [points] in degrees, `wavelengths` in nm; 1 everywhere would be Lambertian.
    A negative `theta_in` is the same panel turned round. Raises `GeometryError` below the horizon.

    Near normal incidence, where a real panel knows no forward and back, those of the formula differ by up to 0.15 %;
    at 0 itself all is forward.
    """
    forward = theta_in * theta_out >= 0
    return brf_ratio(np.where(forward, 180.0, 0.0), np.abs(theta_out), np.abs(theta_in), wavelengths)


def reference_relative_uncertainty(theta_in: FloatArray, theta_out: FloatArray) -> FloatArray:
    """Relative standard uncertainty of the panel's spread over directions, [points]; angles in degrees.

    0.9 % while both angles stay within 70 degrees: the rms difference of the normalised model from NIST's
    in-plane measurements of sintered PTFE at 532 and 633 nm. Beyond, the model extrapolates; our judgement is
    a rise in proportion to the excess of the larger angle, up to 5 % at 85 degrees. The uncertainty of the
    certified reflectance comes on top and is the certificate's.
    """
    grazing = np.maximum(np.abs(theta_in), np.abs(theta_out))
    return np.asarray(U_DIRECTIONAL + (U_DIRECTIONAL_GRAZING - U_DIRECTIONAL) * np.maximum(grazing - 70.0, 0.0) / 15.0)
