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
    """[points, wavelengths] combined standard uncertainty (coverage factor 1) of all `sources`, 1/sr."""
    return np.asarray(np.sqrt(sum((source.values**2 for source in sources), np.zeros(shape))))
