"""Löw's cost of a microfacet model against a measurement, as a sum of squares that an engine can minimise.

Parameters are those of `Form.quantities`, alpha by its logarithm. The diffuse albedo of a dielectric is eliminated by
variable projection (Golub & Pereyra 1973, with Kaufman's 1975 step): at every evaluation the best one is found, and
what it could make up for is taken out of the derivatives.
"""

import math
from typing import NamedTuple

import numpy as np

from analysis.fits.least_squares import SumOfSquares
from analysis.fits.loew import LoewData
from analysis.reflectance.microfacet import View, best_albedo
from drivers.arrays import FloatArray


def to_search(parameters: FloatArray) -> FloatArray:
    """Parameters as the engines vary them: the logarithm of alpha, all others as they are."""
    return np.concatenate([[math.log(parameters[0])], parameters[1:]])


def from_search(searched: FloatArray) -> FloatArray:
    """Inverse of `to_search`."""
    return np.concatenate([[math.exp(searched[0])], searched[1:]])


class Linearised(NamedTuple):
    """The weighted residuals near given parameters."""

    residual: FloatArray
    """[points, wavelengths] model minus measured, weighted."""
    jacobian: FloatArray
    """[parameters, points, wavelengths] weighted, by log alpha and the other parameters; what a dielectric's albedo
    makes up for is taken out."""
    albedo: FloatArray | None
    """[wavelengths]; None for a conductor."""
    by_albedo: FloatArray
    """[points, wavelengths] derivative of the residual by the albedo of its wavelength; zero where that is zero, and
    for a conductor."""
    full_jacobian: FloatArray
    """[parameters, points, wavelengths] with the albedo held."""


def log_model(seen: View, parameters: FloatArray, albedo: FloatArray | None) -> FloatArray:
    """[points, wavelengths] ln(1 + cos(theta_in) f)."""
    value = seen.surface(parameters)
    return np.asarray(np.log1p(value if albedo is None else value + seen.cos_in / math.pi * albedo))


def weighted_residual(seen: View, data: LoewData, parameters: FloatArray) -> tuple[FloatArray, FloatArray | None]:
    """Weighted residuals [points, wavelengths] and the best albedo of a dielectric."""
    surface, albedo = seen.surface(parameters), None
    if seen.form.conductor is None:
        albedo = best_albedo(surface, seen.cos_in, data.log_measured, data.root_weight)
        surface = surface + seen.cos_in / math.pi * albedo
    return data.root_weight * (np.log1p(surface) - data.log_measured), albedo


def linearise(seen: View, data: LoewData, parameters: FloatArray) -> Linearised:
    """Residuals and derivatives at `parameters`."""
    value, jacobian = seen.surface_derivative(parameters)
    jacobian[0] *= parameters[0]
    if seen.form.conductor is not None:
        jacobian *= data.root_weight / (1 + value)
        residual = data.root_weight * (np.log1p(value) - data.log_measured)
        return Linearised(residual, jacobian, None, np.zeros_like(residual), jacobian)
    albedo = best_albedo(value, seen.cos_in, data.log_measured, data.root_weight)
    value = value + seen.cos_in / math.pi * albedo
    root = data.root_weight / (1 + value)
    jacobian *= root
    by_albedo = np.where(albedo > 0, root * seen.cos_in / math.pi, 0.0)
    size = np.sum(by_albedo**2, axis=0)
    share = np.einsum("kpw,pw->kw", jacobian, by_albedo) / np.where(size > 0, size, 1.0)
    projected = jacobian - share[:, None, :] * by_albedo
    return Linearised(data.root_weight * (np.log1p(value) - data.log_measured), projected, albedo, by_albedo, jacobian)


def problem(seen: View, data: LoewData) -> SumOfSquares:
    """The cost for an engine; parameters as `to_search` gives them."""
    quantities = seen.form.quantities

    def residual(searched: FloatArray) -> FloatArray:
        return weighted_residual(seen, data, from_search(searched))[0].ravel()

    def linearised(searched: FloatArray) -> tuple[FloatArray, FloatArray]:
        near = linearise(seen, data, from_search(searched))
        return near.residual.ravel(), near.jacobian.reshape(len(quantities), -1)

    return SumOfSquares(
        residual,
        linearised,
        lower=to_search(np.array([quantity.lower for quantity in quantities])),
        upper=to_search(np.array([quantity.upper for quantity in quantities])),
    )
