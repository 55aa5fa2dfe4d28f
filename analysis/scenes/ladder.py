"""The ladder of models from Lambert to the table, each as a reflectance that a scene can ask, with what it costs."""

import math
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np

from analysis.choices import Distribution
from analysis.fits.brdf_fit import form_of
from analysis.reflectance.directions import Directions
from analysis.reflectance.distributions import lobe
from analysis.reflectance.fresnel import Conductor, fresnel_dielectric
from analysis.reflectance.microfacet import Form, brdf
from analysis.results import Albedo, ModelFit
from analysis.scenes.brdf_table import BrdfTable
from analysis.scenes.vertices import Reflectance, Vertices
from drivers.arrays import FloatArray

METAL_FITS = ("cook-torrance", "cook-torrance-shift", "two-component")
"""Models that have to be fitted for the ladder of a metal."""

DIELECTRIC_FITS = ("dielectric", "dielectric-shift", "dielectric-two-component")
"""The same of a dielectric."""

DOUBT_STEP = 0.1
"""Part of a standard error over which a model is taken as linear in its parameters."""

_TIMED = 20_000


@dataclass(frozen=True)
class Lambert:
    """The same in all directions."""

    wavelengths: FloatArray
    albedo: FloatArray
    """[wavelengths]"""

    def __call__(self, directions: Directions, wavelengths: FloatArray) -> FloatArray:
        """BRDF [vertices, wavelengths], 1/sr."""
        above = (directions.cos_i > 0) & (directions.cos_o > 0)
        return np.asarray(above[:, None] * (np.interp(wavelengths, self.wavelengths, self.albedo) / math.pi))


@dataclass(frozen=True)
class Tinted:
    """A lobe of one colour in all directions, as a renderer in RGB has it."""

    alpha: float
    distribution: Distribution
    wavelengths: FloatArray
    tint: FloatArray
    """[wavelengths]"""

    def __call__(self, directions: Directions, wavelengths: FloatArray) -> FloatArray:
        """BRDF [vertices, wavelengths], 1/sr."""
        tint = np.interp(wavelengths, self.wavelengths, self.tint)
        return np.asarray(lobe(directions, self.alpha, self.distribution)[:, None] * tint)


@dataclass(frozen=True)
class Microfacet:
    """A fitted microfacet model."""

    form: Form
    parameters: FloatArray
    """[parameters]"""
    albedo: Albedo | None

    def __call__(self, directions: Directions, wavelengths: FloatArray) -> FloatArray:
        """BRDF [vertices, wavelengths], 1/sr."""
        diffuse = None
        if self.albedo is not None:
            diffuse = np.interp(wavelengths, self.albedo.wavelengths, self.albedo.values)
        return brdf(self.form, directions, wavelengths, self.parameters, diffuse)


@dataclass(frozen=True)
class ThroughInterface:
    """A dielectric whose diffuse light has been refracted twice, and is the less the more is reflected."""

    plain: Microfacet
    """The same with Lambertian diffuse light."""

    def __call__(self, directions: Directions, wavelengths: FloatArray) -> FloatArray:
        """BRDF [vertices, wavelengths], 1/sr."""
        whole, surface = (each(directions, wavelengths) for each in (self.plain, replace(self.plain, albedo=None)))
        eta = float(self.plain.parameters[1])
        into, out = (1 - fresnel_dielectric(np.maximum(c, 0.0), eta) for c in (directions.cos_i, directions.cos_o))
        return np.asarray(surface + (into * out)[:, None] * (whole - surface))


Model = Lambert | Tinted | Microfacet | BrdfTable


@dataclass(frozen=True)
class Rung:
    """One model of the ladder."""

    name: str
    model: Model
    shape: tuple[str, ...]
    """Names of the parameters that describe directions."""
    per_wavelength: int
    """Numbers that it has besides for each wavelength."""
    unknown: tuple[str, ...] = ()
    """Why it must not be chosen whatever the scene: sentences on what the data do not tell."""
    doubt: tuple[Model, ...] = ()
    """The same model with its parameters off by `DOUBT_STEP` of each of the independent errors that make their
    covariance."""

    def parameters(self, wavelengths: int) -> int:
        """How many numbers it has at so many wavelengths; those of a table are its values."""
        return len(self.shape) + self.per_wavelength * wavelengths

    def nanoseconds(self, directions: Directions) -> float:
        """What an evaluation of a direction at one wavelength takes here and now, the best of three."""
        few = Directions(*(cosine[:_TIMED] for cosine in directions))
        at = np.array([550.0])
        taken = []
        for _ in range(3):
            start = perf_counter()
            self.model(few, at)
            taken.append(perf_counter() - start)
        return 1e9 * min(taken) / few.cos_i.size


