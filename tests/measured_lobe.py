"""What an instrument reads of Cook-Torrance, for tests that need a measurement whose truth is a formula."""

from analysis.choices import Distribution
from analysis.reflectance.directions import Aperture, in_plane, through_aperture
from analysis.reflectance.fresnel import Conductor, fresnel_conductor
from analysis.reflectance.models import LAMBDA_N, cosine_slope, microfacet, theta_m
from drivers.arrays import FloatArray


def measured_cook_torrance(
    theta_in: FloatArray,
    theta_out: FloatArray,
    wavelengths: FloatArray,
    alpha: float,
    conductor: Conductor,
    aperture: Aperture,
    h: float = 0.0,
    w: float = 0.0,
    distribution: Distribution = "ggx",
    lambda_n: float = LAMBDA_N,
) -> FloatArray:
    """What an instrument with a finite aperture reads of `cook_torrance` in plane, [points, wavelengths], 1/sr.

    Angles [points] in degrees; how it is read, and how exactly, stands at `microfacet`.
    """
    directions = through_aperture(theta_in, theta_out, aperture)
    n, k = conductor.index(wavelengths)
    fresnel = fresnel_conductor(in_plane(theta_in, theta_out).cos_d[:, None], n, k)
    slope = cosine_slope(theta_m(directions), h, w) if h != 0 else None
    return microfacet(directions, wavelengths, alpha, fresnel, slope, distribution, aperture.weights, lambda_n)
