"""The white reference is neither Lambertian nor creates light, and as reciprocal as is stated."""

import numpy as np
import pytest

from drivers.arrays import FloatArray
from goniometer.certificates.reference import brf_ratio, reference_relative_uncertainty, spectralon_brf_ratio
from goniometer.errors import GeometryError


@pytest.mark.parametrize(
    ("azimuth", "theta_v", "theta_i", "wavelength", "published"),
    [
        (52.5, 13.7, 22.2, 800, 1.04625),
        (128.6, 50.1, 53.5, 1221, 1.04470),
        (230.2, 22.8, 28.4, 1848, 1.04017),
        (180, 0, 45, 600, 1.01203),
        (180, 45, 45, 600, 1.07112),
        (0, 60, 30, 600, 0.93810),
    ],
)
def test_every_brdf_would_be_off_if_the_panel_model_were_not_the_published_one(
    azimuth: float, theta_v: float, theta_i: float, wavelength: float, published: float
) -> None:
    value = brf_ratio(np.array([azimuth]), np.array([theta_v]), np.array([theta_i]), np.array([wavelength]))
    assert value.shape == (1, 1)
    assert value[0, 0] == pytest.approx(published, abs=1e-5)


def test_forward_and_backward_are_not_swapped_in_plane() -> None:
    theta_in, theta_out = np.array([45.0, 30.0, -30.0]), np.array([45.0, -60.0, 60.0])
    value = spectralon_brf_ratio(theta_in, theta_out, np.array([600.0]))
    np.testing.assert_allclose(value[:, 0], [1.07112, 0.93810, 0.93810], atol=1e-5)


def _returned(theta_i: float, zeniths: int, wavelengths: FloatArray) -> FloatArray:
    """Share of the certified reflectance that leaves in all directions together, [wavelengths].

    The midpoint rule, no part of the model's own quadrature, over the whole circle; an even number of azimuths,
    because one exactly at 180 degrees would sit on the model's spike at grazing angles.
    """
    zenith = (np.arange(zeniths) + 0.5) / zeniths * 90
    azimuth = (np.arange(zeniths) + 0.5) / zeniths * 360
    azimuths, zeniths_ = (grid.ravel() for grid in np.meshgrid(azimuth, zenith))
    ratio = brf_ratio(azimuths, zeniths_, np.full(azimuths.size, theta_i), wavelengths)
    t = np.radians(zeniths_)
    solid_angle = np.cos(t) * np.sin(t) * np.pi**2 / zeniths**2
    return np.asarray(solid_angle @ ratio / np.pi)


@pytest.mark.parametrize("theta_i", [0.0, 8.0, 40.0, 65.0, 80.0])
def test_the_panel_sends_back_exactly_the_certified_share_of_the_light(theta_i: float) -> None:
    np.testing.assert_allclose(_returned(theta_i, 600, np.array([300.0, 600, 1000])), 1, atol=1e-5)


def test_stated_uncertainty_is_that_of_the_comparison_with_nist_and_grows_where_the_model_extrapolates() -> None:
    u = reference_relative_uncertainty(np.array([0.0, 70, 70, 80, 10]), np.array([45.0, -70, 75, 0, -85]))
    np.testing.assert_allclose(u[:2], 0.009)
    assert 0.009 < u[2] < u[3] < u[4] == pytest.approx(0.05)


def test_directions_below_the_horizon_are_refused() -> None:
    with pytest.raises(GeometryError, match="95 deg"):
        spectralon_brf_ratio(np.array([10.0]), np.array([-95.0]), np.array([600.0]))


def _asymmetry(azimuth: FloatArray, theta_v: FloatArray, theta_i: FloatArray) -> FloatArray:
    wavelengths = np.array([300.0, 600])
    return np.asarray(
        brf_ratio(azimuth, theta_v, theta_i, wavelengths) / brf_ratio(azimuth, theta_i, theta_v, wavelengths) - 1
    )


@pytest.mark.parametrize(
    ("azimuths", "stated_rms"),
    [(np.array([0.0, 180]), 0.0058), (np.arange(0.0, 181, 5), 0.0046)],
    ids=["plane", "hemisphere"],
)
def test_source_and_detector_may_change_places_to_the_degree_that_is_stated(
    azimuths: FloatArray, stated_rms: float
) -> None:
    # Helmholtz reciprocity; the model was not built to keep it, so the rest measures how good it is
    angles = np.arange(0.0, 71, 2.5)
    grid = (axis.ravel() for axis in np.meshgrid(azimuths, angles, angles, indexing="ij"))
    difference = _asymmetry(*grid)
    assert np.sqrt(np.mean(difference[:, 1] ** 2)) == pytest.approx(stated_rms, abs=1e-4)
    assert np.abs(difference[:, 1]).max() == pytest.approx(0.0143, abs=1e-4)
    assert np.abs(difference[:, 0]).max() == pytest.approx(0.0149, abs=1e-4)


def test_forward_and_back_hardly_differ_at_normal_incidence() -> None:
    theta_out = np.array([5.0, 30, 60, 80])
    there, back = (spectralon_brf_ratio(np.full(4, 0.001), s * theta_out, np.array([600.0])) for s in (1, -1))
    assert np.abs(there / back - 1).max() < 0.0015


@pytest.mark.parametrize("theta_i", np.arange(0.0, 70.1, 2.5))
def test_the_panel_neither_makes_nor_swallows_light_at_any_angle_up_to_70_degrees(theta_i: float) -> None:
    assert _returned(theta_i, 150, np.array([600.0])) == pytest.approx(1, abs=1e-3)
