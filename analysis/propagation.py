"""How the uncertainty of a measurement passes through a linear estimator.

Near its solution every least-squares fit is linear: d(parameter) = sum over points and wavelengths of
gain * d(data). What matters is which errors are shared, and by which points (law of propagation of
uncertainty, JCGM 100:2008, 5.2).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.arrays import FloatArray

SAME_INCIDENCE = 0.05
"""Read-back incident angles closer than this belong to one position of the sample stage, degrees."""


class ErrorSources(NamedTuple):
    """One standard uncertainty of every source of error, as a change of the data; all [points, wavelengths]."""

    random: FloatArray
    """Independent everywhere."""
    reference: FloatArray
    """Independent between wavelengths, shared by the points of one incident angle."""
    detector_stage: FloatArray
    """Independent between points, shared by the wavelengths of a point."""
    sample_stage: FloatArray
    """Shared by the wavelengths and points of one incident angle."""


def incidence_groups(theta_in: FloatArray) -> NDArray[np.intp]:
    """[points] number, from 0, of the incident angle that a point belongs to; `theta_in` in degrees.

    Angles are as read back, so neighbours within 0.05 degrees are one position of the stage.
    """
    order = np.argsort(theta_in, kind="stable")
    groups = np.empty(theta_in.size, dtype=np.intp)
    groups[order] = np.concatenate([[0], np.cumsum(np.diff(theta_in[order]) > SAME_INCIDENCE)])
    return groups


def _shared(values: FloatArray, groups: NDArray[np.intp]) -> FloatArray:
    """[parameters, ..., groups] sums of [parameters, points, ...] over the points of each group."""
    member = groups[:, None] == np.arange(groups.max() + 1)
    return np.tensordot(values, member.astype(float), axes=(1, 0))


def _outer(values: FloatArray) -> FloatArray:
    """[parameters, parameters] products of [parameters, ...], summed over everything else."""
    flat = values.reshape(values.shape[0], -1)
    return np.asarray(flat @ flat.T)


def covariance_by_source(gain: FloatArray, errors: ErrorSources, groups: NDArray[np.intp]) -> dict[str, FloatArray]:
    """[parameters, parameters] covariance that each source gives, by its name in `ErrorSources`.

    `gain` is [parameters, points, wavelengths]: derivative of each parameter by each datum, zero where a datum
    was left out. `groups` as `incidence_groups`. The covariance of the fit is their sum.
    """
    return {
        "random": _outer(gain * errors.random),
        "reference": _outer(_shared(gain * errors.reference, groups)),
        "detector_stage": _outer((gain * errors.detector_stage).sum(axis=-1)),
        "sample_stage": _outer(_shared((gain * errors.sample_stage).sum(axis=-1), groups)),
    }


def correlation(covariance: FloatArray) -> FloatArray:
    """[n, n] correlation of a covariance; a parameter without a finite variance is correlated with nothing."""
    sigma = np.sqrt(np.diag(covariance))
    known = np.isfinite(sigma) & (sigma > 0)
    result = np.eye(sigma.size)
    both = np.outer(known, known)
    result[both] = (covariance[both]) / np.outer(sigma, sigma)[both]
    return result
