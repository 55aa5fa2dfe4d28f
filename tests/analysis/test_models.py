"""The models agree with published values and closed forms."""

import numpy as np
import pytest

from analysis.directions import in_plane, round_aperture, through_aperture
from analysis.distributions import g1, ndf
from analysis.errors import OutOfRange
from analysis.fresnel import fresnel_conductor, load_conductor
from analysis.models import cook_torrance, cosine_slope, measured_cook_torrance, shift, shift_is_clamped, theta_m


def test_aluminium_reflects_as_cheng_2016_says() -> None:
    aluminium = load_conductor()
    n, k = aluminium.index(np.array([600.0]))
    assert n[0] == pytest.approx(0.7308, abs=5e-5)
    assert k[0] == pytest.approx(5.7568, abs=5e-5)
    wavelengths = np.array([400.0, 550, 600, 700, 800])
    normal = fresnel_conductor(np.array([1.0]), *aluminium.index(wavelengths))
    np.testing.assert_allclose(normal, [0.9222, 0.9222, 0.9191, 0.9042, 0.8703], atol=1e-4)
    oblique = fresnel_conductor(np.array([0.5]), n, k)
    assert oblique[0] == pytest.approx(0.905557, abs=2e-5)


def test_wavelengths_beyond_the_table_are_refused_and_not_invented() -> None:
    with pytest.raises(OutOfRange, match=r"225\.43 to 999\.87 nm"):
        load_conductor().index(np.array([1050.0]))


@pytest.mark.parametrize("alpha", [0.01, 0.1, 0.364, 0.8])
def test_ggx_normals_project_onto_the_unit_area(alpha: float) -> None:
    # substitution tan(theta) = alpha tan(s) keeps the integrand smooth for narrow lobes
    s = np.linspace(0, np.pi / 2, 20001)[1:-1]
    theta = np.arctan(alpha * np.tan(s))
    dtheta = alpha / np.cos(s) ** 2 / (1 + (alpha * np.tan(s)) ** 2)
    integrand = ndf(np.cos(theta), alpha) * np.cos(theta) * 2 * np.pi * np.sin(theta) * dtheta
    assert np.trapezoid(integrand, s) == pytest.approx(1, abs=1e-6)


def test_masking_is_one_at_normal_incidence_and_none_at_the_horizon() -> None:
    assert g1(np.array([1.0]), 0.3)[0] == pytest.approx(1)
    assert g1(np.array([1e-6]), 0.3)[0] == pytest.approx(0, abs=1e-5)


def test_half_vector_angle_in_plane_is_half_the_difference_of_the_signed_angles() -> None:
    theta_in, theta_out = np.array([0.0, 40, 40, 70]), np.array([30.0, 40, -60, 85])
    directions = in_plane(theta_in, theta_out)
    np.testing.assert_allclose(theta_m(directions), np.abs(theta_out - theta_in) / 2, atol=1e-5)
    np.testing.assert_allclose(directions.cos_d, np.cos(np.radians(theta_in + theta_out) / 2), atol=1e-12)


def test_models_are_reciprocal() -> None:
    wavelengths = np.array([450.0, 600, 750])
    there = cook_torrance(in_plane(np.array([20.0]), np.array([65.0])), wavelengths, 0.2, load_conductor(), 1.2, 3.4)
    back = cook_torrance(in_plane(np.array([65.0]), np.array([20.0])), wavelengths, 0.2, load_conductor(), 1.2, 3.4)
    np.testing.assert_allclose(there, back, rtol=1e-12)


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
