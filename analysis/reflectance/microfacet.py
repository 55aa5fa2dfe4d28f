"""Every microfacet model as its fit sees it: one array of parameters, read through the aperture, with derivatives.

What directions and wavelengths give is computed once, so that many parameters can be tried on them quickly
(`analysis.reflectance.models.microfacet` does that). A dielectric has a diffuse albedo r_d besides, one number a
wavelength, which is not among the parameters: for given ones the best albedo that is not negative is found directly.
"""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from analysis.choices import Distribution
from analysis.reflectance.directions import Aperture, Directions, in_plane, round_aperture, through_aperture
from analysis.reflectance.distributions import lobe_width
from analysis.reflectance.fresnel import Conductor, fresnel_conductor, fresnel_dielectric, fresnel_dielectric_derivative
from analysis.reflectance.models import (
    constant,
    cosine_slope,
    cosine_slope_derivative,
    microfacet,
    microfacet_derivative,
    theta_m,
)
from analysis.reflectance.two_component import two_component_slope, two_component_slope_derivative
from drivers.arrays import FloatArray

Shift = Literal["none", "cosine", "two-component"]

LARGEST_W = 12.0
"""Up to which w is searched."""

ETA_BOUNDS = (1.001, 4.0)
"""Between which the refractive index of a dielectric is searched."""

_ALBEDO_STEPS = 30
_ALBEDO_TOLERANCE = 1e-11


@dataclass(frozen=True)
class Quantity:
    """A parameter of a model."""

    name: str
    unit: str
    lower: float
    """Bounds between which it is searched."""
    upper: float
    known_to: float
    """Standard uncertainty up to which a value is of use,"""
    known_to_share: float
    """and the share of the value that is added to it."""

    def useful(self, value: float) -> float:
        """Standard uncertainty up to which `value` is of use."""
        return self.known_to + self.known_to_share * abs(value)


_ALPHA = Quantity("alpha", "1", 1e-4, 3.0, 0.0, 0.1)
_ETA = Quantity("eta", "1", *ETA_BOUNDS, 0.1, 0.0)
_H = Quantity("h", "1/um", -math.inf, math.inf, 0.1, 0.33)
_W = Quantity("w", "1", 0.0, LARGEST_W, 0.0, 0.33)
_SHIFTS: dict[Shift, tuple[Quantity, ...]] = {
    "none": (),
    "cosine": (_H, _W),
    "two-component": (
        _H,
        _W,
        Quantity("t_y", "1/um", -math.inf, math.inf, 0.3, 0.0),
        Quantity("kappa", "1", -5.0, 5.0, 0.3, 0.33),
        Quantity("sharpness", "1", 0.0, 100.0, 1.0, 0.5),
        Quantity("threshold", "1", -3.0, 3.0, 0.3, 0.33),
    ),
}


@dataclass(frozen=True)
class Form:
    """Which microfacet model: the surface, its shift and its distribution of normals."""

    conductor: Conductor | None
    """None for a dielectric, which has a refractive index eta and a diffuse albedo of its own."""
    shift: Shift
    distribution: Distribution = "ggx"

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """Of all parameters, in the order in which they are fitted."""
        return (_ALPHA, *(() if self.conductor else (_ETA,)), *_SHIFTS[self.shift])

    @property
    def first_of_shift(self) -> int:
        """Index of h."""
        return 1 if self.conductor else 2


@dataclass(frozen=True)
class View:
    """All that a model needs to know of directions and wavelengths, computed once for many parameters.

    Parameters are an array [parameters] in the order of `Form.quantities`.
    """

    form: Form
    cos_in: FloatArray
    """[points, 1] of the irradiance."""
    directions: Directions
    """[points, nodes] through the aperture."""
    weights: FloatArray
    """[nodes]"""
    cos_d: FloatArray
    """[points, 1] incident direction to half vector, at the centre of the aperture."""
    fresnel: FloatArray
    """[points, wavelengths] of a conductor; [points, 0] for a dielectric."""
    wavelengths: FloatArray
    """[wavelengths] nm."""

    def surface(self, parameters: FloatArray) -> FloatArray:
        """[points, wavelengths] cos(theta_in) f of the surface alone, 1/sr.

        Raises `OutOfRange` for a dielectric's index below one and for a negative sharpness.
        """
        fresnel, slope = self.fresnel, None
        if self.form.conductor is None:
            fresnel = fresnel_dielectric(self.cos_d, float(parameters[1]))
        if self.form.shift != "none":
            slope = slope_of(self.form, self.directions, parameters)
        value = microfacet(
            self.directions,
            self.wavelengths,
            float(parameters[0]),
            fresnel,
            slope,
            self.form.distribution,
            self.weights,
        )
        return np.asarray(self.cos_in * value)

    def surface_derivative(self, parameters: FloatArray) -> tuple[FloatArray, FloatArray]:
        """`surface` and its derivatives by the parameters, [parameters, points, wavelengths]; raises as `surface`."""
        fresnel = constant(self.fresnel)
        if self.form.conductor is None:
            reflectance, by_eta = fresnel_dielectric_derivative(self.cos_d, float(parameters[1]))
            fresnel = reflectance, by_eta[None]
        value, jacobian = microfacet_derivative(
            self.directions,
            self.wavelengths,
            float(parameters[0]),
            fresnel,
            slope_derivative(self.form, self.directions, parameters),
            self.form.distribution,
            self.weights,
        )
        return self.cos_in * value, self.cos_in * jacobian


