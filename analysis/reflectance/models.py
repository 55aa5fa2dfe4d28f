"""The reflectance models of Clausen et al. 2022 as plain functions.

One shape convention: directions have any shape [...], wavelengths are [wavelengths], and a spectral value is
[..., wavelengths]. A name that ends in `_derivative` gives the value and, with a leading axis for the parameters, its
derivatives. Wavelengths are nanometres, slopes 1/um, BRDF 1/sr. Equation numbers are the paper's.
"""

import numpy as np

from analysis.choices import Distribution
from analysis.reflectance.directions import Directions
from analysis.reflectance.distributions import lobe, lobe_derivative
from analysis.reflectance.fresnel import Conductor, fresnel_conductor, fresnel_dielectric, fresnel_dielectric_derivative
from drivers.arrays import BoolArray, FloatArray

LAMBDA_N = 600.0
"""Wavelength at which the shift is one, nm."""


def cosine_slope(theta_m: FloatArray, h: float, w: float, t_y: float = 0.0) -> FloatArray:
    """Slope m of the shift (Eq. 5), 1/um, [...]; `theta_m` [...] in degrees.

    >>> cosine_slope(np.array([0.0, 20.0, 30.0]), h=1.2, w=3.0).round(6).tolist()
    [1.2, 0.6, 0.0]
    """
    return np.asarray(h * np.cos(w * np.radians(theta_m)) + t_y)


def cosine_slope_derivative(theta_m: FloatArray, h: float, w: float, t_y: float = 0.0) -> tuple[FloatArray, FloatArray]:
    """`cosine_slope` [...] and its derivatives by h, w and t_y, [3, ...]."""
    angle = np.radians(theta_m)
    cosine = np.cos(w * angle)
    jacobian = np.stack([cosine, -h * angle * np.sin(w * angle), np.ones_like(cosine)])
    return np.asarray(h * cosine + t_y), jacobian


def shift(slope: FloatArray, wavelengths: FloatArray, lambda_n: float = LAMBDA_N) -> FloatArray:
    """Shift function 1 + m (lambda - lambda_n) (Eq. 4), [..., wavelengths]; negative values become zero.

    `slope` [...] is m in 1/um; wavelengths are in nm.

    >>> shift(np.array([1.0, -8.0]), np.array([450.0, 600.0, 750.0])).round(6).tolist()
    [[0.85, 1.0, 1.15], [2.2, 1.0, 0.0]]
    """
    return np.asarray(np.maximum(1 + np.asarray(slope)[..., None] * (wavelengths - lambda_n) * 1e-3, 0.0))


def shift_is_clamped(slope: FloatArray, wavelengths: FloatArray, lambda_n: float = LAMBDA_N) -> BoolArray:
    """[...] whether `shift` had to be clamped at zero somewhere in `wavelengths`."""
    return np.asarray(np.any(1 + np.asarray(slope)[..., None] * (wavelengths - lambda_n) * 1e-3 < 0, axis=-1))


def theta_m(directions: Directions) -> FloatArray:
    """[...] angle between half vector and surface normal, degrees.

    >>> from analysis.reflectance.directions import in_plane
    >>> theta_m(in_plane(np.array([40.0]), np.array([20.0]))).round(6).tolist()
    [10.0]
    """
    return np.asarray(np.degrees(np.arccos(np.clip(directions.cos_m, -1, 1))))


def normalised_fresnel(
    theta_in: FloatArray, wavelengths: FloatArray, conductor: Conductor, lambda_n: float = LAMBDA_N
) -> FloatArray:
    """F / F(lambda_n) of the smooth metal at incident angles `theta_in` [...], degrees, [..., wavelengths].

    Raises `OutOfRange` beyond the conductor's table.
    """
    n, k = conductor.index(np.append(wavelengths, lambda_n))
    fresnel = fresnel_conductor(np.cos(np.radians(theta_in))[..., None], n, k)
    return np.asarray(fresnel[..., :-1] / fresnel[..., -1:])


