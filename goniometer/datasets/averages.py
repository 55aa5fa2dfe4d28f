"""A dataset averaged over bands of wavelengths, with its sources of error: what the checks look at."""

from typing import NamedTuple

import numpy as np

from drivers.arrays import BoolArray, FloatArray
from goniometer.datasets.dataset import Dataset
from goniometer.uncertainty import ErrorSource


class Averages(NamedTuple):
    """BRDF averaged over bands."""

    values: FloatArray
    """[points, bands] 1/sr; NaN where a point is not usable or has no value somewhere in a band."""
    sources: tuple[ErrorSource, ...]
    """The dataset's, as errors of the averages; zero where these are NaN."""


def middle(wavelengths: FloatArray) -> FloatArray:
    """[wavelengths, 1] weights of one band that leaves out the dim quarter at each end of the spectrum."""
    quarter = wavelengths.size // 4
    inside = np.zeros((wavelengths.size, 1))
    inside[quarter : wavelengths.size - quarter] = 1
    return np.asarray(inside / inside.sum())


def narrow(wavelengths: FloatArray, width: float) -> FloatArray:
    """[wavelengths, bands] weights of neighbouring bands at least `width` nm wide that cover the whole spectrum."""
    count = max(int((wavelengths[-1] - wavelengths[0]) / width), 1)
    edges = np.linspace(wavelengths[0], wavelengths[-1], count + 1)
    number = np.clip(np.searchsorted(edges, wavelengths, side="right") - 1, 0, count - 1)
    inside = (number[:, None] == np.unique(number)).astype(float)
    return np.asarray(inside / inside.sum(axis=0))


def averages(dataset: Dataset, weights: FloatArray) -> Averages:
    """Averages of the usable points with `weights` [wavelengths, bands], each band of which sums to one."""
    known = np.isfinite(dataset.brdf) & dataset.usable[:, None]
    whole = ~known @ (weights > 0) == 0
    values = np.where(known, dataset.brdf, 0.0) @ weights
    sources = tuple(_averaged(source, known, weights, whole) for source in dataset.sources)
    return Averages(np.where(whole, values, np.nan), sources)


def _averaged(source: ErrorSource, known: BoolArray, weights: FloatArray, whole: BoolArray) -> ErrorSource:
    values = np.where(known, source.values, 0.0)
    mean = values @ weights if source.shared_by_wavelengths else np.sqrt(values**2 @ weights**2)
    return ErrorSource(
        source.name, source.part, np.where(whole, mean, 0.0), source.groups, source.shared_by_wavelengths
    )
