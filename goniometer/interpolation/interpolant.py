"""A measured BRDF between its points, with the uncertainty of reading it there.

A Gaussian process over all incident angles at once (Rasmussen & Williams 2006, chapter 2): ln(offset + cos(theta_in) f)
is a lobe (`goniometer.interpolation.lobe`) plus a random function whose covariance is that of
`goniometer.interpolation.kernel`. That the lobe's parameters may be off enters as explicit basis functions with a prior
(section 2.7 there), so a lobe that was fitted to a few points does not pass for knowledge. All bands or wavelengths are
reconstructed with the same weights, each with its own variance. How far the measurements support the process is told by
the process itself: each point is predicted from all others, and where these predictions are worse than they claim, so
will be those of other directions.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cholesky, lapack, solve_triangular

from drivers.arrays import FloatArray
from goniometer.interpolation.kernel import JITTER, Coordinates, Scales, coordinates, covariance, fit_scales, variance
from goniometer.interpolation.lobe import Lobe, fit_lobe

OFFSET = 1e-4
"""cos(theta_in) f, 1/sr, that is added before the logarithm is taken: what is darker is dark."""

_BELIEF = 2.0
"""How many points' worth of trust the process has in its own uncertainties before any prediction was checked."""


@dataclass(frozen=True)
class Shape:
    """What is learnt of a sample as a whole, and seldom anew."""

    lobe: Lobe
    scales: Scales
    offset: float
    """cos(theta_in) f, 1/sr, that is added before the logarithm is taken."""
    u_angle: float = 0.0
    """Standard uncertainty of a stage's position, degrees."""

    def level(self, theta_in: FloatArray, theta_out: FloatArray) -> FloatArray:
        """ln(offset + cos f) of the lobes at directions [points], degrees."""
        return np.asarray(np.log(self.offset + self.lobe.cosine_brdf(theta_in, theta_out)))

    def doubt(self, theta_in: FloatArray, theta_out: FloatArray) -> FloatArray:
        """[points, parameters] change of `level` when one of the lobes' parameters is off by what it may be off."""
        return self.lobe.doubt(theta_in, theta_out, self.offset)

    def read_noise(
        self, theta_in: FloatArray, theta_out: FloatArray, values: FloatArray, noise: FloatArray
    ) -> FloatArray:
        """[points] standard uncertainty of ln(offset + cos f) of measured points, arguments as for `learn`.

        The median over the bands of their own, and what an error of the stages makes of it where a lobe is steep: a
        degree of the sample stage turns the half vector by one degree, a degree of the detector stage by half of one.
        """
        own = np.median(noise / (self.offset + np.maximum(values, 0.0)), axis=1)
        step = 0.05
        slope = (self.level(theta_in, theta_out + step) - self.level(theta_in, theta_out - step)) / step
        return np.asarray(np.hypot(own, slope * np.sqrt(1.25) * self.u_angle))


@dataclass(frozen=True)
class Interpolant:
    """The process conditioned on measured points; made by `condition`."""

    shape: Shape
    at: Coordinates
    """[points]"""
    doubt: FloatArray
    """[points, parameters] what the lobes may be off."""
    noise: FloatArray
    """[points] standard uncertainty of ln(offset + cos f) that all bands are taken to have."""
    factor: FloatArray
    """[points, points] lower Cholesky factor of the covariance of the measured values."""
    weights: FloatArray
    """[points, bands] inverse covariance times what the lobe leaves over."""
    scores: FloatArray
    """[points] mean square over bands of the leave-one-out z-scores."""
    spread: FloatArray
    """[bands, bands] covariance of the bands over that of the process."""


@dataclass(frozen=True)
class Prediction:
    """What the process says of directions, as ln(offset + cos f)."""

    latent: FloatArray
    """[points, bands]"""
    sigma: FloatArray
    """[points] standard uncertainty of the process, to be multiplied with the root of the bands' `spread`."""
    trust: FloatArray
    """[points] by how much predictions nearby were worse than claimed: the root mean square of their z-scores."""
    near: FloatArray
    """[measured points, points] how alike they are: prior correlation of what the lobes leave over."""
    doubt: FloatArray
    """[points, parameters] what the lobes may be off."""
    solved: FloatArray
    """[measured points, points] the inverse of the Cholesky factor times the prior covariance."""


def latent(values: FloatArray, offset: float) -> FloatArray:
    """ln(offset + cos f) of values [points, bands]; a negative value counts as zero."""
    return np.asarray(np.log(offset + np.maximum(values, 0.0)))