def local_model(
    fresnel: FloatArray,
    wavelengths: FloatArray,
    a: FloatArray,
    m: FloatArray,
    p: FloatArray,
    lambda_n: float = LAMBDA_N,
) -> FloatArray:
    """a (1 + m (lambda - lambda_n)) F_n^p (Eq. 2), [..., wavelengths], for a, m (1/um) and p each [...].

    `fresnel` is F_n as of `normalised_fresnel`, or ones where the material is taken as neutral. The paper's b is
    1 - m lambda_n, and its normalised spectrum has a = 1.
    """
    return np.asarray(np.asarray(a)[..., None] * shift(m, wavelengths, lambda_n) * fresnel ** np.asarray(p)[..., None])


def microfacet(
    directions: Directions,
    wavelengths: FloatArray,
    alpha: float,
    fresnel: FloatArray,
    slope: FloatArray | None = None,
    distribution: Distribution = "ggx",
    weights: FloatArray | None = None,
    lambda_n: float = LAMBDA_N,
) -> FloatArray:
    """Lobe x Fresnel x shift (Eq. 6 and 7), 1/sr, [..., wavelengths]: what all microfacet models have in common.

    `slope` is that of the shift at the directions, 1/um; without it there is no shift. With `weights` [nodes] of an
    aperture the directions (and the slope) are [..., nodes], as of `through_aperture`, and the result is what an
    instrument with that aperture reads: lobe, and lobe times slope, are averaged over it before the wavelengths enter,
    so a negative shift becomes zero in the average and not in each node. Fresnel reflectance `fresnel`,
    [..., wavelengths] or [..., 1], is that at the centre of the aperture, which changes a 1 degree aperture's reading
    by at most 4e-4 (alpha 0.0045, at 70 degrees) and by less than 4e-5 for alpha >= 0.18.
    """
    light = lobe(directions, alpha, distribution)
    tilted = np.zeros_like(light) if slope is None else light * slope
    if weights is not None:
        light, tilted = light @ weights, tilted @ weights
    x = (wavelengths - lambda_n) * 1e-3
    return np.asarray(fresnel * np.maximum(light[..., None] + tilted[..., None] * x, 0.0))


def microfacet_derivative(
    directions: Directions,
    wavelengths: FloatArray,
    alpha: float,
    fresnel: tuple[FloatArray, FloatArray],
    slope: tuple[FloatArray, FloatArray],
    distribution: Distribution = "ggx",
    weights: FloatArray | None = None,
    lambda_n: float = LAMBDA_N,
) -> tuple[FloatArray, FloatArray]:
    """`microfacet` and its derivatives by alpha, the parameters of Fresnel reflectance and those of the slope.

    `fresnel` and `slope` are values with derivatives, the latter with the axis of their parameters first; it may
    have the length zero, as of `constant`. The result's axis of parameters is first, too, in the order named.
    """
    light, light_by_alpha = lobe_derivative(directions, alpha, distribution)
    tilted, tilted_by_alpha, tilted_by_slope = light * slope[0], light_by_alpha * slope[0], light * slope[1]
    if weights is not None:
        light, light_by_alpha = light @ weights, light_by_alpha @ weights
        tilted, tilted_by_alpha, tilted_by_slope = (
            part @ weights for part in (tilted, tilted_by_alpha, tilted_by_slope)
        )
    x = (wavelengths - lambda_n) * 1e-3
    shifted = np.maximum(light[..., None] + tilted[..., None] * x, 0.0)
    lit = fresnel[0] * (shifted > 0)
    jacobian = np.concatenate(
        [
            (lit * (light_by_alpha[..., None] + tilted_by_alpha[..., None] * x))[None],
            shifted * fresnel[1],
            (lit * x) * tilted_by_slope[..., None],
        ]
    )
    return np.asarray(fresnel[0] * shifted), jacobian


def constant(value: FloatArray) -> tuple[FloatArray, FloatArray]:
    """`value` [...] and its derivatives by no parameters, [0, ...]."""
    return value, np.zeros((0, *value.shape))


