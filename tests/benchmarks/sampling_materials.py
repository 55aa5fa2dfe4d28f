"""Materials whose BRDF is known, for judging how they are sampled."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from analysis.reflectance.directions import in_plane, round_aperture, through_aperture
from analysis.reflectance.distributions import g1, ndf
from analysis.reflectance.fresnel import fresnel_conductor, load_conductor
from analysis.reflectance.models import cosine_slope, shift, theta_m
from drivers.arrays import FloatArray

BANDS = np.array([450.0, 550.0, 650.0, 800.0])
"""Centres of the bands that the plan looks at, nm."""

_APERTURE = round_aperture(1.0, rings=6, spokes=16)


@dataclass(frozen=True)
class Truth:
    """Microfacets with a distribution of normals, Fresnel of aluminium, the shift, and a bump towards the lamp."""

    distribution: Callable[[FloatArray, FloatArray], FloatArray]
    """Of the cosine of the half vector and of its signed angle in the plane, degrees; 1/sr."""
    alpha: float
    """Roughness of the masking."""
    h: float = 0.0
    """Amplitude of the slope of the shift, 1/um."""
    w: float = 0.0
    """Its angular frequency."""
    retro: float = 0.0
    """Height of a bump around the way back into the lamp, 1/sr."""
    retro_width: float = 16.0
    """theta_in + theta_out at which it has fallen to 1/e, degrees."""

    def __call__(self, theta_in: FloatArray, theta_out: FloatArray, wavelengths: FloatArray = BANDS) -> FloatArray:
        """cos(theta_in) f as an aperture of 1 degree sees it, [points, wavelengths]; angles in degrees."""
        through = through_aperture(theta_in, theta_out, _APERTURE)
        ci, co = through.cos_i, np.maximum(through.cos_o, 1e-6)
        angle = 0.5 * (theta_out - theta_in)[:, None] + 0.5 * _APERTURE.along
        lobe = self.distribution(through.cos_m, angle) * g1(ci, self.alpha) * g1(co, self.alpha) / (4 * ci * co)
        lobe = np.where(through.cos_o > 0, lobe, 0.0) @ _APERTURE.weights
        lobe = lobe + self.retro * np.exp(-(((theta_in + theta_out) / self.retro_width) ** 2))
        centre = in_plane(theta_in, theta_out)
        spectral = fresnel_conductor(centre.cos_d[:, None], *load_conductor().index(wavelengths))
        spectral = spectral * shift(cosine_slope(theta_m(centre), self.h, self.w), wavelengths)
        return np.asarray(np.cos(np.radians(theta_in))[:, None] * lobe[:, None] * spectral)


def _ggx(alpha: float, h: float = 0.0, w: float = 0.0) -> Truth:
    return Truth(lambda cosine, _: ndf(cosine, alpha), alpha, h, w)


def _two(cosine: FloatArray, _: FloatArray) -> FloatArray:
    return 0.3 * ndf(cosine, 0.03) + 0.7 * ndf(cosine, 0.3)


def _mixture(cosine: FloatArray, _: FloatArray) -> FloatArray:
    return 0.5 * ndf(cosine, 0.1) + 0.5 * ndf(cosine, 0.3, "beckmann")


def _halo(cosine: FloatArray, _: FloatArray) -> FloatArray:
    """A lobe with a bright ring around it."""
    angle = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    return np.asarray(ndf(cosine, 0.05) + 6.0 * np.exp(-(((angle - 12.0) / 2.0) ** 2)))


def _lopsided(cosine: FloatArray, angle: FloatArray) -> FloatArray:
    """A lobe that is twice as strong on one side as on the other, as of a brushed sheet: no symmetry holds."""
    return np.asarray(ndf(cosine, 0.15) * (1 + 0.5 * np.tanh((angle - 4.0) / 6.0)))


MATERIALS: dict[str, Truth] = {
    "GGX 0.005": _ggx(0.005),
    "GGX 0.02": _ggx(0.02),
    "GGX 0.05": _ggx(0.05, 0.7, 5.0),
    "GGX 0.126": _ggx(0.126, 0.9, 4.5),
    "GGX 0.25": _ggx(0.25, 1.5, 2.6),
    "GGX 0.41": _ggx(0.41, 1.6, 2.3),
    "two lobes": Truth(_two, 0.3, 1.0, 3.0, 0.05),
    "GGX and Beckmann": Truth(_mixture, 0.2, 1.0, 3.0),
    "halo": Truth(_halo, 0.1, 0.7, 5.0),
    "lopsided": Truth(_lopsided, 0.15, 0.7, 5.0),
}
"""By name, as it is printed; the number is the roughness alpha. No lobe of the plan can represent the last four."""
