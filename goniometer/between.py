"""The spectral BRDF of a dataset between its measured directions, with its uncertainty."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from drivers.arrays import FloatArray
from goniometer.dataset import Dataset
from goniometer.errors import CalibrationError
from goniometer.interpolant import condition, latent, learn, predict

FEWEST = 8
"""Points that an interpolation needs."""


@dataclass(frozen=True)
class Between:
    """A spectral BRDF that was read between measured directions."""

    theta_in: FloatArray
    """[points] degrees."""
    theta_out: FloatArray
    """[points] degrees."""
    wavelengths: FloatArray
    """[wavelengths] nm."""
    brdf: FloatArray
    """[points, wavelengths] 1/sr."""
    u: FloatArray
    """[points, wavelengths] standard uncertainty by interpolation and by the noise of the measured points, 1/sr. What
    all points share, such as the reference's uncertainty, comes on top and is the dataset's."""


def interpolate(dataset: Dataset, theta_in: FloatArray, theta_out: FloatArray) -> Between:
    """The BRDF of `dataset` at any directions [points], degrees, signed as in `goniometer.geometry`.

    One Gaussian process (`goniometer.interpolant`) is conditioned on all usable points; all wavelengths are
    reconstructed with its weights, each with a variance of its own. A wavelength that a point has no value for is
    interpolated without that point. Raises `CalibrationError` where fewer than `FEWEST` usable points have a spectrum.
    """
    usable = dataset.usable & np.isfinite(dataset.brdf).any(axis=1)
    if np.count_nonzero(usable) < FEWEST:
        raise CalibrationError(
            f'Sample "{dataset.sample}" has {np.count_nonzero(usable)} usable points; an interpolation needs {FEWEST}'
        )
    at_in, at_out = dataset.theta_in[usable], dataset.theta_out[usable]
    cosine = np.cos(np.radians(at_in))[:, None]
    values, noise = dataset.brdf[usable] * cosine, dataset.u_counts[usable] * cosine
    whole = np.isfinite(values).all(axis=0)
    if not whole.any():
        raise CalibrationError(f'Sample "{dataset.sample}" has no wavelength at which all usable points have a value')
    shape = learn(at_in, at_out, values[:, whole], noise[:, whole], dataset.u_angle)
    brdf = np.empty((theta_in.size, dataset.wavelengths.size))
    u = np.empty_like(brdf)
    patterns, which = np.unique(np.isfinite(values), axis=1, return_inverse=True)
    for i, pattern in enumerate(patterns.T):
        bands = np.flatnonzero(which == i)
        if np.count_nonzero(pattern) < FEWEST:
            brdf[:, bands] = u[:, bands] = np.nan
            continue
        known = np.ix_(pattern, bands)
        process = condition(shape, at_in[pattern], at_out[pattern], values[known], noise[known])
        told = predict(process, theta_in, theta_out)
        level = np.exp(told.latent)
        # the process's own uncertainty is for the typical noise; what a wavelength is noisier shows through the weights
        through = solve_triangular(process.factor, told.solved, lower=True, trans="T", check_finite=False)
        excess = (noise[known] / np.exp(latent(values[known], shape.offset))) ** 2 - process.noise[:, None] ** 2
        variance = (told.sigma * told.trust)[:, None] ** 2 * np.diag(process.spread)
        variance = variance + through.T**2 @ np.maximum(excess, 0.0)
        brdf[:, bands] = np.maximum(level - shape.offset, 0.0)
        u[:, bands] = level * np.sqrt(variance)
    target = np.cos(np.radians(theta_in))[:, None]
    return Between(theta_in, theta_out, dataset.wavelengths, brdf / target, u / target)
