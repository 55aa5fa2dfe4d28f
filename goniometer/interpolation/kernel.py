"""How alike BRDFs are in two directions: a covariance in coordinates in which a BRDF is smooth.

The coordinates are theta_d = (theta_out + theta_in) / 2 and the half vector's angle theta_h = (theta_out - theta_in)
/ 2, measured from the normal and warped: u = integral of d theta_h / l with 1/l = 1 / (l_0 sqrt(w^2 + theta_h^2)) +
1 / l_cap, so u = asinh(theta_h / w) / l_0 + theta_h / l_cap, w being the half width of the lobe. In u the flank of a
narrow lobe and the tail of a wide one are equally steep. A bump elsewhere adds such a term around its own place.

A surface that obeys reciprocity and looks alike from the left and from the right has a BRDF that is even in theta_h
and in theta_d. How far the sample at hand does is learnt from its data: the covariance is a mixture of one that knows
nothing of it and one that demands it.
"""

from dataclasses import astuple, dataclass

import numpy as np
import scipy
from scipy.linalg import cho_factor, lapack

from drivers.arrays import FloatArray
from goniometer.interpolation.lobe import NARROWEST, Lobe

JITTER = 1e-6
"""Part of the prior variance that is added to the noise's: a covariance must be invertible where points coincide."""

_ROOT5 = float(np.sqrt(5.0))


@dataclass(frozen=True)
class Scales:
    """Hyper-parameters of the covariance."""

    warp: float = 1.0
    """l_0: correlation length per logarithm of theta_h, a pure number."""
    cap: float = 40.0
    """l_cap: largest correlation length in theta_h, degrees."""
    along: float = 40.0
    """Correlation length in theta_d, degrees."""
    amplitude: float = 0.3
    """Prior standard deviation of ln(cos f) around the lobe."""
    symmetry: float = 0.9
    """Part of the prior variance that obeys both symmetries, between 0 and 1."""


_PRIOR = np.array([0.0, np.log(40.0), np.log(40.0), np.log(0.3), 2.0])
_SPREAD = np.array([0.5, 0.7, 0.7, 1.2, 2.5])
_BOUNDS = [
    (np.log(0.3), np.log(4.0)),
    (np.log(8.0), np.log(300.0)),
    (np.log(8.0), np.log(300.0)),
    (np.log(0.005), np.log(4.0)),
    (-5.0, 7.0),
]
"""Priors and bounds of the logarithms of the scales and of the logit of `symmetry`.

Free length scales save points, but a few points cannot tell a long one from a longer one, and the likelihood then runs
away: no scale leaves what a measurement of 85 degrees on either side could show.
"""


@dataclass(frozen=True)
class Coordinates:
    """Directions as the covariance sees them, [points] each."""

    logarithmic: FloatArray
    """asinh(theta_h / w), and what the bumps add."""
    linear: FloatArray
    """theta_h from the normal, degrees."""
    along: FloatArray
    """theta_d, degrees."""

    def warped(self, scales: Scales) -> FloatArray:
        """u, a pure number."""
        return self.logarithmic / scales.warp + self.linear / scales.cap


def coordinates(theta_in: FloatArray, theta_out: FloatArray, lobe: Lobe) -> Coordinates:
    """Coordinates of directions [points], degrees, for a sample with this lobe."""
    half = (theta_out - theta_in) / 2 - lobe.tilt
    logarithmic = np.arcsinh(half / max(lobe.half_width, NARROWEST))
    for bump in lobe.bumps:
        # on both sides, so that the symmetric part of the covariance stays one
        for centre in (bump.centre, -bump.centre):
            logarithmic = logarithmic + 0.5 * np.arcsinh((half - centre) / bump.width)
    return Coordinates(logarithmic, half, (theta_out + theta_in) / 2)


def matern(distance: FloatArray) -> FloatArray:
    """Matern covariance of smoothness 5/2 and unit variance (Rasmussen & Williams 2006, Eq. 4.17)."""
    r = _ROOT5 * np.abs(distance)
    return np.asarray((1 + r + r * r / 3) * np.exp(-r))


def _slope(distance: FloatArray) -> FloatArray:
    """Derivative of `matern`."""
    r = _ROOT5 * np.abs(distance)
    return np.asarray(-(5 / 3) * distance * (1 + r) * np.exp(-r))


def covariance(a: Coordinates, b: Coordinates, scales: Scales) -> FloatArray:
    """[points of a, points of b] prior covariance of ln(cos f)."""
    ua, ub = a.warped(scales)[:, None], b.warped(scales)[None, :]
    da, db = a.along[:, None] / scales.along, b.along[None, :] / scales.along
    across, along = matern(ua - ub), matern(da - db)
    if scales.symmetry == 0:
        return np.asarray(scales.amplitude**2 * across * along)
    mirrored = (across + matern(ua + ub)) * (along + matern(da + db))
    return np.asarray(scales.amplitude**2 * ((1 - scales.symmetry) * across * along + scales.symmetry * mirrored))


