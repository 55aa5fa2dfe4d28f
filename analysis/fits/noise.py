"""Signal against noise: which spectra say something, and which of them the fits leave out."""

import numpy as np

from drivers.arrays import BoolArray, FloatArray
from goniometer.datasets.dataset import IN_FITS, MEANING, Dataset, Flag

LEAST_SIGNAL_FOR_HUE = 20.0
"""Signal over standard uncertainty from the counts below which the hue of a spectrum is noise."""


def at_wavelength(dataset: Dataset, wavelength: float) -> tuple[FloatArray, FloatArray]:
    """BRDF [points] and its combined standard uncertainty (coverage factor 1) at `wavelength`, nm, 1/sr.

    Interpolated between two neighbours; an error that these share does not average out between them.
    """
    return weighted(dataset, *_neighbours(dataset, wavelength))


def weighted(dataset: Dataset, chosen: slice, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Weighted sum of the BRDF over `chosen` wavelengths [points], and its standard uncertainty, 1/sr.

    `weights` are those of the chosen ones; an error that these share does not average out between them.
    """
    value = dataset.brdf[:, chosen] @ weights
    variance = np.zeros(value.size)
    for source in dataset.sources:
        parts = source.values[:, chosen] * weights
        variance += parts.sum(axis=1) ** 2 if source.shared_by_wavelengths else (parts**2).sum(axis=1)
    return value, np.where(np.isfinite(value), np.sqrt(variance), np.nan)


def _neighbours(dataset: Dataset, wavelength: float) -> tuple[slice, FloatArray]:
    """The two wavelengths around `wavelength`, nm, and the share [2] that each has in its value."""
    upper = int(np.clip(np.searchsorted(dataset.wavelengths, wavelength), 1, dataset.wavelengths.size - 1))
    low, high = dataset.wavelengths[upper - 1 : upper + 1]
    share = float(np.clip((wavelength - low) / (high - low), 0, 1))
    return slice(upper - 1, upper + 1), np.array([1 - share, share])


def above_noise(dataset: Dataset) -> BoolArray:
    """[points] whether the median signal of a spectrum exceeds its uncertainty from the counts (coverage factor 1).

    False without values.
    """
    valid = np.isfinite(dataset.brdf) & np.isfinite(dataset.u_counts) & (dataset.u_counts > 0)
    some = valid.any(axis=1)
    ratio = np.full(dataset.brdf.shape, np.nan)
    np.divide(dataset.brdf, dataset.u_counts, out=ratio, where=valid)
    result = np.zeros(some.size, dtype=bool)
    result[some] = np.nanmedian(ratio[some], axis=1) >= 1
    return result


def clear_of_noise(dataset: Dataset, wavelength: float, times: float) -> BoolArray:
    """[points] whether the BRDF at `wavelength`, nm, exceeds so many `times` its uncertainty from the counts."""
    pair, share = _neighbours(dataset, wavelength)
    u_counts = np.linalg.norm(dataset.u_counts[:, pair] * share, axis=1)
    return np.asarray(dataset.brdf[:, pair] @ share > times * u_counts)


def hue_is_known(dataset: Dataset, wavelength: float) -> BoolArray:
    """[points] whether a spectrum stands clear of its noise at `wavelength`, nm; elsewhere its hue is noise."""
    return clear_of_noise(dataset, wavelength, LEAST_SIGNAL_FOR_HUE)


def flag_words(flags: int) -> str:
    """The bits of a point's flags in words, joined by commas; empty for a point without a flag."""
    return ", ".join(MEANING[flag] for flag in Flag if flags & flag)


def flag_sentences(dataset: Dataset) -> tuple[str, ...]:
    """What the flags do to the fits, one sentence for each flag that occurs."""
    sentences = []
    for flag in Flag:
        count, total = int(dataset.flagged(flag).sum()), dataset.flags.size
        if count:
            sentences.append(f"{count} of {total} points are {IN_FITS[flag]}: {MEANING[flag]}.")
    return tuple(sentences)
