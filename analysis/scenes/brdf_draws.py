"""What a measured BRDF may be instead, for all that its measurement does not know: draws of its errors.

They are errors of the colour that a direction gives to white light. What comes from reading between the points, and
from their noise, is drawn from the covariance of the process that reads, which says how alike it is in neighbouring
directions and at other wavelengths. What wavelengths share is drawn from the sources of the dataset, each with the
spectrum and the points that share it, and passed through the weights of the reading.
"""

import numpy as np
from scipy.linalg import cholesky

from analysis.colour import xyz_weights
from drivers.arrays import FloatArray
from goniometer.datasets.between import Between
from goniometer.datasets.dataset import Dataset
from goniometer.interpolation.kernel import coordinates, covariance, variance

DRAWS = 40
"""Of what the measurement does not know."""

DARKEST = 1e-7
"""BRDF, 1/sr, below which nothing has a logarithm of its own."""

_LARGEST = 1.0
"""Standard deviation of a drawn logarithm: what is less known than that is unknown."""


def drawn_errors(dataset: Dataset, read: Between, seed: int) -> FloatArray:
    """[draws, directions, 3] errors of ln X, ln Y and ln Z of a `dataset` that was `read` between its points.

    Raises `OutOfRange` as `analysis.colour.xyz_weights`.
    """
    random = np.random.default_rng(seed)
    weights = xyz_weights(read.wavelengths)
    share = weights / weights.sum(axis=0)
    cosine = np.cos(np.radians(read.theta_in))[:, None]
    level = np.maximum(read.brdf, DARKEST)
    # the process reads ln(offset + cos f), which in the dark changes less than ln f
    stretch = (1 + read.shape.offset / (cosine * level)) @ share
    of_points = _shared_errors(dataset, read, share, random)
    through = np.einsum("pnm,dpmc->dnc", read.weights, of_points, optimize=True) * stretch
    own = read.u / level
    of_reading = np.einsum("wc,nw,wv,nv,ve->nce", share, own, read.together, own, share, optimize=True)
    values, vectors = np.linalg.eigh(of_reading)
    root = vectors * np.sqrt(np.maximum(values, 0.0))[:, None]
    drawn = np.einsum("nck,dkn->dnc", root, _alike_nearby(read, random)) + through
    return np.asarray(drawn / np.maximum(drawn.std(axis=0) / _LARGEST, 1.0))


def _shared_errors(dataset: Dataset, read: Between, share: FloatArray, random: np.random.Generator) -> FloatArray:
    """[draws, patterns, points, 3] errors of ln(offset + cos f) of the measured points, those that wavelengths share.

    As colours, of the wavelengths of each pattern of the reading.
    """
    cosine = np.cos(np.radians(dataset.theta_in))[:, None]
    per_brdf = cosine / (read.shape.offset + np.nan_to_num(np.maximum(dataset.brdf, 0.0)) * cosine)
    patterns = len(read.weights)
    of_pattern = (read.pattern[:, None] == np.arange(patterns))[:, :, None] * share[:, None]
    found = np.zeros((DRAWS, patterns, dataset.theta_in.size, 3))
    for source in dataset.sources:
        if not source.shared_by_wavelengths:
            continue
        groups = np.arange(dataset.theta_in.size) if source.groups is None else source.groups
        numbers = random.standard_normal((DRAWS, 1, int(groups.max()) + 1, 1))[:, :, groups]
        found += numbers * np.einsum("mw,wpc->pmc", source.values * per_brdf, of_pattern)
    return found


def _alike_nearby(read: Between, random: np.random.Generator) -> FloatArray:
    """[draws, 3, directions] standard normal numbers with the correlation of the process between directions."""
    at = coordinates(read.theta_in, read.theta_out, read.shape.lobe)
    sigma = np.sqrt(variance(at, read.shape.scales))
    correlation = covariance(at, at, read.shape.scales) / np.outer(sigma, sigma)
    correlation[np.diag_indices_from(correlation)] += 1e-6
    factor = cholesky(correlation, lower=True, overwrite_a=True, check_finite=False)
    return np.asarray(random.standard_normal((DRAWS, 3, sigma.size)) @ factor.T)
