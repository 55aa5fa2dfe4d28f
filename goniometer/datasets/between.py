"""The spectral BRDF of a dataset between its measured directions, with its uncertainty."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from drivers.arrays import FloatArray
from goniometer.datasets.dataset import Dataset
from goniometer.errors import CalibrationError
from goniometer.interpolation.interpolant import Shape, condition, latent, learn, predict
from goniometer.uncertainty import variance_of_readings

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
    wavelengths share, such as the reference's uncertainty, comes on top."""
    u_total: FloatArray
    """[points, wavelengths] combined standard uncertainty, with the errors that wavelengths share, 1/sr."""
    weights: FloatArray
    """[patterns, points, dataset's points] change of ln(offset + cos(theta_in) f) for that of a measured point; zero
    for points that took no part."""
    together: FloatArray
    """[wavelengths, wavelengths] correlation of the errors in `u`, as of the process; zero between wavelengths that
    were read with other weights."""
    pattern: NDArray[np.intp]
    """[wavelengths] which of the `weights` a wavelength was read with: there is a set for each choice of points that
    have a value."""
    shape: Shape
    """What was learnt of the sample as a whole, the offset among it."""


def interpolate(dataset: Dataset, theta_in: FloatArray, theta_out: FloatArray) -> Between:
    """The BRDF of `dataset` at any directions [points], degrees, signed as in `goniometer.geometry`.

    One Gaussian process (`goniometer.interpolation.interpolant`) is conditioned on all usable points; all wavelengths
    are reconstructed with its weights, each with a variance of its own. A wavelength that a point has no value for is
    interpolated without that point. Raises `CalibrationError` where fewer than `FEWEST` usable points have a spectrum.
    """
    usable = np.flatnonzero(dataset.usable & np.isfinite(dataset.brdf).any(axis=1))
    if usable.size < FEWEST:
        raise CalibrationError(
            f'Sample "{dataset.sample}" has {usable.size} usable points; an interpolation needs {FEWEST}'
        )
    at_in, at_out = dataset.theta_in[usable], dataset.theta_out[usable]
    cosine = np.cos(np.radians(at_in))[:, None]
    values, noise = dataset.brdf[usable] * cosine, dataset.u_counts[usable] * cosine
    # where spectra have gaps, the sample is learnt from the points that have the wavelength which most have
    best = int(np.argmax(np.isfinite(values).sum(axis=0)))
    having = np.isfinite(values[:, best])
    whole = np.ix_(having, np.isfinite(values[having]).all(axis=0))
    shape = learn(at_in[having], at_out[having], values[whole], noise[whole], dataset.u_angle)
    brdf = np.empty((theta_in.size, dataset.wavelengths.size))
    u, shared = np.empty_like(brdf), np.empty_like(brdf)
    patterns, which = np.unique(np.isfinite(values), axis=1, return_inverse=True)
    weights = np.zeros((patterns.shape[1], theta_in.size, dataset.theta_in.size))
    together = np.eye(dataset.wavelengths.size)
    for i, pattern in enumerate(patterns.T):
        bands = np.flatnonzero(which == i)
        if np.count_nonzero(pattern) < FEWEST:
            brdf[:, bands] = u[:, bands] = shared[:, bands] = np.nan
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
        weights[i][:, usable[pattern]] = through.T
        root = np.sqrt(np.diag(process.spread))
        together[np.ix_(bands, bands)] = process.spread / np.outer(root, root)
        shared[:, bands] = level * np.sqrt(_shared(dataset, bands, weights[i], shape.offset))
    target = np.cos(np.radians(theta_in))[:, None]
    return Between(
        theta_in,
        theta_out,
        dataset.wavelengths,
        brdf / target,
        u / target,
        np.hypot(u, shared) / target,
        weights,
        together,
        np.asarray(which).ravel(),
        shape,
    )


def _shared(dataset: Dataset, bands: NDArray[np.intp], weights: FloatArray, offset: float) -> FloatArray:
    """[directions, bands] variance of ln(offset + cos f) by the errors that wavelengths share.

    The lobes may move up and down, so the weights of a direction sum to about one, and what all points share passes on.
    """
    sources = tuple(
        replace(source, values=source.values[:, bands]) for source in dataset.sources if source.shared_by_wavelengths
    )
    cosine = np.cos(np.radians(dataset.theta_in))[:, None]
    per_brdf = cosine / (offset + np.nan_to_num(np.maximum(dataset.brdf[:, bands], 0.0)) * cosine)
    return variance_of_readings(weights, per_brdf, sources)