def learn(
    theta_in: FloatArray,
    theta_out: FloatArray,
    values: FloatArray,
    noise: FloatArray,
    u_angle: float = 0.0,
    start: Scales | None = None,
) -> Shape:
    """Lobe and scales of a sample from the mean over bands of its measured points.

    `theta_in`, `theta_out` [points] in degrees, `values` [points, bands] cos(theta_in) f and its standard uncertainty
    `noise`, both 1/sr and finite, `u_angle` the standard uncertainty of a stage's position, degrees. The search for the
    scales begins at `start`.
    """
    offset = max(OFFSET, float(np.quantile(noise, 0.1)))
    mean = latent(values, offset).mean(axis=1)
    u = np.median(noise / (offset + np.maximum(values, 0.0)), axis=1)
    shape = Shape(fit_lobe(theta_in, theta_out, mean, u, offset), Scales(), offset, u_angle)
    u = shape.read_noise(theta_in, theta_out, values, noise)
    if u_angle > 0:  # a flank told how little it can tell
        shape = replace(shape, lobe=fit_lobe(theta_in, theta_out, mean, u, offset, shape.lobe))
        u = shape.read_noise(theta_in, theta_out, values, noise)
    at = coordinates(theta_in, theta_out, shape.lobe)
    residual, doubt = mean - shape.level(theta_in, theta_out), shape.doubt(theta_in, theta_out)
    return replace(shape, scales=fit_scales(at, residual, u, doubt, start or Scales()))


def condition(
    shape: Shape, theta_in: FloatArray, theta_out: FloatArray, values: FloatArray, noise: FloatArray
) -> Interpolant:
    """The process given measured points; arguments as for `learn`."""
    power = shape.scales.amplitude**2
    at = coordinates(theta_in, theta_out, shape.lobe)
    u = shape.read_noise(theta_in, theta_out, values, noise)
    residual = latent(values, shape.offset) - shape.level(theta_in, theta_out)[:, None]
    doubt = shape.doubt(theta_in, theta_out)
    K = covariance(at, at, shape.scales) + doubt @ doubt.T
    K[np.diag_indices_from(K)] += u**2 + JITTER * power
    factor = cholesky(K, lower=True, overwrite_a=True, check_finite=False)
    inverse, _ = lapack.dpotri(factor, lower=1)
    precision = np.diag(inverse).copy()
    half = solve_triangular(factor, residual, lower=True, check_finite=False)
    weights = solve_triangular(factor, half, lower=True, trans="T", check_finite=False)
    # Maximum likelihood of a separable covariance of points and bands, with the trust of a few points in bands that
    # go together. Lobes with many parameters follow the noise of few points; what is left must not look like precision.
    bands = residual.shape[1]
    together = 0.95 + 0.05 * np.eye(bands)
    free = max(len(residual) - doubt.shape[1], 1)
    spread = (half.T @ half + _BELIEF * together) / (free + _BELIEF)
    spread = spread / min(float(np.mean(np.diag(spread))), 1.0)
    scores = np.mean(weights**2 / np.diag(spread), axis=1) / precision
    return Interpolant(shape, at, doubt, u, factor, weights, scores, spread)


def predict(process: Interpolant, theta_in: FloatArray, theta_out: FloatArray) -> Prediction:
    """What the process says of directions [points], degrees."""
    shape = process.shape
    at = coordinates(theta_in, theta_out, shape.lobe)
    doubt = shape.doubt(theta_in, theta_out)
    smooth = covariance(process.at, at, shape.scales)
    cross = smooth + process.doubt @ doubt.T
    solved = solve_triangular(process.factor, cross, lower=True, check_finite=False)
    left = variance(at, shape.scales) + np.sum(doubt**2, axis=1) - np.einsum("ij,ij->j", solved, solved)
    near = smooth / shape.scales.amplitude**2
    trust = (_BELIEF + process.scores @ near) / (_BELIEF + near.sum(axis=0))
    return Prediction(
        shape.level(theta_in, theta_out)[:, None] + cross.T @ process.weights,
        np.sqrt(np.maximum(left, 0.0)),
        np.sqrt(trust),
        near,
        doubt,
        solved,
    )


def predict_values(process: Interpolant, theta_in: FloatArray, theta_out: FloatArray) -> tuple[FloatArray, FloatArray]:
    """cos(theta_in) f of directions [points], degrees, and its standard uncertainty, both [points, bands], 1/sr.

    The uncertainty is that of reading between the points, their noise included, as the record of the process near
    each direction has proven it.
    """
    told = predict(process, theta_in, theta_out)
    level = np.exp(told.latent)
    relative = (told.sigma * told.trust)[:, None] * np.sqrt(np.diag(process.spread))
    return np.maximum(level - process.shape.offset, 0.0), level * relative