def cook_torrance(
    directions: Directions,
    wavelengths: FloatArray,
    alpha: float,
    conductor: Conductor,
    h: float = 0.0,
    w: float = 0.0,
    distribution: Distribution = "ggx",
    lambda_n: float = LAMBDA_N,
) -> FloatArray:
    """Cook-Torrance (Eq. 6) times the shift (Eq. 7), 1/sr, [..., wavelengths].

    With `h` = 0 it is plain Cook-Torrance. Raises `OutOfRange` beyond the conductor's table.
    """
    n, k = conductor.index(wavelengths)
    fresnel = fresnel_conductor(directions.cos_d[..., None], n, k)
    slope = cosine_slope(theta_m(directions), h, w) if h != 0 else None
    return microfacet(directions, wavelengths, alpha, fresnel, slope, distribution, lambda_n=lambda_n)


def cook_torrance_derivative(
    directions: Directions,
    wavelengths: FloatArray,
    alpha: float,
    conductor: Conductor,
    h: float = 0.0,
    w: float = 0.0,
    distribution: Distribution = "ggx",
    lambda_n: float = LAMBDA_N,
) -> tuple[FloatArray, FloatArray]:
    """`cook_torrance` and its derivatives by alpha, h and w, [3, ..., wavelengths]; raises as `cook_torrance`."""
    n, k = conductor.index(wavelengths)
    fresnel = constant(fresnel_conductor(directions.cos_d[..., None], n, k))
    slope, by_h_w_t = cosine_slope_derivative(theta_m(directions), h, w)
    return microfacet_derivative(
        directions, wavelengths, alpha, fresnel, (slope, by_h_w_t[:2]), distribution, lambda_n=lambda_n
    )


def dielectric(
    directions: Directions,
    wavelengths: FloatArray,
    alpha: float,
    eta: float,
    r_d: FloatArray,
    h: float = 0.0,
    w: float = 0.0,
    distribution: Distribution = "ggx",
    lambda_n: float = LAMBDA_N,
) -> FloatArray:
    """r_d / pi + Cook-Torrance x shift of a dielectric (Eq. 8), 1/sr, [..., wavelengths].

    `r_d` [wavelengths] is the diffuse albedo. As in the paper the shift multiplies the lobe alone, and what the
    surface reflects is not taken from the diffuse light: nothing keeps the sum below one at grazing angles. Zero
    below the horizon. Raises `OutOfRange` for `eta` below one.

    >>> from analysis.reflectance.directions import in_plane
    >>> mirror = in_plane(np.array([0.0]), np.array([0.0]))
    >>> dielectric(mirror, np.array([500.0, 600.0]), 0.5, 1.5, np.array([0.2, 0.4]), h=1.0, w=2.0).round(4).tolist()
    [[0.0751, 0.1401]]
    """
    fresnel = fresnel_dielectric(directions.cos_d[..., None], eta)
    slope = cosine_slope(theta_m(directions), h, w) if h != 0 else None
    surface = microfacet(directions, wavelengths, alpha, fresnel, slope, distribution, lambda_n=lambda_n)
    return np.asarray(surface + _diffuse(directions, wavelengths, r_d))


def dielectric_derivative(
    directions: Directions,
    wavelengths: FloatArray,
    alpha: float,
    eta: float,
    r_d: FloatArray,
    h: float = 0.0,
    w: float = 0.0,
    distribution: Distribution = "ggx",
    lambda_n: float = LAMBDA_N,
) -> tuple[FloatArray, FloatArray]:
    """`dielectric` and its derivatives by alpha, eta, h and w, [4, ..., wavelengths].

    It is linear in `r_d`: each wavelength's value has the derivative 1/pi by r_d of that wavelength. Raises as
    `dielectric`.
    """
    fresnel, by_eta = fresnel_dielectric_derivative(directions.cos_d[..., None], eta)
    slope, by_h_w_t = cosine_slope_derivative(theta_m(directions), h, w)
    surface, jacobian = microfacet_derivative(
        directions, wavelengths, alpha, (fresnel, by_eta[None]), (slope, by_h_w_t[:2]), distribution, lambda_n=lambda_n
    )
    return np.asarray(surface + _diffuse(directions, wavelengths, r_d)), jacobian


def _diffuse(directions: Directions, wavelengths: FloatArray, r_d: FloatArray) -> FloatArray:
    """[..., wavelengths] 1/sr."""
    above = (directions.cos_i > 0) & (directions.cos_o > 0)
    return np.asarray(above[..., None] * np.broadcast_to(r_d, wavelengths.shape) / np.pi)
