"""The models agree with published values and closed forms."""

from typing import get_args

import numpy as np
import pytest
from scipy.special import erf

from analysis.choices import Distribution
from analysis.reflectance.directions import Directions, in_plane, round_aperture, through_aperture
from analysis.reflectance.distributions import g1, lobe, ndf
from analysis.reflectance.fresnel import fresnel_conductor, load_conductor
from analysis.reflectance.models import (
    cook_torrance,
    cosine_slope,
    dielectric,
    local_model,
    microfacet,
    normalised_fresnel,
    shift,
    shift_is_clamped,
    theta_m,
)
from analysis.reflectance.two_component import two_component_slope
from tests.measured_lobe import measured_cook_torrance

DISTRIBUTIONS = get_args(Distribution)
WAVELENGTHS = np.array([400.0, 550, 600, 900])


def _random_pairs(count: int) -> tuple[Directions, Directions]:
    """Pairs of directions on the hemisphere, and the same with the two exchanged."""
    rng = np.random.default_rng(8)
    cos, phi = rng.uniform(0.05, 1, (2, count)), rng.uniform(-np.pi, np.pi, (2, count))
    sin = np.sqrt(1 - cos**2)
    incident, reflected = np.stack([sin * np.cos(phi), sin * np.sin(phi), cos], axis=-1)
    half = incident + reflected
    half /= np.linalg.norm(half, axis=-1, keepdims=True)
    there = Directions(incident[:, 2], reflected[:, 2], half[:, 2], np.sum(incident * half, axis=-1))
    back = Directions(reflected[:, 2], incident[:, 2], half[:, 2], np.sum(reflected * half, axis=-1))
    return there, back


def _albedo(theta_in: float, alpha: float, distribution: Distribution) -> float:
    """Share of the light from `theta_in`, degrees, that perfect mirrors of this distribution reflect once."""
    lit_from = np.array([np.sin(np.radians(theta_in)), 0.0, np.cos(np.radians(theta_in))])
    # over half vectors, where the lobe is smooth: theta = atan(alpha tan(s)), and d omega_o = 4 cos_d d omega_m
    s, phi = (np.arange(400) + 0.5) / 400 * np.pi / 2, 2 * np.pi * (np.arange(120) + 0.5) / 120
    theta = np.arctan(alpha * np.tan(s))[:, None]
    step = (alpha / (np.cos(s) ** 2 + (alpha * np.sin(s)) ** 2))[:, None] * (np.pi / 800) * (2 * np.pi / 120)
    parts = (np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta))
    m = np.stack(np.broadcast_arrays(*parts), axis=-1)
    cos_d = m @ lit_from
    cos_o = 2 * cos_d * m[..., 2] - lit_from[2]
    directions = Directions(np.full_like(cos_o, lit_from[2]), cos_o, m[..., 2], cos_d)
    white = microfacet(directions, np.array([600.0]), alpha, np.ones(1), distribution=distribution)[..., 0]
    facing = np.maximum(cos_d, 0)
    return float(np.sum(white * np.maximum(cos_o, 0) * 4 * facing * np.sin(theta) * step))


@pytest.mark.parametrize("distribution", DISTRIBUTIONS)
@pytest.mark.parametrize("alpha", [0.01, 0.1, 0.364, 0.8])
def test_normals_project_onto_the_unit_area(alpha: float, distribution: Distribution) -> None:
    # substitution tan(theta) = alpha tan(s) keeps the integrand smooth for narrow lobes
    s = np.linspace(0, np.pi / 2, 20001)[1:-1]
    theta = np.arctan(alpha * np.tan(s))
    dtheta = alpha / np.cos(s) ** 2 / (1 + (alpha * np.tan(s)) ** 2)
    integrand = ndf(np.cos(theta), alpha, distribution) * np.cos(theta) * 2 * np.pi * np.sin(theta) * dtheta
    assert np.trapezoid(integrand, s) == pytest.approx(1, abs=1e-6)


@pytest.mark.parametrize("distribution", DISTRIBUTIONS)
def test_masking_is_one_at_normal_incidence_and_none_at_the_horizon(distribution: Distribution) -> None:
    assert g1(np.array([1.0]), 0.3, distribution)[0] == pytest.approx(1)
    assert g1(np.array([1e-6]), 0.3, distribution)[0] == pytest.approx(0, abs=2e-5)