def ladder(
    vertices: Vertices, reference: Reflectance, wavelengths: FloatArray, fits: tuple[ModelFit, ...], metal: Conductor
) -> tuple[Rung, ...]:
    """The rungs from the cheapest to the dearest; the table, if there is one, is the caller's to add.

    `fits` are those of `METAL_FITS` or `DIELECTRIC_FITS`, simplest first. The colours of Lambert's and of the tinted
    rung, at `wavelengths`, nm, are the ones that reflect as much of the scene's light as the `reference` does.
    """
    simplest = fits[0]
    distribution = simplest.distribution or "ggx"
    surest = _surest_lobe(fits)
    alpha = surest.value("alpha")
    light, of_lobe, of_even = _reflected(vertices, reference, wavelengths, alpha, distribution)
    rungs = [Rung("lambert", Lambert(wavelengths, light / of_even), (), 1)]
    if not simplest.model.startswith("dielectric"):
        tinted = Tinted(alpha, distribution, wavelengths, light / of_lobe)
        rungs.append(Rung("tinted", tinted, ("alpha",), 1, _unknown_lobe(surest)))
    for fit in fits:
        conductor = None if fit.model.startswith("dielectric") else metal
        form = form_of(fit.model, conductor, distribution)
        values = np.array([parameter.value for parameter in fit.parameters])
        used = tuple(p.name for p in fit.parameters if math.isfinite(p.standard_error))
        model = Microfacet(form, values, fit.albedo)
        rungs.append(Rung(fit.model, model, used, 0 if conductor else 1, _unknown(fit), _doubt(model, fit)))
    return tuple(rungs)


def table_rung(table: BrdfTable) -> Rung:
    """The table as the last rung."""
    return Rung("table", table, (), table.theta_h.size * table.theta_d.size)


def _unknown(fit: ModelFit) -> tuple[str, ...]:
    """Sentences on the parameters that a fit uses and the data do not tell; a fixed one is not used."""
    used = {p.name for p in fit.parameters if math.isfinite(p.standard_error)}
    names = [name for name in fit.verdict.undetermined if name in used]
    if not names:
        return () if fit.verdict.converged else ("The fit did not converge.",)
    return (f"The data do not tell its {' and '.join(names)}.",)


def _doubt(model: Microfacet, fit: ModelFit) -> tuple[Microfacet, ...]:
    """`model` off by a part of each column of a root of the covariance of its parameters, within what is searched.

    Errors of a diffuse albedo count as one for all wavelengths, as those of a reference are.
    """
    u = np.array([p.standard_error for p in fit.parameters])
    u = np.where(np.isfinite(u), u, 0.0)
    values, vectors = np.linalg.eigh(fit.correlation * np.outer(u, u))
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    low, high = np.array([(quantity.lower, quantity.upper) for quantity in model.form.quantities]).T
    moved = []
    for step in DOUBT_STEP * root.T:
        there = model.parameters + step
        inside = np.all((there >= low) & (there <= high))
        other_way = np.clip(model.parameters - step, low, high)
        moved.append(replace(model, parameters=there if inside else other_way))
    if model.albedo is not None:
        known = np.isfinite(model.albedo.u)
        brighter = model.albedo.values + DOUBT_STEP * np.where(known, model.albedo.u, 0.0)
        moved.append(replace(model, albedo=replace(model.albedo, values=brighter)))
    return tuple(moved)


def _surest_lobe(fits: tuple[ModelFit, ...]) -> ModelFit:
    """The fit that knows alpha best: one whose colours are wrong is the less certain."""
    return min(fits, key=lambda fit: fit.standard_error("alpha"))


def roughness(fits: tuple[ModelFit, ...]) -> float:
    """About how rough the material is, by the fit that knows it best."""
    return _surest_lobe(fits).value("alpha")


def guides(fits: tuple[ModelFit, ...]) -> tuple[Reflectance, ...]:
    """How a table of a dielectric may be continued out of the plane: its model without shift, what is scattered below
    the surface being Lambertian, or lit and seen through the interface. None for a metal."""
    surest = _surest_lobe(fits)
    if surest.albedo is None:
        return ()
    form = form_of("dielectric", None, surest.distribution or "ggx")
    plain = Microfacet(form, np.array([surest.value("alpha"), surest.value("eta")]), surest.albedo)
    return plain, ThroughInterface(plain)


def _unknown_lobe(fit: ModelFit) -> tuple[str, ...]:
    return ("The data do not tell its alpha.",) if "alpha" in fit.verdict.undetermined else ()


def _reflected(
    vertices: Vertices, reference: Reflectance, wavelengths: FloatArray, alpha: float, distribution: Distribution
) -> tuple[FloatArray, FloatArray, float]:
    """What the scene's light makes of the reference [wavelengths], of a lobe, and of a white Lambertian surface.

    The luminance of the light of a vertex counts, in every pixel as much as in the others.
    """
    luminance = vertices.weight @ vertices.colour_weights(np.array([550.0]))[:, 0, 1]
    light = np.zeros(wavelengths.size)
    for start in range(0, luminance.size, _TIMED):
        part = slice(start, start + _TIMED)
        light += luminance[part] @ reference(Directions(*(c[part] for c in vertices.directions)), wavelengths)
    of_lobe = float(luminance @ lobe(vertices.directions, alpha, distribution))
    return light, np.asarray(of_lobe), float(luminance.sum() / math.pi)
