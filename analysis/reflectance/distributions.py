"""Distributions of microfacet normals with their masking, and the lobe that they make.

GGX and Beckmann, isotropic, as Walter et al. 2007 define them (Microfacet Models for Refraction through Rough
Surfaces; equation numbers below are theirs). Cosines have any one shape [...], `alpha` is the dimensionless roughness.
"""

import numpy as np

from analysis.choices import Distribution
from analysis.reflectance.directions import Directions
from drivers.arrays import BoolArray, FloatArray

_UNMASKED = 1 / 1.6
"""alpha tan(theta) up to which the rational approximation of Beckmann's masking is one."""


def ndf(cos_m: FloatArray, alpha: float, distribution: Distribution = "ggx") -> FloatArray:
    """Density D of normals, 1/sr, [...], at the cosine `cos_m` > 0 between half vector and surface normal.

    Projected onto the surface it integrates to one. Source: Eq. 33 (GGX), Eq. 25 (Beckmann).
    """
    cos2 = cos_m**2
    if distribution == "ggx":
        return np.asarray(alpha**2 / (np.pi * (cos2 * (alpha**2 - 1) + 1) ** 2))
    return np.asarray(np.exp((1 - 1 / cos2) / alpha**2) / (np.pi * alpha**2 * cos2**2))


def g1(cos_v: FloatArray, alpha: float, distribution: Distribution = "ggx") -> FloatArray:
    """Smith's masking of one direction, 0 ... 1, [...], at the cosine `cos_v` > 0 to the surface normal.

    Source: Eq. 34 (GGX), and for Beckmann the rational approximation below Eq. 27, within 0.35 % of Smith's integral;
    Mitsuba's `roughconductor` takes the same.
    """
    if distribution == "ggx":
        return np.asarray(2 / (1 + np.sqrt(1 + alpha**2 * _tan2(cos_v))))
    r = alpha * np.sqrt(_tan2(cos_v))
    return np.asarray(np.where(np.real(r) <= _UNMASKED, 1.0, (3.535 * r + 2.181) / (r**2 + 2.276 * r + 2.577)))


def lobe(directions: Directions, alpha: float, distribution: Distribution = "ggx") -> FloatArray:
    """G D / (4 cos_i cos_o), 1/sr, [...]: Cook-Torrance (Eq. 6 of the paper) without its Fresnel term.

    G is the product of both directions' maskings (Eq. 23). Zero below the horizon.
    """
    if distribution == "ggx":
        above = (directions.cos_i > 0) & (directions.cos_o > 0)
        reach = _reach(directions.cos_i, alpha)[0] * _reach(directions.cos_o, alpha)[0]
        return np.asarray(above * (ndf(directions.cos_m, alpha) / reach))
    above, (cos_i, cos_o, cos_m) = _above(directions)
    masking = g1(cos_i, alpha, distribution) * g1(cos_o, alpha, distribution)
    value = ndf(cos_m, alpha, distribution) * masking / (4 * cos_i * cos_o)
    return np.asarray(np.where(above, value, 0.0))


def lobe_derivative(
    directions: Directions, alpha: float, distribution: Distribution = "ggx"
) -> tuple[FloatArray, FloatArray]:
    """`lobe` [...] and its derivative by `alpha` [...], both 1/sr."""
    if distribution == "ggx":
        above = (directions.cos_i > 0) & (directions.cos_o > 0)
        (reach_i, by_alpha_i), (reach_o, by_alpha_o) = (
            _reach(cosine, alpha) for cosine in (directions.cos_i, directions.cos_o)
        )
        value = above * (ndf(directions.cos_m, alpha) / (reach_i * reach_o))
        relative = _ndf_log_derivative(directions.cos_m, alpha, distribution)
        return value, value * (relative - by_alpha_i / reach_i - by_alpha_o / reach_o)
    _, (cos_i, cos_o, cos_m) = _above(directions)
    value = lobe(directions, alpha, distribution)
    relative = (
        _ndf_log_derivative(cos_m, alpha, distribution)
        + _g1_log_derivative(cos_i, alpha, distribution)
        + _g1_log_derivative(cos_o, alpha, distribution)
    )
    return value, value * relative


def _reach(cosine: FloatArray, alpha: float) -> tuple[FloatArray, FloatArray]:
    """2 cos / G1 of GGX, and its derivative by alpha; below the horizon those at it, so that none is zero."""
    cosine = np.maximum(cosine, 0.0)
    sin2 = 1 - cosine**2
    root = np.sqrt(cosine**2 + alpha**2 * sin2)
    return cosine + root, alpha * sin2 / root


def _ndf_log_derivative(cos_m: FloatArray, alpha: float, distribution: Distribution) -> FloatArray:
    """Of ln D by alpha."""
    cos2 = cos_m**2
    if distribution == "ggx":
        within = alpha**2 * cos2
        return np.asarray(2 * (1 - cos2 - within) / (alpha * (1 - cos2 + within)))
    return np.asarray(2 / alpha * ((1 / cos2 - 1) / alpha**2 - 1))


def _g1_log_derivative(cos_v: FloatArray, alpha: float, distribution: Distribution) -> FloatArray:
    """Of ln G1 by alpha."""
    tan2 = _tan2(cos_v)
    if distribution == "ggx":
        root = np.sqrt(1 + alpha**2 * tan2)
        return np.asarray(-alpha * tan2 / (root * (1 + root)))
    tan = np.sqrt(tan2)
    r = alpha * tan
    masked = tan * (3.535 / (3.535 * r + 2.181) - (2 * r + 2.276) / (r**2 + 2.276 * r + 2.577))
    return np.asarray(np.where(r <= _UNMASKED, 0.0, masked))


def _tan2(cos_v: FloatArray) -> FloatArray:
    # rounding may carry a cosine beyond one
    return np.asarray(np.maximum(1 - cos_v**2, 0) / np.maximum(cos_v**2, 1e-300))


def _above(directions: Directions) -> tuple[BoolArray, tuple[FloatArray, FloatArray, FloatArray]]:
    """Where both directions are above the horizon, and cos_i, cos_o, cos_m with harmless ones elsewhere."""
    above = (directions.cos_i > 0) & (directions.cos_o > 0)
    cosines = (directions.cos_i, directions.cos_o, directions.cos_m)
    cos_i, cos_o, cos_m = (np.where(above, cosine, 1.0) for cosine in cosines)
    return above, (cos_i, cos_o, cos_m)


def lobe_width(alpha: float, distribution: Distribution = "ggx") -> float:
    """Full width at half maximum of the distribution of normals, as seen in theta_out, degrees; 360 where D is wider.

    theta_m changes half as fast as theta_out. GGX falls to one half where cos^2 = (1 - sqrt(2) alpha^2) /
    (1 - alpha^2), Beckmann where tan^2 / alpha^2 + 2 ln cos^2 = ln 2, which is -1/alpha^2 + y / alpha^2 - 2 ln y = ln 2
    for y = 1 / cos^2 (Eqs. 33 and 25).
    """
    squared = alpha**2
    if distribution == "ggx":
        if squared >= np.sqrt(0.5):
            return 360.0
        return float(4 * np.degrees(np.arccos(np.sqrt((1 - np.sqrt(2) * squared) / (1 - squared)))))
    y = 1.0
    for _ in range(200):  # y is the fixed point of a contraction where the lobe is narrow
        y = 1 + squared * (np.log(2) + 2 * np.log(y))
    return float(4 * np.degrees(np.arctan(np.sqrt(y - 1)))) if squared < 0.4 else 360.0