def test_masking_of_beckmann_is_that_of_smith() -> None:
    # the closed form that the rational approximation stands for: Walter et al. 2007, Eq. 26 and 27
    tan = np.tan(np.radians(np.linspace(5, 89, 200)))
    a = 1 / (0.4 * tan)
    exact = 2 / (1 + erf(a) + np.exp(-(a**2)) / (a * np.sqrt(np.pi)))
    np.testing.assert_allclose(g1(1 / np.hypot(1, tan), 0.4, "beckmann"), exact, rtol=3.6e-3)


@pytest.mark.parametrize("distribution", DISTRIBUTIONS)
def test_no_more_light_comes_back_than_fell_in(distribution: Distribution) -> None:
    for alpha in (0.02, 0.2, 0.6, 1.0):
        albedos = [_albedo(theta_in, alpha, distribution) for theta_in in (0.0, 40, 70, 85)]
        assert max(albedos) < 1.001
    # a nearly smooth surface loses nothing to its own shadows, and peaks as 1 / (4 pi alpha^2)
    assert _albedo(0.0, 0.02, distribution) == pytest.approx(1, abs=2e-3)
    assert _albedo(40.0, 0.02, distribution) == pytest.approx(1, abs=2e-3)
    zero = np.zeros(1)
    assert lobe(in_plane(zero, zero), 1e-3, distribution)[0] == pytest.approx(1 / (4 * np.pi * 1e-6), rel=1e-6)


def test_half_vector_angle_in_plane_is_half_the_difference_of_the_signed_angles() -> None:
    theta_in, theta_out = np.array([0.0, 40, 40, 70]), np.array([30.0, 40, -60, 85])
    directions = in_plane(theta_in, theta_out)
    np.testing.assert_allclose(theta_m(directions), np.abs(theta_out - theta_in) / 2, atol=1e-5)
    np.testing.assert_allclose(directions.cos_d, np.cos(np.radians(theta_in + theta_out) / 2), atol=1e-12)


@pytest.mark.parametrize("distribution", DISTRIBUTIONS)
def test_models_are_reciprocal(distribution: Distribution) -> None:
    there, back = _random_pairs(50)
    np.testing.assert_allclose(
        cook_torrance(there, WAVELENGTHS, 0.2, load_conductor(), 1.2, 3.4, distribution),
        cook_torrance(back, WAVELENGTHS, 0.2, load_conductor(), 1.2, 3.4, distribution),
        rtol=1e-11,
    )
    r_d = np.full(WAVELENGTHS.size, 0.3)
    np.testing.assert_allclose(
        dielectric(there, WAVELENGTHS, 0.2, 1.5, r_d, 1.2, 3.4, distribution),
        dielectric(back, WAVELENGTHS, 0.2, 1.5, r_d, 1.2, 3.4, distribution),
        rtol=1e-11,
    )
    shape = (1.2, 2.1, 0.1, 0.7, 5.0, 0.3)
    np.testing.assert_allclose(two_component_slope(there, *shape), two_component_slope(back, *shape), rtol=1e-10)


def test_local_and_global_models_are_the_equations_of_the_paper() -> None:
    theta_in, theta_out = np.array([10.0, 50]), np.array([-30.0, 40])
    wavelengths = np.array([420.0, 600, 850])
    n, k = load_conductor().index(wavelengths)
    for i in range(2):
        fresnel = fresnel_conductor(np.cos(np.radians(theta_in[i : i + 1])), n, k)
        fresnel = fresnel / fresnel[1]
        normalised = normalised_fresnel(theta_in, wavelengths, load_conductor())
        slope = np.array([0.7, -0.4])
        b = 1 - slope[i] * 0.6
        eq2 = (slope[i] * wavelengths * 1e-3 + b) * fresnel**1.7
        ours = local_model(normalised, wavelengths, np.full(2, 3.0), slope, np.full(2, 1.7))
        np.testing.assert_allclose(ours[i], 3 * eq2, rtol=1e-12)
        half_angle = np.radians(abs(theta_out[i] - theta_in[i]) / 2)
        m = 1.1 * np.cos(2.5 * half_angle) + 0.2
        eq3 = (m * wavelengths * 1e-3 + 1 - m * 0.6) * fresnel**1.7
        cosine = cosine_slope(theta_m(in_plane(theta_in, theta_out)), 1.1, 2.5, 0.2)
        np.testing.assert_allclose((shift(cosine, wavelengths) * normalised**1.7)[i], eq3, rtol=1e-12)


