"""A fit as it comes back from a file, and its model at any direction and wavelength."""

from dataclasses import dataclass

import numpy as np

from analysis.choices import Distribution, Engine
from analysis.errors import OutOfRange
from analysis.fits.brdf_fit import form_of
from analysis.fits.brdf_problem import log_model
from analysis.fits.global_fit import SLOPE_MODELS, slope_and_derivative
from analysis.reflectance.directions import in_plane
from analysis.reflectance.fresnel import Conductor
from analysis.reflectance.microfacet import aperture_for, brdf, view
from analysis.reflectance.models import normalised_fresnel, shift
from analysis.results import Albedo, Comparison, Parameter, Verdict
from drivers.arrays import FloatArray


@dataclass(frozen=True)
class StoredFit:
    """A fit as it comes back from a file."""

    model: str
    """One of `analysis.choices.MODELS`, "local" excepted."""
    equation: str
    engine: Engine
    distribution: Distribution | None
    """Of the normals; None for a model that has none."""
    parameters: tuple[Parameter, ...]
    correlation: FloatArray
    """[parameters, parameters]"""
    verdict: Verdict
    comparison: Comparison | None
    """With the next simpler model, if there is one."""
    cost: str
    cost_value: float
    independent: float
    """As how many independent ones the residuals count."""
    r2: float
    lambda_n: float
    """Normalisation wavelength, nm."""
    theta_range: tuple[float, float, float, float]
    """Smallest and largest theta_in and theta_out of the fitted points, degrees."""
    wavelength_range: tuple[float, float]
    """nm."""
    clamped_points: int
    """At how many points of the dataset the shift was clamped at zero."""
    sample: str
    dataset_hash: str
    """SHA-256 of the dataset it was fitted to."""
    points: int
    aperture: float
    """Full angle of the detector aperture that the fit took into account, degrees."""
    colour_difference: dict[str, dict[str, float]]
    """Mean, median, p95 and max CIEDE2000, "absolute" and "chromatic"."""
    conductor: Conductor | None
    """None for a model that needs none."""
    albedo: Albedo | None
    """Diffuse albedo of a dielectric."""
    software: str
    """Version that wrote the file."""

    def value(self, name: str) -> float:
        """Value of the parameter called `name`; raises `KeyError`."""
        return {p.name: p.value for p in self.parameters}[name]


def evaluate(fit: StoredFit, theta_in: FloatArray, theta_out: FloatArray, wavelengths: FloatArray) -> FloatArray:
    """Values [points, wavelengths] of a stored model at in-plane directions [points], degrees, and nm.

    1/sr for a microfacet model, without an aperture; for a model of the slopes a pure number, one at lambda_n (Eq. 3).
    Raises `OutOfRange` beyond the conductor's table, or the wavelengths at which the albedo of a dielectric is known.
    """
    directions = in_plane(theta_in, theta_out)
    parameters = np.array([parameter.value for parameter in fit.parameters])
    if fit.model in SLOPE_MODELS:
        own = parameters if fit.conductor is None else parameters[:-1]
        tilt = shift(slope_and_derivative(fit.model, directions, own)[0], wavelengths, fit.lambda_n)
        if fit.conductor is None:
            return tilt
        fresnel = normalised_fresnel(theta_in, wavelengths, fit.conductor, fit.lambda_n)
        return np.asarray(tilt * fresnel ** fit.value("p"))
    form = form_of(fit.model, fit.conductor, fit.distribution or "ggx")
    albedo = None if fit.albedo is None else _albedo_at(fit.albedo, wavelengths)
    return brdf(form, directions, wavelengths, parameters, albedo)


def as_measured(fit: StoredFit, theta_in: FloatArray, theta_out: FloatArray, wavelengths: FloatArray) -> FloatArray:
    """What an instrument with the aperture of the fitted data reads of a microfacet model, 1/sr.

    `theta_in` and `theta_out` [points] in degrees, `wavelengths` [wavelengths] in nm; at all points of its dataset
    together what the fit itself gave, to the last bit. Raises `OutOfRange` for a model of the slopes, which has no
    brightness of its own, and what `evaluate` raises.
    """
    if fit.model in SLOPE_MODELS:
        raise OutOfRange(f"The model {fit.model} tells slopes and no brightness; ask for a microfacet model.")
    form = form_of(fit.model, fit.conductor, fit.distribution or "ggx")
    parameters = np.array([parameter.value for parameter in fit.parameters])
    albedo = None if fit.albedo is None else _albedo_at(fit.albedo, wavelengths)
    seen = view(form, theta_in, theta_out, wavelengths, aperture_for(float(parameters[0]), fit.aperture))
    return np.asarray(np.expm1(log_model(seen, parameters, albedo)) / seen.cos_in)


def _albedo_at(albedo: Albedo, wavelengths: FloatArray) -> FloatArray:
    """[wavelengths] r_d, interpolated linearly."""
    low, high = float(albedo.wavelengths[0]), float(albedo.wavelengths[-1])
    if wavelengths.min() < low or wavelengths.max() > high:
        raise OutOfRange(
            f"The diffuse albedo is known from {low:g} to {high:g} nm, but {wavelengths.min():g} to "
            f"{wavelengths.max():g} nm was asked for; leave the rest out."
        )
    return np.interp(wavelengths, albedo.wavelengths, albedo.values)
