"""Reflectance distributions: the BRDF over the reflected angle, one curve an incident angle."""

import numpy as np

from analysis.colour import xyz_weights
from analysis.figures.filled import at_nearest
from analysis.fits.noise import at_wavelength, weighted
from api.bodies.base import numbers
from api.bodies.plots import Distribution, Distributions, FilledCurve
from api.views.opened import Opened
from drivers.arrays import FloatArray
from goniometer.datasets.angular import SAME_INCIDENCE, incidence_groups
from goniometer.datasets.budget import COVERAGE_FACTOR, nearest_wavelength
from goniometer.datasets.dataset import Dataset
from goniometer.datasets.fill import Filled


def distributions(opened: Opened, wavelength: float | None, filled: Filled | None) -> Distributions:
    """The BRDF at a wavelength, nm, or its luminance under D65 for None, with what is `filled` at a wavelength.

    Raises `InputError` for a wavelength beyond those measured, and `OutOfRange` where a luminance needs more of them.
    """
    dataset = opened.dataset
    if wavelength is None:
        f, u = _luminous(dataset)
    else:
        nearest_wavelength(dataset, wavelength)
        f, u = at_wavelength(dataset, wavelength)
    groups = incidence_groups(dataset.theta_in, SAME_INCIDENCE)
    return Distributions(
        dataset=opened.entry.id,
        wavelength_nm=wavelength,
        coverage_factor=COVERAGE_FACTOR,
        curves=[
            _curve(dataset, np.flatnonzero(groups == g), f, u, wavelength, filled) for g in range(int(groups.max()) + 1)
        ],
    )


def _curve(
    dataset: Dataset, members: np.ndarray, f: FloatArray, u: FloatArray, wavelength: float | None, filled: Filled | None
) -> Distribution:
    order = members[np.argsort(dataset.theta_out[members], kind="stable")]
    angle, value = float(dataset.theta_in[members].mean()), f[order]
    positive = np.where(value > 0, value, np.nan)
    return Distribution(
        theta_in_deg=angle,
        points=order.tolist(),
        theta_out_deg=dataset.theta_out[order].tolist(),
        brdf=numbers(value),
        u=numbers(u[order]),
        log10_brdf=numbers(np.log10(positive)),
        filled=None if filled is None or wavelength is None else _filled(filled, angle, wavelength),
    )


def _filled(filled: Filled, angle: float, wavelength: float) -> FilledCurve:
    f, u = at_nearest(filled, wavelength)
    chosen = np.flatnonzero((np.abs(filled.theta_in - angle) < SAME_INCIDENCE) & filled.tells)
    chosen = chosen[np.argsort(filled.theta_out[chosen])]
    return FilledCurve(theta_out_deg=filled.theta_out[chosen].tolist(), brdf=numbers(f[chosen]), u=numbers(u[chosen]))


def _luminous(dataset: Dataset) -> tuple[FloatArray, FloatArray]:
    """The BRDF for light of D65 as the eye weighs it [points], and its standard uncertainty, 1/sr."""
    weights = xyz_weights(dataset.wavelengths)[:, 1]
    seen = np.flatnonzero(weights != 0)
    return weighted(dataset, slice(int(seen[0]), int(seen[-1]) + 1), weights[seen[0] : seen[-1] + 1])
