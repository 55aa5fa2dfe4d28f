"""Spectra that Eq. 2 does not describe, and what that does to their slopes and exponents.

A spike, a line, another metal than assumed: the noise of the counts then no longer explains what the fit leaves of a
spectrum. Errors that wavelengths share leave something, too, so only what goes beyond them counts.
"""

import numpy as np

from analysis.fits.misfit import excess
from analysis.reflectance.fresnel import Conductor
from analysis.reflectance.models import normalised_fresnel
from drivers.arrays import BoolArray, FloatArray
from goniometer.datasets.dataset import Dataset

_SMOOTHEST = 0.9
"""Largest autocorrelation that is believed of a few dozen wavelengths."""

USUAL_EXPONENTS = (0.5, 3.0)
"""Exponents p of a metal: 1 for light that it reflected once. The middle one of the simulated samples is 0.97 to 1.03;
of silver, chromium, iron, nickel and gold that are fitted as aluminium it is mostly below 0.3 or above 4."""

_CHANCE = 5.0
"""Standard deviations by which chance alone may raise the chi-square of a spectrum."""


def local_misfit(
    dataset: Dataset,
    fitted: FloatArray,
    parameters: tuple[FloatArray, FloatArray, FloatArray],
    conductor: Conductor | None,
    lambda_n: float,
) -> FloatArray:
    """[2, points] how far the misfit of a spectrum may have moved its slope, 1/um, and its exponent.

    `fitted` [points, wavelengths] are the spectra of a local fit, NaN where there is none, `parameters` its scale,
    slope and exponent, each [points], and `conductor` None for a fit that held the exponents. Zero where the noise of
    the counts explains what is left. Raises `OutOfRange` beyond the conductor's table.
    """
    scale, slope, exponent = parameters
    u = dataset.u_counts
    valid = np.isfinite(dataset.brdf) & np.isfinite(fitted) & (u > 0)
    weight = np.where(valid, 1 / np.where(valid, u, 1.0) ** 2, 0.0)
    residual = np.where(valid, dataset.brdf - fitted, 0.0)
    free = 3 if conductor is not None else 2
    freedom = np.maximum(np.count_nonzero(valid, axis=1) - free, 1)
    chi2 = np.sum(weight * residual**2, axis=1)
    some = chi2 > freedom + _CHANCE * np.sqrt(2 * freedom)
    found = np.zeros((2, some.size))
    if not some.any():
        return found
    columns = _columns(dataset, (scale[some], slope[some], exponent[some]), conductor, lambda_n, some)
    estimator = _estimator(columns, weight[some])
    stated = u[some] ** 2
    for source in dataset.sources:
        if source.shared_by_wavelengths:
            effect = source.values[some]
            stated = stated + (effect - np.einsum("pw,pkw,pkv->pv", effect, estimator, columns)) ** 2
    beyond = np.where(valid[some], excess(residual[some], np.sqrt(stated)), 0.0)
    beyond *= _smoothness(residual[some] * np.sqrt(weight[some]))[:, None]
    of_slope = (estimator[:, 1] - slope[some, None] * estimator[:, 0]) / scale[some, None]
    found[0, some] = np.sum(np.abs(of_slope) * beyond, axis=1)
    if conductor is not None:
        found[1, some] = np.sum(np.abs(estimator[:, 2]) * beyond, axis=1)
    return found


def _smoothness(z: FloatArray) -> FloatArray:
    """[spectra] by how much more of a misfit the three smooth columns of Eq. 2 have absorbed than they have left.

    A spike they leave; of a smooth misfit, whose neighbours `z` [spectra, wavelengths] agree, they absorb more. Taken
    as for a series of that lag-one autocorrelation r: the root of (1 + r) / (1 - r).
    """
    size = np.linalg.norm(z[:, :-1], axis=1) * np.linalg.norm(z[:, 1:], axis=1)
    r = np.clip(np.vecdot(z[:, :-1], z[:, 1:]) / np.where(size > 0, size, 1.0), 0.0, _SMOOTHEST)
    return np.asarray(np.sqrt((1 + r) / (1 - r)))


def doubts_of_metal(conductor: Conductor | None, exponent: FloatArray, u_exponent: FloatArray) -> tuple[str, ...]:
    """What the exponents of reliable spectra, with their uncertainty by all errors, [spectra], say against the metal.

    Light that a metal reflected once has its Fresnel colour once, so p is one, and more where it was reflected more
    often. Each spectrum has a p of its own, and grazing directions one of their own kind, so the middle one is asked.
    """
    known = np.isfinite(u_exponent)
    if conductor is None or not known.any():
        return ()
    middle, u = float(np.median(exponent[known])), float(np.median(u_exponent[known]))
    low, high = USUAL_EXPONENTS
    if low <= middle + 3 * u and middle - 3 * u <= high:
        return ()
    return (
        f"The colour of {conductor.name} does not show in the spectra: the middle one of their exponents p is "
        f"{middle:.2g}, where a metal has {low:g} to {high:g}. Check which metal it is, and whether it is one.",
    )


def _columns(
    dataset: Dataset,
    parameters: tuple[FloatArray, FloatArray, FloatArray],
    conductor: Conductor | None,
    lambda_n: float,
    some: BoolArray,
) -> FloatArray:
    """[spectra, 2 or 3, wavelengths] derivatives of Eq. 2 by a, a m, and p."""
    scale, slope, exponent = parameters
    x = (dataset.wavelengths - lambda_n) * 1e-3
    if conductor is None:
        return np.broadcast_to(np.stack([np.ones_like(x), x]), (scale.size, 2, x.size))
    fresnel = normalised_fresnel(dataset.theta_in[some], dataset.wavelengths, conductor, lambda_n)
    power = fresnel ** exponent[:, None]
    by_exponent = scale[:, None] * (1 + slope[:, None] * x) * np.log(fresnel) * power
    return np.stack([power, x * power, by_exponent], axis=1)


def _estimator(columns: FloatArray, weight: FloatArray) -> FloatArray:
    """[spectra, parameters, wavelengths] derivative of the linear parameters of `columns` by the data."""
    size = np.sqrt(np.sum(weight[:, None] * columns**2, axis=2))
    scaled = columns / np.where(size > 0, size, 1.0)[:, :, None]
    weighted = scaled * weight[:, None]
    inverse = np.linalg.pinv(weighted @ scaled.transpose(0, 2, 1), rcond=1e-12, hermitian=True)
    return np.asarray(inverse @ weighted / np.where(size > 0, size, 1.0)[:, :, None])
