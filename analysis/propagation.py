"""How the uncertainty of a measurement passes through a linear estimator.

Near its solution every least-squares fit is linear: d(parameter) = sum over points and wavelengths of
gain * d(data). What matters is which errors are shared, and by which points (law of propagation of
uncertainty, JCGM 100:2008, 5.2).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.arrays import BoolArray, FloatArray
from goniometer.dataset import Dataset

SAME_INCIDENCE = 0.05
"""Read-back incident angles closer than this belong to one position of the sample stage, degrees."""

Groups = NDArray[np.intp]
"""[points] number, from 0, of the group that a point belongs to."""


class ErrorSource(NamedTuple):
    """One source of error: its standard uncertainty as a change of the data, and who shares the error."""

    values: FloatArray
    """[points, wavelengths]"""
    groups: Groups | None
    """Points of one group have the same error; None where every point has its own."""
    shared_by_wavelengths: bool
    """Whether all wavelengths of a point have the same error."""


def counting_errors(dataset: Dataset, points: BoolArray, factor: FloatArray | float = 1.0) -> dict[str, ErrorSource]:
    """What the noise of counts, of the sample's scan and of the reference's, does to data = `factor` x BRDF.

    `points` [all points] says which points to take; `factor` [points, wavelengths] is the derivative of a datum by
    the BRDF. Values that do not exist count as free of error, as nothing is fitted to them.
    """
    _, times = np.unique(dataset.integration_time[points], return_inverse=True)
    together = np.zeros_like(times)
    incidence = incidence_groups(dataset.theta_in[points])
    shared = {"random": None, "dark": times, "reference": incidence, "reference_dark": together}
    return {
        name: ErrorSource(factor * np.nan_to_num(getattr(dataset, f"u_{name}")[points]), groups, False)
        for name, groups in shared.items()
    }


def incidence_groups(theta_in: FloatArray) -> Groups:
    """[points] number, from 0, of the incident angle that a point belongs to; `theta_in` in degrees.

    Angles are as read back, so neighbours within 0.05 degrees are one position of the stage.
    """
    order = np.argsort(theta_in, kind="stable")
    groups = np.empty(theta_in.size, dtype=np.intp)
    groups[order] = np.concatenate([[0], np.cumsum(np.diff(theta_in[order]) > SAME_INCIDENCE)])
    return groups


def _shared(values: FloatArray, groups: Groups) -> FloatArray:
    """[parameters, ..., groups] sums of [parameters, points, ...] over the points of each group."""
    member = groups[:, None] == np.arange(groups.max() + 1)
    return np.tensordot(values, member.astype(float), axes=(1, 0))


def _outer(values: FloatArray) -> FloatArray:
    """[parameters, parameters] products of [parameters, ...], summed over everything else."""
    flat = values.reshape(values.shape[0], -1)
    return np.asarray(flat @ flat.T)


def covariance_by_source(gain: FloatArray, errors: dict[str, ErrorSource]) -> dict[str, FloatArray]:
    """[parameters, parameters] covariance that each source gives, by its name.

    `gain` is [parameters, points, wavelengths]: derivative of each parameter by each datum, zero where a datum
    was left out. The covariance of the fit is their sum.
    """
    found = {}
    for name, source in errors.items():
        effect = gain * source.values
        if source.shared_by_wavelengths:
            effect = effect.sum(axis=-1, keepdims=True)
        found[name] = _outer(effect if source.groups is None else _shared(effect, source.groups))
    return found


def correlation(covariance: FloatArray) -> FloatArray:
    """[n, n] correlation of a covariance; a parameter without a finite variance is correlated with nothing."""
    sigma = np.sqrt(np.diag(covariance))
    known = np.isfinite(sigma) & (sigma > 0)
    result = np.eye(sigma.size)
    both = np.outer(known, known)
    result[both] = (covariance[both]) / np.outer(sigma, sigma)[both]
    return result