def test_a_wavelength_at_which_the_shift_is_one_can_be_chosen() -> None:
    directions = in_plane(np.array([30.0]), np.array([10.0]))
    plain = cook_torrance(directions, WAVELENGTHS, 0.2, load_conductor())
    shifted = cook_torrance(directions, WAVELENGTHS, 0.2, load_conductor(), 1.2, 2.0, lambda_n=550.0)
    np.testing.assert_allclose((shifted / plain)[0, 1], 1, rtol=1e-12)
    m = 1.2 * np.cos(2.0 * np.radians(10.0))
    np.testing.assert_allclose((shifted / plain)[0, 3], 1 + m * 0.35, rtol=1e-12)


def test_the_shift_leaves_diffuse_light_alone_as_in_the_paper() -> None:
    directions = in_plane(np.array([40.0, 40, 100]), np.array([40.0, -20, 0]))
    r_d = np.linspace(0.2, 0.8, WAVELENGTHS.size)
    surface = dielectric(directions, WAVELENGTHS, 0.3, 1.5, np.zeros(WAVELENGTHS.size))
    both = dielectric(directions, WAVELENGTHS, 0.3, 1.5, r_d, 1.2, 2.0)
    tilt = shift(cosine_slope(theta_m(directions), 1.2, 2.0), WAVELENGTHS)
    np.testing.assert_allclose(both[:2], (surface * tilt + r_d / np.pi)[:2], rtol=1e-12)
    # nothing comes from below the horizon, and an index of one leaves the diffuse light
    assert np.all(both[2] == 0)
    alone = dielectric(directions, WAVELENGTHS, 0.3, 1.0, r_d, 1.2, 2.0)[:2]
    np.testing.assert_allclose(alone, np.broadcast_to(r_d / np.pi, alone.shape), rtol=1e-12)


def test_shift_is_one_at_lambda_n_and_clamped_below_zero() -> None:
    slope = cosine_slope(np.array([0.0, 180 / 3.4]), 1.2, 3.4)
    np.testing.assert_allclose(slope, [1.2, -1.2])
    np.testing.assert_allclose(shift(slope, np.array([600.0, 700])), [[1, 1.12], [1, 0.88]])
    assert shift(np.array([3.0]), np.array([200.0]))[0, 0] == 0
    np.testing.assert_array_equal(shift_is_clamped(np.array([3.0, 0.1]), np.array([200.0, 600])), [True, False])


def test_aperture_rule_integrates_a_disc_exactly() -> None:
    rule = round_aperture(1.0)
    assert rule.weights.sum() == pytest.approx(1)
    # mean of x^2 over a disc of radius R is R^2 / 4, of x^4 R^4 / 8
    assert (rule.weights * rule.along**2).sum() == pytest.approx(0.25 / 4)
    assert (rule.weights * rule.sideways**4).sum() == pytest.approx(0.5**4 / 8)


@pytest.mark.parametrize(("alpha", "peak"), [(0.005, 0.55), (0.01, 0.83), (0.02, 0.95), (0.05, 0.99)])
def test_a_one_degree_aperture_lowers_narrow_peaks(alpha: float, peak: float) -> None:
    zero, green = np.array([0.0]), np.array([550.0])
    ideal = cook_torrance(in_plane(zero, zero), green, alpha, load_conductor())
    seen = measured_cook_torrance(zero, zero, green, alpha, load_conductor(), round_aperture(1.0))
    assert (seen / ideal)[0, 0] == pytest.approx(peak, abs=0.03)


@pytest.mark.parametrize("alpha", [0.0045, 0.18, 0.364])
def test_the_fast_aperture_average_equals_the_full_one(alpha: float) -> None:
    theta_in = np.repeat([0.0, 30, 60, 80], 5)
    theta_out = np.concatenate([np.array([0, 1.0, -3, -40, 24]) + t for t in (0.0, 30, 60, 50)])
    wavelengths = np.array([400.0, 600, 900])
    rule = round_aperture(1.0)
    full = cook_torrance(through_aperture(theta_in, theta_out, rule), wavelengths, alpha, load_conductor(), 1.2, 3.4)
    full = (full * rule.weights[:, None]).sum(axis=1)
    fast = measured_cook_torrance(theta_in, theta_out, wavelengths, alpha, load_conductor(), rule, 1.2, 3.4)
    np.testing.assert_allclose(fast, full, rtol=4e-4)
