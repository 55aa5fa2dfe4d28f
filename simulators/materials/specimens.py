"""Surfaces of known parameters: what a fitted model describes exactly, and what departs from it in one way.

Here a model is computed as an ideal bench would see it: through the aperture, with the Fresnel reflectance changing
within it, by other code than that of the fits (`simulators.materials.surfaces.over_aperture`).
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from analysis.choices import Distribution
from analysis.reflectance.directions import Aperture, Directions, in_plane, round_aperture, through_aperture
from analysis.reflectance.distributions import lobe
from analysis.reflectance.fresnel import fresnel_conductor, fresnel_dielectric, load_conductor
from analysis.reflectance.models import LAMBDA_N, normalised_fresnel
from analysis.reflectance.two_component import two_component_slope
from drivers.arrays import FloatArray
from simulators.materials.surfaces import Reflectance, Surface, over_aperture, surface_brdf

Law = Literal["spectra", "metal", "dielectric"]
"""Eq. 3 of the paper with a lobe for its scale, Eq. 7, or Eq. 8."""

_NOTCH = 15.0
"""Standard deviation of the absorption line, nm."""


@dataclass(frozen=True)
class Shift:
    """Slope of the shift; a cosine where kappa and sharpness are zero, see `analysis.reflectance.two_component`."""

    h: float = 0.0
    w: float = 1.0
    t_y: float = 0.0
    kappa: float = 0.0
    sharpness: float = 0.0
    threshold: float = 0.0

    def slope(self, directions: Directions) -> FloatArray:
        """[...] 1/um; raises `OutOfRange` for a negative sharpness."""
        return two_component_slope(directions, self.h, self.w, self.t_y, self.kappa, self.sharpness, self.threshold)


@dataclass(frozen=True)
class Retro:
    """A Gaussian lobe on the way back into the lamp, which no model has: coloured as the surface, not shifted."""

    height: float
    """1/sr."""
    width: float
    """Full width at half maximum, degrees of theta_out."""

    def values(self, theta_in: FloatArray, theta_out: FloatArray) -> FloatArray:
        """[points] at lambda_n, 1/sr."""
        return np.asarray(self.height * np.exp(-4 * np.log(2) * ((theta_out + theta_in) / self.width) ** 2))


@dataclass(frozen=True)
class Specimen:
    """A surface that a model describes, and what departs from it."""

    law: Law
    shift: Shift
    alpha: float = 0.18
    exponent: float = 1.3
    """p of Eq. 3; of "spectra" alone."""
    eta: float = 1.5
    """Refractive index of a dielectric."""
    conductor: str = "main/Al/Cheng"
    """Of refractiveindex.info."""
    distribution: Distribution = "ggx"
    retro: Retro | None = None
    notch: float = 0.0
    """Share of the light that an absorption line takes at lambda_n, which no model has."""


def albedo(wavelengths: FloatArray) -> FloatArray:
    """[wavelengths] diffuse albedo of the dielectric: a dark brown, 0.02 in the blue and 0.06 in the red."""
    return np.asarray(0.04 + 0.02 * np.tanh((wavelengths - 600) / 80))


def specimen_brdf(
    specimen: Specimen | Surface,
    theta_in: FloatArray,
    theta_out: FloatArray,
    wavelengths: FloatArray,
    aperture: float,
) -> FloatArray:
    """[points, wavelengths] BRDF averaged over a round `aperture`, full angle in degrees, 1/sr.

    Raises `OutOfRange` for wavelengths, nm, beyond the conductor's table.
    """
    narrow = specimen.alpha < 0.05  # against a degree
    rule = round_aperture(aperture, rings=24, spokes=96) if narrow else round_aperture(aperture)
    value = np.concatenate(
        [
            _through(specimen, some_in, some_out, wavelengths, rule)
            for some_in, some_out in zip(
                *(np.array_split(a, 1 + a.size // 16) for a in (theta_in, theta_out)), strict=True
            )
        ]
    )
    if isinstance(specimen, Surface):
        return value
    if specimen.retro is not None:
        value = value + specimen.retro.values(theta_in, theta_out)[:, None] * _colour(specimen, theta_in, wavelengths)
    return np.asarray(value * (1 - specimen.notch * np.exp(-0.5 * ((wavelengths - LAMBDA_N) / _NOTCH) ** 2)))


def slopes(specimen: Specimen, theta_in: FloatArray, theta_out: FloatArray) -> FloatArray:
    """[points] slope of the shift of all light together, 1/um, as Eq. 2 defines it.

    Of a specimen of the law "spectra".
    """
    seen = in_plane(theta_in, theta_out)
    shifted = lobe(seen, specimen.alpha, specimen.distribution)
    back = 0.0 if specimen.retro is None else specimen.retro.values(theta_in, theta_out)
    return np.asarray(specimen.shift.slope(seen) * shifted / (shifted + back))


def _colour(specimen: Specimen, theta_in: FloatArray, wavelengths: FloatArray) -> FloatArray:
    """[points, wavelengths] of the surface's reflectance, one at lambda_n."""
    if specimen.law == "dielectric":
        return np.ones((theta_in.size, wavelengths.size))
    metal = load_conductor(*specimen.conductor.split("/"))
    exponent = specimen.exponent if specimen.law == "spectra" else 1.0
    return np.asarray(normalised_fresnel(theta_in, wavelengths, metal, LAMBDA_N) ** exponent)


def _through(
    specimen: Specimen | Surface,
    theta_in: FloatArray,
    theta_out: FloatArray,
    wavelengths: FloatArray,
    rule: Aperture,
) -> FloatArray:
    if isinstance(specimen, Surface):
        index = load_conductor().index(wavelengths)
        return surface_brdf(specimen, theta_in, theta_out, wavelengths, index, rule)
    directions = through_aperture(theta_in, theta_out, rule)
    weight = lobe(directions, specimen.alpha, specimen.distribution) * rule.weights
    metal = load_conductor(*specimen.conductor.split("/"))
    if specimen.law == "spectra":
        # Eq. 3 knows one direction of a point
        slope = specimen.shift.slope(in_plane(theta_in, theta_out))[:, None]
        tilt = 1 + slope * (wavelengths - LAMBDA_N) * 1e-3
        return np.asarray(weight.sum(axis=1, keepdims=True) * tilt * _colour(specimen, theta_in, wavelengths))
    reflectance: Reflectance = lambda cosine: fresnel_conductor(cosine, *metal.index(wavelengths))  # noqa: E731
    if specimen.law == "dielectric":
        reflectance = lambda cosine: fresnel_dielectric(cosine, specimen.eta)  # noqa: E731
    value = over_aperture(directions, weight, specimen.shift.slope(directions), reflectance, wavelengths)
    if specimen.law == "dielectric":
        above = (directions.cos_i > 0) & (directions.cos_o > 0)
        value = value + (above @ rule.weights)[:, None] * albedo(wavelengths) / np.pi
    return value
