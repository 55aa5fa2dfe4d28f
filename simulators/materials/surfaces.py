"""Rough surfaces that no fitted model assumes: what is behind the bench's harder samples.

Light that a surface reflects once has one shift, light that it reflects more often another, as the paper's section 5.7
has it, and the two are added as light, not as slopes:

    f = (1 - rho_2) F L (1 + m_1 x) + F_2 M (1 + m_2 x) + diffuse,    x = lambda - 600 nm.

L is the microfacet lobe of a mixture of normals, half of them GGX and half Beckmann, which differs from either by tens
of per cent. M = rho_2 / pi exp(-2 sin^2 theta_d) returns the light that went through the valleys: it leads back to
the lamp, with theta_d the angle between incident direction and half vector. F_2 is F^2 on a metal, which has taken part
of the light twice, and one on a dielectric, where rho_2 holds all. The slope of the sum follows the share of the light
and is no cosine of theta_m. Below a dielectric lies a diffuse body, lit and seen through the interface:

    diffuse = r(lambda) / pi (1 - F(theta_in)) (1 - F(theta_out)) / ((1 - F(0)) (1 - F(45 deg))),

r being its radiance factor at 45:0, where colour charts are measured. All of it is reciprocal, and where F is one no
more light is sent back than falls in.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from analysis.reflectance.directions import Aperture, Directions, round_aperture, through_aperture
from analysis.reflectance.distributions import lobe
from analysis.reflectance.fresnel import fresnel_conductor, fresnel_dielectric
from analysis.reflectance.models import LAMBDA_N
from drivers.arrays import FloatArray

Reflectance = Callable[[FloatArray], FloatArray]
"""Of the cosine [..., 1] of the angle of incidence on a facet, [..., wavelengths]."""

SPREAD = 0.5
"""sin^2 theta_d at which light that was reflected more than once has fallen to 1 / e of that on the way back."""

_WIDER, _NARROWER = 1.25, 0.8
"""Roughness of the Beckmann and of the GGX half of the normals, as a multiple of alpha."""


@dataclass(frozen=True)
class Surface:
    """A rough surface as described above."""

    name: str
    alpha: float
    """Roughness of the mixture of normals."""
    once: float
    """Slope m_1 of the shift of light that was reflected once, 1/um."""
    more: float
    """Slope m_2 of the shift of light that was reflected more often, 1/um."""
    multiple: float
    """rho_2, how much light is reflected more than once, as an albedo."""
    eta: float | None
    """Refractive index of a dielectric, the same at all wavelengths; None for aluminium."""
    diffuse: tuple[FloatArray, FloatArray] | None = None
    """Wavelengths, nm, and radiance factors at 45:0 of what lies below the interface; held constant beyond."""
    diameter_mm: float = 50.0
    """Of the disc, mm."""


def over_aperture(
    directions: Directions,
    weight: FloatArray,
    slope: FloatArray | float,
    reflectance: Reflectance,
    wavelengths: FloatArray,
) -> FloatArray:
    """[points, wavelengths] sum over aperture nodes of weight x reflectance x (1 + slope (lambda - 600 nm)).

    `weight` [points, nodes] and `slope` likewise, 1/um. Within the aperture `reflectance` is taken as a parabola in the
    cosine of its angle (through three values, exact to 1e-7 for a metal), and the shift is linear in the slope as long
    as it is not clamped. Then all nodes can be summed before the wavelengths enter.
    """
    low, high = directions.cos_d.min(axis=1), directions.cos_d.max(axis=1)
    centre, half = (low + high) / 2, np.maximum((high - low) / 2, 1e-3)  # a point detector needs a parabola, too
    x = (directions.cos_d - centre[:, None]) / half[:, None]
    parabolas = np.stack([x * (x - 1) / 2, 1 - x**2, x * (x + 1) / 2])
    level, tilt = ((parabolas * of_node).sum(axis=-1)[..., None] for of_node in (weight, weight * slope))
    corners = centre + half * np.array([[-1.0], [0.0], [1.0]])
    at_corners = reflectance(corners[..., None])
    return np.asarray(((level + tilt * (wavelengths - LAMBDA_N) * 1e-3) * at_corners).sum(axis=0))


def single_lobe(directions: Directions, alpha: float) -> FloatArray:
    """L, 1/sr, [...]; zero below the horizon."""
    halves = lobe(directions, _NARROWER * alpha, "ggx"), lobe(directions, _WIDER * alpha, "beckmann")
    return np.asarray((halves[0] + halves[1]) / 2)


def multiple_lobe(directions: Directions, multiple: float) -> FloatArray:
    """M, 1/sr, [...]; zero below the horizon."""
    above = (directions.cos_i > 0) & (directions.cos_o > 0)
    return np.asarray(above * multiple / np.pi * np.exp((directions.cos_d**2 - 1) / SPREAD))


def surface_brdf(
    surface: Surface,
    theta_in: FloatArray,
    theta_out: FloatArray,
    wavelengths: FloatArray,
    index: tuple[FloatArray, FloatArray],
    aperture: Aperture,
) -> FloatArray:
    """[points, wavelengths] BRDF averaged over the aperture, 1/sr; `index` is that of aluminium at the wavelengths.

    Raises as `mean_brdf`.
    """
    return mean_brdf(surface, through_aperture(theta_in, theta_out, aperture), aperture.weights, wavelengths, index)


def mean_brdf(
    surface: Surface,
    directions: Directions,
    weights: FloatArray,
    wavelengths: FloatArray,
    index: tuple[FloatArray, FloatArray],
) -> FloatArray:
    """[points, wavelengths] mean with `weights` [nodes] of the BRDF at `directions` [points, nodes], 1/sr.

    Directions may lie anywhere, and are near each other for one point.
    Raises `OutOfRange` for a dielectric's index below one.
    """
    eta = surface.eta

    def first(cosine: FloatArray) -> FloatArray:
        return fresnel_conductor(cosine, *index) if eta is None else fresnel_dielectric(cosine, eta)

    def second(cosine: FloatArray) -> FloatArray:
        return first(cosine) ** 2 if eta is None else np.ones_like(cosine)

    once = (1 - surface.multiple) * single_lobe(directions, surface.alpha) * weights
    more = multiple_lobe(directions, surface.multiple) * weights
    value = over_aperture(directions, once, surface.once, first, wavelengths)
    value = value + over_aperture(directions, more, surface.more, second, wavelengths)
    if eta is None or surface.diffuse is None:
        return value
    return value + _diffuse(directions, weights, eta) * np.interp(wavelengths, *surface.diffuse)


def _diffuse(directions: Directions, weights: FloatArray, eta: float) -> FloatArray:
    """[points, 1] the diffuse part for a radiance factor of one at 45:0, averaged over the aperture, 1/sr."""
    above = (directions.cos_i > 0) & (directions.cos_o > 0)
    through = [1 - fresnel_dielectric(np.maximum(cosine, 1e-9), eta) for cosine in (directions.cos_i, directions.cos_o)]
    at_45_0 = np.prod(1 - fresnel_dielectric(np.cos(np.radians([45.0, 0.0])), eta))
    return np.asarray((above * weights * through[0] * through[1]).sum(axis=-1, keepdims=True) / (np.pi * at_45_0))


SANDBLASTED = {
    surface.name: surface
    for surface in (
        Surface("two-component-1", 0.364, 1.6, -1.6, 0.120, None),
        Surface("two-component-2", 0.280, 1.5, -1.5, 0.080, None),
        Surface("two-component-3", 0.209, 1.35, -1.35, 0.050, None),
        Surface("two-component-4", 0.180, 1.2, -1.2, 0.035, None),
        Surface("two-component-5", 0.113, 0.9, -0.9, 0.012, None),
        Surface("two-component-6", 0.0045, 0.0, -0.9, 0.0003, None),
    )
}
"""The paper's Samples 1 to 6 with another truth: alpha and the largest slopes are those of
`simulators.materials.materials`.

