"""The lobe that the interpolation starts from: a GGX-like shape with five parameters, fitted to all incident angles.

It need not be right. A Gaussian process carries what the lobe leaves over (`goniometer.interpolant`); the lobe's
width says on which scale a BRDF changes near the mirror direction, which matters more than its shape.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from drivers.arrays import FloatArray

_LARGEST_TILT = 2.0
"""Degrees by which the surface normal may lean away from the zero of the sample stage."""

_STARTS = (0.004, 0.02, 0.06, 0.15, 0.4)
"""Roughnesses from which the fit begins: from one alone it misses lobes of another width."""

_SCATTER = 0.05
"""Standard deviation of ln(cos f) up to which a lobe is expected to describe a point, beside the noise."""

_LOWEST = np.array([-25.0, np.log(0.002), 1.2, -25.0, -_LARGEST_TILT])
_HIGHEST = np.array([25.0, np.log(1.5), 6.0, 5.0, _LARGEST_TILT])


@dataclass(frozen=True)
class Lobe:
    """A lobe around the mirror direction and a constant: f = exp(log_height) D G / (4 cos_i cos_o) + exp(log_floor).

    D = (1 + tan^2(theta_h) / alpha^2)^-gamma / cos^4(theta_h), which is GGX, divided by its peak, for gamma = 2
    (Walter et al. 2007, Eq. 33; with a free exponent: Ribardiere et al. 2017). G is Smith's masking of GGX
    (Walter et al. 2007, Eq. 34) for both directions.
    """

    log_height: float
    """Logarithm of the peak of D, 1/sr."""
    alpha: float
    """Roughness, the tangent of an angle."""
    gamma: float
    """Exponent of the tail."""
    log_floor: float
    """Logarithm of a constant BRDF, 1/sr."""
    tilt: float
    """Angle of the half vector at which D has its peak, degrees: the surface normal as the stages see it."""

    @property
    def half_width(self) -> float:
        """Half vector angle from the peak of D to its half, degrees."""
        return float(np.degrees(np.arctan(self.alpha * np.sqrt(2 ** (1 / self.gamma) - 1))))

    def cosine_brdf(self, theta_in: FloatArray, theta_out: FloatArray) -> FloatArray:
        """cos(theta_in) f, any one shape, of signed in-plane angles in degrees."""
        parameters = np.array([self.log_height, np.log(self.alpha), self.gamma, self.log_floor, self.tilt])
        return _cosine_brdf(parameters, theta_in, theta_out)


def _cosine_brdf(parameters: FloatArray, theta_in: FloatArray, theta_out: FloatArray) -> FloatArray:
    log_height, log_alpha, gamma, log_floor, tilt = parameters
    alpha2 = np.exp(2 * log_alpha)
    cos_in, cos_out = np.cos(np.radians(theta_in)), np.cos(np.radians(theta_out))
    half = np.radians((theta_out - theta_in) / 2 - tilt)
    peak = (1 + np.tan(half) ** 2 / alpha2) ** -gamma / np.cos(half) ** 4
    masking = _smith(cos_in, alpha2) * _smith(cos_out, alpha2)
    return np.asarray(np.exp(log_height) * peak * masking / (4 * cos_out) + np.exp(log_floor) * cos_in)


def _smith(cosine: FloatArray, alpha2: float) -> FloatArray:
    return np.asarray(2 / (1 + np.sqrt(1 + alpha2 * (1 / cosine**2 - 1))))


def fit_lobe(theta_in: FloatArray, theta_out: FloatArray, latent: FloatArray, noise: FloatArray, offset: float) -> Lobe:
    """The lobe that describes most points, of all incident angles at once, [points] each; angles in degrees.

    `latent` is ln(offset + cos(theta_in) f), `noise` its standard uncertainty. Points that the lobe cannot describe
    count little (soft L1 loss), so a second lobe does not spoil the first. The best of several starts.
    """
    scale = np.hypot(noise, _SCATTER)

    def residuals(parameters: FloatArray) -> FloatArray:
        return np.asarray((np.log(offset + _cosine_brdf(parameters, theta_in, theta_out)) - latent) / scale)

    near = np.argmin(np.abs(theta_out - theta_in))
    floor = float(np.quantile(latent, 0.2))
    best, lowest_cost = None, np.inf
    for alpha in _STARTS:
        start = np.array([latent[near] + np.log(4 * np.cos(np.radians(theta_out[near]))), np.log(alpha), 2.0, floor, 0])
        found = least_squares(
            residuals, np.clip(start, _LOWEST, _HIGHEST), bounds=(_LOWEST, _HIGHEST), loss="soft_l1", max_nfev=25
        )
        if found.cost < lowest_cost:
            best, lowest_cost = found.x, found.cost
    assert best is not None
    return Lobe(float(best[0]), float(np.exp(best[1])), float(best[2]), float(best[3]), float(best[4]))
