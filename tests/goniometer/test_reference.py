"""The white reference is neither Lambertian nor creates light, and a bad certificate is refused in words."""

import datetime
from pathlib import Path

import numpy as np
import pytest

from goniometer.errors import CertificateError, GeometryError
from goniometer.reference import (
    NOMINAL_SRS99,
    brf_ratio,
    parse_certificate,
    read_certificate,
    reference_brdf,
    reference_relative_uncertainty,
    spectralon_brf_ratio,
)

GOOD = """\
# serial_number: SRS-99-010-0001
# calibrated: 2024-03-01
# valid_until: 2025-03-01
# a comment of the laboratory
wavelength_nm,reflectance,standard_uncertainty
400,0.985,0.004
600,0.990,0.003
800,0.988,0.003
"""


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


@pytest.mark.parametrize("theta_i", [0.0, 8.0, 40.0, 65.0, 80.0])
def test_the_panel_sends_back_exactly_the_certified_share_of_the_light(theta_i: float) -> None:
    # the midpoint rule with far more nodes than the model's own quadrature, over the whole circle; an even number
    # of azimuths, because one exactly at 180 degrees would sit on the model's spike at grazing angles
    zenith = (np.arange(600) + 0.5) / 600 * 90
    azimuth = (np.arange(720) + 0.5) / 720 * 360
    wavelengths = np.array([300.0, 600, 1000])
    grid_azimuth, grid_zenith = (grid.ravel() for grid in np.meshgrid(azimuth, zenith))
    ratio = brf_ratio(grid_azimuth, grid_zenith, np.full(grid_zenith.size, theta_i), wavelengths)
    t = np.radians(grid_zenith)
    solid_angle = np.cos(t) * np.sin(t) * (np.pi / 2 / zenith.size) * (2 * np.pi / azimuth.size)
    np.testing.assert_allclose(solid_angle @ ratio / np.pi, 1, atol=1e-5)


def test_the_brdf_is_reflectance_times_ratio_over_pi_with_points_first() -> None:
    theta_in, theta_out, wavelengths = np.array([0.0, 45]), np.array([45.0, 45]), np.array([500.0, 600, 700])
    brdf = reference_brdf(theta_in, theta_out, wavelengths, NOMINAL_SRS99)
    assert brdf.shape == (2, 3)
    assert brdf[1, 1] == pytest.approx(0.988 * 1.07112 / np.pi, rel=2e-5)


def test_the_nominal_panel_lies_within_what_certificates_of_such_panels_say() -> None:
    at_250, at_600 = NOMINAL_SRS99.reflectance(np.array([250.0, 600.0]))
    assert 0.951 <= at_250 <= 0.956
    assert 0.987 <= at_600 <= 0.989


def test_stated_uncertainty_is_that_of_the_comparison_with_nist_and_grows_where_the_model_extrapolates() -> None:
    u = reference_relative_uncertainty(np.array([0.0, 70, 70, 80, 10]), np.array([45.0, -70, 75, 0, -85]))
    np.testing.assert_allclose(u[:2], 0.009)
    assert 0.009 < u[2] < u[3] < u[4] == pytest.approx(0.05)


def test_directions_below_the_horizon_and_uncertified_wavelengths_are_refused() -> None:
    with pytest.raises(GeometryError, match="95 deg"):
        spectralon_brf_ratio(np.array([10.0]), np.array([-95.0]), np.array([600.0]))
    with pytest.raises(CertificateError, match="nominal SRS-99 covers 250 to 1050 nm"):
        reference_brdf(np.array([10.0]), np.array([20.0]), np.array([600.0, 1100.0]), NOMINAL_SRS99)


def test_a_laboratorys_own_certificate_replaces_the_nominal_one(tmp_path: Path) -> None:
    path = tmp_path / "panel.csv"
    path.write_text(GOOD, encoding="utf-8")
    certificate = parse_certificate(read_certificate(path), str(path))
    assert certificate.serial_number == "SRS-99-010-0001"
    assert certificate.calibrated == datetime.date(2024, 3, 1)
    assert certificate.valid_until == datetime.date(2025, 3, 1)
    np.testing.assert_allclose(certificate.reflectance(np.array([400.0, 500, 800])), [0.985, 0.9875, 0.988])
    np.testing.assert_allclose(certificate.u_reflectance, [0.004, 0.003, 0.003])


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("600,0.990", "600,99.0", r"line 7: reflectance 99 is impossible"),
        ("600,0.990,0.003", "600;0,990;0,003", r"line 7: .* three numbers"),
        ("600,0.990,0.003", "600,0.990", r"line 7: .* three numbers"),
        ("600,0.990,0.003", "600,nan,0.003", r"line 7: reflectance nan"),
        ("600,0.990,0.003", "600,0.99,-0.1", r"line 7: standard uncertainty -0.1"),
        ("600,0.990", "300,0.990", r"line 7: 300 nm is out of order"),
        ("2024-03-01", "1 March 2024", r"line 2: '1 March 2024' is not a day"),
        ("2025-03-01", "2023-03-01", r"line 3: .* before the calibration"),
        ("# valid_until: 2025-03-01\n", "", r"'# valid_until: \.\.\.' is missing"),
        ("SRS-99-010-0001", "", r"line 1: serial_number has no value"),
        ("wavelength_nm", "lambda", r"line 5: the columns must be"),
        ("600,0.990,0.003\n800,0.988,0.003\n", "", r"line 6: at least two rows"),
    ],
)
def test_a_typing_error_in_a_certificate_is_named_with_its_line(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    path = tmp_path / "panel.csv"
    assert old in GOOD
    path.write_text(GOOD.replace(old, new), encoding="utf-8")
    with pytest.raises(CertificateError, match=message):
        parse_certificate(read_certificate(path), str(path))


def test_a_file_that_is_missing_empty_or_no_text_is_refused_in_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(CertificateError, match=r"nowhere\.csv: the certificate cannot be read"):
        read_certificate(tmp_path / "nowhere.csv")
    (tmp_path / "empty.csv").write_text("", encoding="utf-8")
    with pytest.raises(CertificateError, match="is missing"):
        parse_certificate("", "empty.csv")
    (tmp_path / "binary.csv").write_bytes(b"\xff\xfe\x00\x80")
    with pytest.raises(CertificateError, match="not a text file"):
        read_certificate(tmp_path / "binary.csv")


def test_source_and_detector_may_change_places_within_the_stated_uncertainty() -> None:
    # Helmholtz reciprocity; the model was not built to keep it, so the rest measures how good it is
    angles = np.arange(0.0, 71.0, 5)
    theta_in, theta_out = (grid.ravel() for grid in np.meshgrid(angles, np.concatenate([-angles[1:], angles])))
    swapped_in, swapped_out = np.abs(theta_out), np.copysign(theta_in, theta_out)
    there = spectralon_brf_ratio(theta_in, theta_out, np.array([600.0]))
    back = spectralon_brf_ratio(swapped_in, swapped_out, np.array([600.0]))
    difference = there / back - 1
    assert np.sqrt(np.mean(difference**2)) < 0.009
    assert np.abs(difference).max() < 0.02
