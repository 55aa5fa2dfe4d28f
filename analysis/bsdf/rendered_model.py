"""What the writer of a `.bsdf` file has to know of a model of the ladder: its lobe, its wavelengths, its words."""

import math
from dataclasses import dataclass

import numpy as np

from analysis.colour import COLOUR_RANGE
from analysis.errors import ExportError, OutOfRange
from analysis.fits.brdf_fit import form_of
from analysis.reflectance.fresnel import Conductor
from analysis.reflectance.microfacet import Form
from analysis.results import ModelFit
from analysis.scenes.brdf_table import BrdfTable, Visibility
from analysis.scenes.ladder import Lambert, Microfacet, Model, Tinted
from analysis.scenes.vertices import Reflectance
from drivers.arrays import FloatArray

SPECTRAL_RANGE = (360.0, 830.0)
"""Wavelengths, nm, that a spectral renderer asks for (the CIE observer's)."""

_SURFACES = {"ggx": "GGX", "beckmann": "Beckmann"}
_SHIFTS = {
    "none": "",
    "cosine": ", times the shift 1 + m (lambda - 600 nm), m = h cos(w theta_m)",
    "two-component": ", times the shift 1 + m (lambda - 600 nm) with the slope m of two components",
}


@dataclass(frozen=True)
class RenderedModel:
    """A reflectance with what has to be known to tabulate it."""

    reflectance: Reflectance
    alpha: float
    """Roughness of its lobe; 1 where it has none."""
    base: float
    """About what is alike in all directions, 1/sr, as a mean over the wavelengths."""
    wavelengths: tuple[float, float]
    """Between which it is known and renderers ask, nm."""
    words: str
    """The model with all its numbers, but those that it has for each wavelength."""


def rendered(model: Model) -> RenderedModel:
    """Any model of the ladder; raises `OutOfRange` for one that is not known from 400 to 700 nm."""
    match model:
        case Lambert():
            base = float(model.albedo.mean()) / math.pi
            return RenderedModel(
                model, 1.0, base, _range(model.wavelengths), "Lambertian: albedo / pi in all directions"
            )
        case Tinted():
            words = f"A lobe of one colour, {_SURFACES[model.distribution]} with alpha = {model.alpha:.17g}"
            return RenderedModel(model, model.alpha, 0.0, _range(model.wavelengths), words)
        case BrdfTable():
            words = "A table of the measurement by theta_h and theta_d of the half vector"
            alpha, base = _of_guide(model)
            return RenderedModel(model, alpha, base, _range(model.wavelengths), words)
        case Microfacet():
            base, known = 0.0, model.form.conductor.wavelengths if model.form.conductor else None
            if model.albedo is not None:
                base, known = float(model.albedo.values.mean()) / math.pi, model.albedo.wavelengths
            span = SPECTRAL_RANGE if known is None else _range(known)
            return RenderedModel(model, float(model.parameters[0]), base, span, _words(model.form, model.parameters))


def _of_guide(table: BrdfTable) -> tuple[float, float]:
    """Roughness of the lobe of a table, and about what is alike in all its directions, 1/sr."""
    match table.guide:
        case Visibility(alpha):
            return alpha, 0.0
        case Lambert() | Tinted() | Microfacet() as guide:
            of_guide = rendered(guide)
            return of_guide.alpha, of_guide.base * float(np.exp(table.log_q).mean(axis=-1).min())
        case _:
            return 1.0, 0.0


def of_fit(fit: ModelFit, conductor: Conductor) -> Microfacet:
    """The reflectance of a fitted microfacet model; `conductor` is that of its fit, if it is of a metal.

    Raises `ExportError` for a model that says nothing of brightness.
    """
    if fit.distribution is None:
        raise ExportError(
            f"The model {fit.model} describes colours and no brightness, so it cannot be rendered; "
            "export cook-torrance, dielectric, or one of these with a shift."
        )
    form = form_of(fit.model, None if fit.model.startswith("dielectric") else conductor, fit.distribution)
    return Microfacet(form, np.array([parameter.value for parameter in fit.parameters]), fit.albedo)


def _range(wavelengths: FloatArray) -> tuple[float, float]:
    low, high = float(wavelengths[0]), float(wavelengths[-1])
    if low > COLOUR_RANGE[0] or high < COLOUR_RANGE[1]:
        raise OutOfRange(
            f"A renderer asks for {COLOUR_RANGE[0]:g} to {COLOUR_RANGE[1]:g} nm at least, but the model is known from "
            f"{low:g} to {high:g} nm."
        )
    return max(low, SPECTRAL_RANGE[0]), min(high, SPECTRAL_RANGE[1])


def _words(form: Form, parameters: FloatArray) -> str:
    material = f"conductor {form.conductor.name}" if form.conductor else "diffuse albedo below a dielectric"
    values = ", ".join(
        f"{quantity.name} = {value:.17g}" + ("" if quantity.unit == "1" else f" {quantity.unit}")
        for quantity, value in zip(form.quantities, parameters.tolist(), strict=True)
    )
    surface = _SURFACES[form.distribution]
    return f"Cook-Torrance with {surface} normals and {material}{_SHIFTS[form.shift]}: {values}"