def brdf(
    form: Form,
    directions: Directions,
    wavelengths: FloatArray,
    parameters: FloatArray,
    albedo: FloatArray | None = None,
) -> FloatArray:
    """The model at `directions` [...] without an aperture, 1/sr, [..., wavelengths]; `albedo` [wavelengths].

    Raises `OutOfRange` for wavelengths, nm, beyond the conductor's table, a dielectric's index below one and a negative
    sharpness.
    """
    if form.conductor is None:
        fresnel = fresnel_dielectric(directions.cos_d[..., None], float(parameters[1]))
    else:
        fresnel = fresnel_conductor(directions.cos_d[..., None], *form.conductor.index(wavelengths))
    slope = None if form.shift == "none" else slope_of(form, directions, parameters)
    surface = microfacet(directions, wavelengths, float(parameters[0]), fresnel, slope, form.distribution)
    if albedo is None:
        return surface
    above = (directions.cos_i > 0) & (directions.cos_o > 0)
    return np.asarray(surface + above[..., None] * albedo / math.pi)


def slope_of(form: Form, directions: Directions, parameters: FloatArray) -> FloatArray:
    """Slope of the shift at `directions` [...], 1/um; zero for a model without shift.

    Raises `OutOfRange` for a negative sharpness.
    """
    own = [float(value) for value in parameters[form.first_of_shift :]]
    if form.shift == "none":
        return np.zeros_like(directions.cos_m)
    if form.shift == "two-component":
        return two_component_slope(directions, *own)
    return cosine_slope(theta_m(directions), *own)


def slope_derivative(form: Form, directions: Directions, parameters: FloatArray) -> tuple[FloatArray, FloatArray]:
    """`slope_of` and its derivatives by the parameters of the shift, [parameters of the shift, ...].

    Raises as `slope_of`.
    """
    own = [float(value) for value in parameters[form.first_of_shift :]]
    if form.shift == "none":
        return constant(np.zeros_like(directions.cos_m))
    if form.shift == "two-component":
        return two_component_slope_derivative(directions, *own)
    slope, by_h_w_t = cosine_slope_derivative(theta_m(directions), *own)
    return slope, by_h_w_t[:2]


def view(form: Form, theta_in: FloatArray, theta_out: FloatArray, wavelengths: FloatArray, aperture: Aperture) -> View:
    """What `form` needs of directions [points], degrees, and wavelengths, nm.

    In plane the two halves of the aperture see the same, so one is enough. Raises `OutOfRange` for wavelengths beyond
    the conductor's table.
    """
    half = aperture.sideways > 0
    if 2 * np.count_nonzero(half) == half.size:
        aperture = Aperture(aperture.along[half], aperture.sideways[half], 2 * aperture.weights[half])
    centre = in_plane(theta_in, theta_out)
    fresnel = np.empty((theta_in.size, 0))
    if form.conductor is not None:
        fresnel = fresnel_conductor(centre.cos_d[:, None], *form.conductor.index(wavelengths))
    return View(
        form=form,
        cos_in=np.cos(np.radians(theta_in))[:, None],
        directions=through_aperture(theta_in, theta_out, aperture),
        weights=aperture.weights,
        cos_d=centre.cos_d[:, None],
        fresnel=fresnel,
        wavelengths=wavelengths,
    )


def aperture_for(alpha: float, full_angle: float) -> Aperture:
    """A rule over an aperture of `full_angle` degrees as fine as the lobe needs.

    At grazing incidence a lobe is narrower sideways by cos(theta_in). At 80 degrees and through 1 degree the default
    rule errs by 15 % for alpha = 0.0045, by 3e-4 for 0.02 and by 6e-8 for 0.05; the fine one by 1e-4 at worst.
    """
    if full_angle == 0:
        return round_aperture(0.0, rings=1, spokes=1)
    if lobe_width(alpha) < 6 * full_angle:
        return round_aperture(full_angle, rings=16, spokes=40)
    return round_aperture(full_angle)


def regressed_albedo(
    surface: FloatArray, cos_in: FloatArray, log_measured: FloatArray, root_weight: FloatArray
) -> FloatArray:
    """[wavelengths] diffuse albedo, at least 0, of a linear regression of what a `surface` leaves.

    `surface` [points, wavelengths] is cos(theta_in) f of the surface, `cos_in` [points, 1]. The logarithm of the cost
    of Löw et al. is taken as straight at the measurement.
    """
    root = root_weight / np.exp(log_measured)
    gain = root * (cos_in / math.pi)
    missing = root * (np.expm1(log_measured) - surface)
    size = np.sum(gain**2, axis=0)
    albedo: FloatArray = np.maximum(np.sum(gain * missing, axis=0) / np.where(size > 0, size, 1.0), 0.0)
    return albedo


def best_albedo(
    surface: FloatArray, cos_in: FloatArray, log_measured: FloatArray, root_weight: FloatArray
) -> FloatArray:
    """[wavelengths] diffuse albedo, at least 0, that minimises the cost of Löw et al. beside a `surface`.

    Arguments as of `regressed_albedo`, from which Newton's steps lead to the minimum of the cost itself, at all
    wavelengths at once; its logarithm is nearly straight, so few are needed.
    """
    each = cos_in / math.pi
    albedo = regressed_albedo(surface, cos_in, log_measured, root_weight)
    for _ in range(_ALBEDO_STEPS):
        value = surface + each * albedo
        residual = root_weight * (np.log1p(value) - log_measured)
        gain = root_weight * each / (1 + value)
        size = np.sum(gain**2, axis=0)
        step = np.sum(gain * residual, axis=0) / np.where(size > 0, size, 1.0)
        better = np.maximum(albedo - step, 0.0)
        change = float(np.max(np.abs(better - albedo), initial=0.0))
        albedo = better
        if change <= _ALBEDO_TOLERANCE:
            break
    return albedo
