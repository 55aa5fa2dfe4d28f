"""Slopes and curvatures of a measured lobe, against closed forms and an independent average over the aperture."""

import numpy as np
import pytest
from scipy.integrate import dblquad

from goniometer.datasets.angular import Derivatives, along_theta_out, aperture_excess, incidence_groups

WAVELENGTHS = 30


def gaussian(theta_out, width=12.0, centre=30.0):
    """A lobe and its derivatives over theta_out, [points, wavelengths]."""
    x = (theta_out - centre)[:, None] + np.zeros(WAVELENGTHS)
    f = np.exp(-0.5 * (x / width) ** 2)
    return f, -x / width**2 * f, (x**2 / width**4 - 1 / width**2) * f


def test_slope_and_curvature_of_a_gaussian_lobe_come_out_right_on_an_uneven_grid():
    theta_out = np.array([10.0, 14, 17, 21, 23, 26, 28, 30, 33, 35, 38, 42, 47])
    f, slope, curvature = gaussian(theta_out)
    shuffled = np.random.default_rng(1).permutation(theta_out.size)
    groups = np.zeros(theta_out.size, dtype=np.intp)
    found = along_theta_out(theta_out[shuffled], groups, f[shuffled], np.full(f.shape, 1e-9))
    # ln f is a parabola, for which three neighbours are exact
    np.testing.assert_allclose(found.first, slope[shuffled], atol=1e-12)
    np.testing.assert_allclose(found.second, curvature[shuffled], atol=1e-12)


def test_points_of_another_incident_angle_are_no_neighbours():
    theta_out = np.array([10.0, 20, 30, 10, 20, 30])
    f = np.concatenate([gaussian(theta_out[:3])[0], 5 + 0 * gaussian(theta_out[:3])[0]])
    found = along_theta_out(theta_out, np.array([0, 0, 0, 1, 1, 1]), f, np.full(f.shape, 1e-9))
    assert np.all(found.first[3:] == 0)
    assert np.all(found.first[:2] > 0)


def test_noise_about_zero_and_missing_values_make_no_wild_slopes():
    theta_out = np.arange(0.0, 60, 5)
    f = 1e-4 * np.random.default_rng(2).standard_normal((theta_out.size, WAVELENGTHS))
    f[3] = np.nan
    found = along_theta_out(theta_out, np.zeros(theta_out.size, dtype=np.intp), f, np.full(f.shape, 1e-4))
    assert np.isfinite(found.first).all()
    assert np.abs(found.first).max() < 1e-4  # at most its own size within a few degrees
    assert np.abs(found.second).max() < 1e-4


def test_positions_that_differ_by_a_stage_error_are_one_incident_angle():
    groups = incidence_groups(np.array([30.004, 10.0, 29.998, 9.997, 60.0]), 0.05)
    assert groups.tolist() == [1, 0, 1, 0, 2]


@pytest.mark.parametrize(("theta_in", "theta_out"), [(30.0, 30.0), (30.0, 42.0), (60.0, 60.0), (50.0, 38.0)])
def test_the_excess_of_the_aperture_is_that_of_an_average_over_a_disc(theta_in, theta_out):
    # a surface on which f depends on the angle of the half vector alone
    width, aperture = 4.0, 1.0

    def f(along, sideways):
        i, out = np.radians(-theta_in), np.radians(theta_out + along)
        s = np.radians(sideways)
        h = np.array([np.sin(i) + np.sin(out) * np.cos(s), np.sin(s), np.cos(i) + np.cos(out) * np.cos(s)])
        return np.exp(-0.5 * (np.degrees(np.arccos(h[2] / np.linalg.norm(h))) / width) ** 2)

    disc = lambda r, a: f(r * np.cos(a), r * np.sin(a)) * r  # noqa: E731
    mean = dblquad(disc, 0, 2 * np.pi, 0, aperture / 2)[0] / (np.pi * aperture**2 / 4)
    step = 0.02
    slope = (f(step, 0) - f(-step, 0)) / (2 * step)
    curvature = (f(step, 0) - 2 * f(0, 0) + f(-step, 0)) / step**2
    slopes = Derivatives(np.array([[slope]]), np.array([[curvature]]))
    excess = aperture_excess(np.array([theta_in]), np.array([theta_out]), slopes, aperture)[0, 0]
    assert excess == pytest.approx(mean - f(0, 0), rel=0.03)
