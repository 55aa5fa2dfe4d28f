"""Signal against noise: which spectra say something."""

import numpy as np

from drivers.arrays import BoolArray, FloatArray
from goniometer.dataset import Dataset

LEAST_SIGNAL_FOR_HUE = 20.0
"""Signal over standard uncertainty below which the hue of a spectrum is noise."""


def at_wavelength(dataset: Dataset, wavelength: float) -> tuple[FloatArray, FloatArray]:
    """BRDF [points] and its standard uncertainty at `wavelength`, nm, interpolated between two neighbours, 1/sr."""
    upper = int(np.clip(np.searchsorted(dataset.wavelengths, wavelength), 1, dataset.wavelengths.size - 1))
    low, high = dataset.wavelengths[upper - 1 : upper + 1]
    part = np.clip((wavelength - low) / (high - low), 0, 1)
    value = (1 - part) * dataset.brdf[:, upper - 1] + part * dataset.brdf[:, upper]
    u = np.hypot((1 - part) * dataset.u[:, upper - 1], part * dataset.u[:, upper])
    return value, u


def above_noise(dataset: Dataset) -> BoolArray:
    """[points] whether the median signal of a spectrum exceeds its standard uncertainty; False without values."""
    valid = np.isfinite(dataset.brdf) & np.isfinite(dataset.u) & (dataset.u > 0)
    some = valid.any(axis=1)
    ratio = np.full(dataset.brdf.shape, np.nan)
    np.divide(dataset.brdf, dataset.u, out=ratio, where=valid)
    result = np.zeros(some.size, dtype=bool)
    result[some] = np.nanmedian(ratio[some], axis=1) >= 1
    return result


def hue_is_known(dataset: Dataset, wavelength: float) -> BoolArray:
    """[points] whether a spectrum stands clear of its noise at `wavelength`, nm; elsewhere its hue is noise."""
    value, u = at_wavelength(dataset, wavelength)
    return np.asarray(value > LEAST_SIGNAL_FOR_HUE * u)
