"""Where an uncertainty comes from, and which points and wavelengths share the error.

A source of error is one standard normal number, or one for each member of a group, that nobody knows; `values` say
what the BRDF does when it is one. The covariance of anything made from a dataset follows from the sources without a
dense matrix (law of propagation of uncertainty, JCGM 100:2008, 5.2): a sum over the sources, in which errors that are
shared are added before they are squared.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.arrays import FloatArray

Groups = NDArray[np.intp]
"""[points] number, from 0, of the group that a point belongs to."""

PARTS = (
    "random",
    "dark",
    "reference",
    "non-linearity",
    "angle",
    "wavelength",
    "drift",
    "aperture",
    "stray light",
    "footprint",
)
"""The rows of a budget; every source belongs to one of them."""


@dataclass(frozen=True)
class ErrorSource:
    """One source of error."""

    name: str
    """Unique in a dataset, e.g. "reference: certificate"."""
    part: str
    """The row of the budget that it belongs to, one of `PARTS`."""
    values: FloatArray
    """[points, wavelengths] change of the BRDF for one standard uncertainty, signed, 1/sr."""
    groups: Groups | None
    """Points of one group have the same error; None where every point has its own."""
    shared_by_wavelengths: bool
    """Whether all wavelengths of a point have the same error; else each has its own."""


def everywhere(points: int) -> Groups:
    """The groups of an error that all points share."""
    return np.zeros(points, dtype=np.intp)


def combined(sources: tuple[ErrorSource, ...], shape: tuple[int, int]) -> FloatArray:
    """[points, wavelengths] combined standard uncertainty (coverage factor 1) of all `sources`, 1/sr.

    >>> shared, own = np.full((2, 1), 0.03), np.full((2, 1), 0.04)
    >>> lamp = ErrorSource("lamp", "drift", shared, everywhere(2), shared_by_wavelengths=True)
    >>> noise = ErrorSource("noise", "random", own, None, shared_by_wavelengths=False)
    >>> combined((lamp, noise), (2, 1)).round(6).tolist()
    [[0.05], [0.05]]
    """
    return np.asarray(np.sqrt(sum((source.values**2 for source in sources), np.zeros(shape))))


def covariance_by_source(gain: FloatArray, sources: tuple[ErrorSource, ...]) -> dict[str, FloatArray]:
    """[parameters, parameters] covariance that each source gives to what is linear in the BRDF, by its name.

    `gain` [parameters, points, wavelengths] is the derivative of each parameter by each value of the BRDF, zero where
    a value takes no part. The whole covariance is the sum. JCGM 100:2008, 5.2, for errors that are shared.
    """
    return {source.name: _outer(_effects(gain, source)) for source in sources}


def variance(gain: FloatArray, sources: tuple[ErrorSource, ...]) -> FloatArray:
    """[parameters] the diagonal of the sum of `covariance_by_source`, without its other elements."""
    none = np.zeros(gain.shape[0])
    return np.asarray(sum((np.sum(_effects(gain, source) ** 2, axis=(1, 2)) for source in sources), none))


def variance_of_readings(weights: FloatArray, per_brdf: FloatArray, sources: tuple[ErrorSource, ...]) -> FloatArray:
    """[readings, wavelengths] variance of what is read between points, wavelength by wavelength.

    A reading is the sum over points, with `weights` [readings, points], of a function of the BRDF whose derivative is
    `per_brdf` [points, wavelengths]. JCGM 100:2008, 5.2, for errors that points share.
    """
    found = np.zeros((weights.shape[0], per_brdf.shape[1]))
    for source in sources:
        effect = source.values * per_brdf
        if source.groups is None:
            found += weights**2 @ effect**2
            continue
        for group in np.unique(source.groups):
            members = source.groups == group
            found += (weights[:, members] @ effect[members]) ** 2
    return found


def _effects(gain: FloatArray, source: ErrorSource) -> FloatArray:
    """[parameters, groups, wavelengths] what each of the source's independent errors does to the parameters."""
    effect = gain * source.values
    if source.shared_by_wavelengths:
        effect = effect.sum(axis=2, keepdims=True)
    if source.groups is None:
        return np.asarray(effect)
    member = (np.arange(source.groups.max() + 1)[:, None] == source.groups).astype(float)
    return np.asarray(member @ effect)


def _outer(effects: FloatArray) -> FloatArray:
    """[parameters, parameters] products of [parameters, ...], summed over everything else."""
    flat = effects.reshape(effects.shape[0], -1)
    return np.asarray(flat @ flat.T)