def variance(a: Coordinates, scales: Scales) -> FloatArray:
    """[points] prior variance of ln(cos f): the diagonal of `covariance`."""
    mirrored = (1 + matern(2 * a.warped(scales))) * (1 + matern(2 * a.along / scales.along))
    return np.asarray(scales.amplitude**2 * (1 - scales.symmetry + scales.symmetry * mirrored))


def fit_scales(
    at: Coordinates, residual: FloatArray, noise: FloatArray, doubt: FloatArray, start: Scales, steps: int = 12
) -> Scales:
    """The most probable scales given what the lobe leaves over, [points], and its standard uncertainty.

    `doubt` [points, parameters] is what the lobe's own parameters may be off, so that a fit to a few points does not
    pass for knowledge.

    Maximum a posteriori with log-normal priors, within bounds, by L-BFGS-B with the gradient of Rasmussen & Williams
    2006, Eq. 5.9.
    """

    def cost(x: FloatArray) -> tuple[float, FloatArray]:
        value, gradient = _negative_log_likelihood(at, residual, noise, doubt, _scales(x))
        away = (x - _PRIOR) / _SPREAD
        return value + 0.5 * float(away @ away), gradient + away / _SPREAD

    found = scipy.optimize.minimize(
        cost, _free(start), jac=True, method="L-BFGS-B", bounds=_BOUNDS, options={"maxiter": steps, "ftol": 1e-5}
    )
    return _scales(found.x)


def _free(scales: Scales) -> FloatArray:
    *lengths, symmetry = astuple(scales)
    symmetry = min(max(symmetry, 1e-3), 1 - 1e-3)
    return np.array([*np.log(lengths), np.log(symmetry / (1 - symmetry))])


def _scales(x: FloatArray) -> Scales:
    warp, cap, along, amplitude = (float(v) for v in np.exp(x[:4]))
    return Scales(warp, cap, along, amplitude, float(1 / (1 + np.exp(-x[4]))))


def _negative_log_likelihood(
    at: Coordinates, residual: FloatArray, noise: FloatArray, doubt: FloatArray, scales: Scales
) -> tuple[float, FloatArray]:
    """And its derivative by the free parameters (the fifth is the logit of the symmetry)."""
    log_a, log_b = at.logarithmic[:, None] / scales.warp, at.logarithmic[None, :] / scales.warp
    lin_a, lin_b = at.linear[:, None] / scales.cap, at.linear[None, :] / scales.cap
    d_a, d_b = at.along[:, None] / scales.along, at.along[None, :] / scales.along
    minus, plus = log_a - log_b + lin_a - lin_b, log_a + log_b + lin_a + lin_b
    across, across_m, along, along_m = matern(minus), matern(plus), matern(d_a - d_b), matern(d_a + d_b)
    part, power = scales.symmetry, scales.amplitude**2
    direct, mirrored = across * along, (across + across_m) * (along + along_m)
    K = power * ((1 - part) * direct + part * mirrored)
    noisy = K + doubt @ doubt.T
    noisy[np.diag_indices_from(noisy)] += noise**2 + JITTER * power
    factor = cho_factor(noisy, lower=True, overwrite_a=True)[0]
    inverse, _ = lapack.dpotri(factor, lower=1)
    inverse = np.tril(inverse) + np.tril(inverse, -1).T
    weights = inverse @ residual
    value = 0.5 * float(residual @ weights) + float(np.log(np.diag(factor)).sum())
    # derivative of the likelihood by each entry of K, times a derivative of K, summed over all entries
    by_K = 0.5 * (inverse - np.outer(weights, weights)) * power
    by_across = by_K * ((1 - part) * along + part * (along + along_m)) * _slope(minus)
    by_across_m = by_K * part * (along + along_m) * _slope(plus)
    by_along = by_K * ((1 - part) * across + part * (across + across_m)) * _slope(d_a - d_b)
    by_along_m = by_K * part * (across + across_m) * _slope(d_a + d_b)
    gradient = [
        -np.sum(by_across * (log_a - log_b)) - np.sum(by_across_m * (log_a + log_b)),
        -np.sum(by_across * (lin_a - lin_b)) - np.sum(by_across_m * (lin_a + lin_b)),
        -np.sum(by_along * (d_a - d_b)) - np.sum(by_along_m * (d_a + d_b)),
        2 * np.sum(by_K * K) / power + 2 * JITTER * np.trace(by_K),
        np.sum(by_K * (mirrored - direct)) * part * (1 - part),
    ]
    return value, np.array(gradient)