How much is reflected more than once grows with the roughness as the paper's Fig. 11 suggests; the numbers are ours. The
mirror has no shift in its lobe, and a halo of scratches that is bluish.
"""

SANDED = {
    surface.name: surface
    for surface in (
        Surface("srs-02-grit-60", 0.70, 1.2, -1.2, 0.030, 1.35),
        Surface("srs-02-grit-1000", 0.50, 1.2, -1.2, 0.021, 1.35),
        Surface("srs-02-grit-2500", 0.40, 1.2, -1.2, 0.006, 1.35),
    )
}
"""Spectralon SRS-02, black and neutral, sanded (paper, section 5.6): no Fresnel colour, so p = 0 in Eq. 2.

With grit 60 light that was reflected more than once outweighs the other, with grit 2500 the other way round; with grit
1000 both weigh the same at normal incidence, where their shifts cancel, and part beyond it. The numbers are ours.
"""

PATCHES = 24
"""On a ColorChecker."""


@cache
def colorchecker_patch(number: int) -> Surface:
    """A patch, 1 to 24, that has its measured radiance factor at 45:0; raises `KeyError` for another number.

    The spectra are the average of 30 charts by BabelColor as `colour-science` ships them, 380 to 730 nm; beyond, they
    are held constant, which is invented. Roughness, refractive index and shift are ours, the same for all
    patches; the shift is weaker than that of metals, as the paper says it is.
    """
    import colour  # noqa: PLC0415  (takes seconds)

    spectrum = dict(enumerate(colour.SDS_COLOURCHECKERS["BabelColor Average"].values(), start=1))[number]
    wavelengths = np.asarray(spectrum.wavelengths, dtype=float)
    bare = Surface(f"colorchecker-{number}", 0.20, 0.5, -0.5, 0.004, 1.5)
    here = np.array([45.0]), np.array([0.0])
    no_metal = np.ones_like(wavelengths), np.zeros_like(wavelengths)
    of_surface = np.pi * surface_brdf(bare, *here, wavelengths, no_metal, round_aperture(0.0, rings=1, spokes=1))[0]
    return replace(bare, diffuse=(wavelengths, np.asarray(spectrum.values, dtype=float) - of_surface))
