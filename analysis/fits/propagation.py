"""How the uncertainty of a measurement passes through a linear estimator.

Near its solution every least-squares fit is linear: d(parameter) = sum over points and wavelengths of
gain * d(data). What matters is which errors are shared, and by which points (law of propagation of
uncertainty, JCGM 100:2008, 5.2).
"""

import numpy as np

from drivers.arrays import BoolArray, FloatArray
from goniometer.datasets.dataset import Dataset
from goniometer.uncertainty import PARTS, ErrorSource, covariance_by_source


def errors_of_data(dataset: Dataset, points: BoolArray, factor: FloatArray) -> tuple[ErrorSource, ...]:
    """The dataset's sources at some points, as errors of data = `factor` x BRDF.

    `points` [all points] says which points to take; `factor` [points, wavelengths] is the derivative of a datum by
    the BRDF.
    """
    return tuple(
        ErrorSource(
            source.name,
            source.part,
            factor * source.values[points],
            None if source.groups is None else source.groups[points],
            source.shared_by_wavelengths,
        )
        for source in dataset.sources
    )


def covariance_by_part(gain: FloatArray, sources: tuple[ErrorSource, ...]) -> dict[str, FloatArray]:
    """[parameters, parameters] covariance that each part of the budget gives, in the order of `PARTS`.

    `gain` as in `covariance_by_source`; parts without a source are absent.
    """
    by_source = covariance_by_source(gain, sources)
    part_of = {source.name: source.part for source in sources}
    found: dict[str, FloatArray] = {}
    for part in PARTS:
        members = [covariance for name, covariance in by_source.items() if part_of[name] == part]
        if members:
            found[part] = np.sum(members, axis=0)
    return found


def variance_of_each_point(gain: FloatArray, sources: tuple[ErrorSource, ...]) -> FloatArray:
    """[points] variance of a quantity that every point has for itself, by all `sources`.

    `gain` [points, wavelengths] is its derivative by the data of its own point.
    """
    variance = np.zeros(gain.shape[0])
    for source in sources:
        effect = gain * source.values
        variance += effect.sum(axis=-1) ** 2 if source.shared_by_wavelengths else (effect**2).sum(axis=-1)
    return variance


def errors_by_part(by_part: dict[str, FloatArray], parameter: int, inflation: float = 1.0) -> dict[str, float]:
    """Standard error that each part gives to one parameter, from `covariance_by_part`, times `inflation`."""
    return {part: inflation * float(np.sqrt(covariance[parameter, parameter])) for part, covariance in by_part.items()}


def correlation(covariance: FloatArray) -> FloatArray:
    """[n, n] correlation of a covariance; a parameter without a finite variance is correlated with nothing."""
    sigma = np.sqrt(np.diag(covariance))
    known = np.isfinite(sigma) & (sigma > 0)
    result = np.eye(sigma.size)
    both = np.outer(known, known)
    result[both] = (covariance[both]) / np.outer(sigma, sigma)[both]
    return result
