"""A certificate gives the BRDF that its laboratory certified, with its errors; a bad or stale one is refused."""

import datetime
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from drivers.arrays import FloatArray
from goniometer.certificates.certificate import (
    NOMINAL_SRS99,
    BrdfTable,
    Certificate,
    Override,
    PanelCertificate,
    check_validity,
)
from goniometer.certificates.certificate_file import certificate_csv, parse_certificate, read_certificate
from goniometer.certificates.reference import reference_relative_uncertainty
from goniometer.errors import CertificateError

HEADER = """\
# serial_number: SRS-99-010-0001
# calibrated: 2024-03-01
# valid_until: 2025-03-01
# a comment of the laboratory
"""
REFLECTANCE = (
    HEADER
    + """\
wavelength_nm,reflectance,standard_uncertainty
400,0.985,0.004
600,0.990,0.003
800,0.988,0.003
"""
)
BRDF = (
    HEADER
    + """\
theta_in,theta_out,wavelength_nm,brdf,standard_uncertainty
0,-60,400,0.30,0.003
0,60,400,0.31,0.003
0,-60,800,0.32,0.003
0,60,800,0.33,0.003
50,-60,400,0.34,0.003
50,60,400,0.35,0.003
50,-60,800,0.36,0.003
50,60,800,0.37,0.003
"""
)


def _trilinear(theta_in: FloatArray, theta_out: FloatArray, wavelengths: FloatArray) -> FloatArray:
    """A panel whose BRDF interpolation must give back exactly, of the shape that its arguments make together."""
    return 0.3 * (1 + 0.002 * theta_in) * (1 - 0.001 * theta_out) * (0.9 + wavelengths / 1e4)


def _table() -> BrdfTable:
    theta_in, theta_out = np.array([0.0, 30, 45, 80]), np.array([-80.0, -20, 0, 35, 80])
    wavelengths = np.array([350.0, 500, 1000])
    values = _trilinear(theta_in[:, None, None], theta_out[:, None], wavelengths)
    u_values = np.broadcast_to(0.002 + wavelengths / 1e6, values.shape)
    days = datetime.date(2024, 3, 1), datetime.date(2025, 3, 1)
    return BrdfTable("T-1", *days, theta_in, theta_out, wavelengths, values, u_values)


def test_the_brdf_is_reflectance_times_ratio_over_pi_with_points_first() -> None:
    theta_in, theta_out, wavelengths = np.array([0.0, 45]), np.array([45.0, 45]), np.array([500.0, 600, 700])
    brdf = NOMINAL_SRS99.brdf(theta_in, theta_out, wavelengths)
    assert brdf.shape == (2, 3)
    assert brdf[1, 1] == pytest.approx(0.988 * 1.07112 / np.pi, rel=2e-5)


def test_the_nominal_panel_lies_within_what_certificates_of_such_panels_say() -> None:
    at_250, at_600 = NOMINAL_SRS99.reflectance(np.array([250.0, 600.0]))
    assert 0.951 <= at_250 <= 0.956
    assert 0.987 <= at_600 <= 0.989


def test_directions_near_each_other_share_the_error_of_the_panel_model_and_opposite_ones_do_not() -> None:
    theta_in, theta_out = np.array([10.0, 10, 60, 80, 0]), np.array([0.0, 45, -45, 85, -80])
    errors = NOMINAL_SRS99.errors(theta_in, theta_out, np.array([300.0, 600]))
    assert {change.shape for change in errors.values()} == {(5, 2)}
    np.testing.assert_allclose(errors.pop("certificate"), [[0.0045 / 0.974, 0.003 / 0.988]] * 5)
    modes = np.array([change[:, 0] for change in errors.values()])
    np.testing.assert_allclose(np.sqrt((modes**2).sum(axis=0)), reference_relative_uncertainty(theta_in, theta_out))
    apart = np.radians(theta_out[:, None] - theta_out)
    unit = modes / np.sqrt((modes**2).sum(axis=0))
    np.testing.assert_allclose(unit.T @ unit, np.cos(apart / 2) ** 2, atol=1e-12)


def test_a_table_gives_the_certified_brdf_between_its_rows() -> None:
    rng = np.random.default_rng(3)
    theta_in, theta_out = rng.uniform(0, 80, 50), rng.uniform(-80, 80, 50)
    wavelengths = np.array([350.0, 351.3, 600, 1000])
    expected = _trilinear(theta_in[:, None], theta_out[:, None], wavelengths)
    brdf = _table().brdf(theta_in, theta_out, wavelengths)
    np.testing.assert_allclose(brdf, expected, rtol=1e-12)
    errors = _table().errors(theta_in, theta_out, wavelengths)
    assert list(errors) == ["certificate"]
    np.testing.assert_allclose(errors["certificate"], (0.002 + wavelengths / 1e6) / expected, rtol=1e-12)


def test_the_error_of_a_stage_does_not_push_a_point_off_the_table() -> None:
    theta_in, theta_out = np.array([-0.01, 80.05, 45]), np.array([35.0, 35, -80.05])
    at_the_edge = _trilinear(np.array([0.01, 80, 45]), np.array([-35.0, 35, -80]), np.array(500.0))
    np.testing.assert_allclose(_table().brdf(theta_in, theta_out, np.array([500.0]))[:, 0], at_the_edge, rtol=1e-12)


@pytest.mark.parametrize(
    ("theta_in", "theta_out", "wavelength", "message"),
    [
        (81.0, 0.0, 500.0, "T-1 covers theta_in from 0 to 80 deg, but 81 to 81 deg is needed"),
        (0.0, -85.0, 500.0, "T-1 covers theta_out from -80 to 80 deg, but -85 to -85 deg is needed"),
        (0.0, 10.0, 300.0, "T-1 covers 350 to 1000 nm, but 300 to 300 nm is needed"),
    ],
)
def test_nothing_beyond_a_table_is_invented(theta_in: float, theta_out: float, wavelength: float, message: str) -> None:
    needed = np.array([theta_in]), np.array([theta_out]), np.array([wavelength])
    with pytest.raises(CertificateError, match=message):
        _table().brdf(*needed)
    with pytest.raises(CertificateError, match=message):
        _table().errors(*needed)


@pytest.mark.parametrize("certificate", [NOMINAL_SRS99, _table()], ids=["reflectance", "table"])
def test_wavelengths_that_nobody_certified_are_refused_before_anything_is_measured(
    certificate: PanelCertificate,
) -> None:
    certificate.check_covers(400, 1000)
    with pytest.raises(CertificateError, match=f"{certificate.serial_number} covers .* nm, but 400 to 1100 nm is"):
        certificate.check_covers(400, 1100)
    with pytest.raises(CertificateError, match=r"covers .* nm"):
        certificate.brdf(np.array([10.0]), np.array([20.0]), np.array([600.0, 1100.0]))


def test_a_laboratorys_own_certificate_replaces_the_nominal_one(tmp_path: Path) -> None:
    path = tmp_path / "panel.csv"
    path.write_text(REFLECTANCE, encoding="utf-8")
    certificate = parse_certificate(read_certificate(path), str(path))
    assert isinstance(certificate, Certificate)
    assert certificate.serial_number == "SRS-99-010-0001"
    assert certificate.calibrated == datetime.date(2024, 3, 1)
    assert certificate.valid_until == datetime.date(2025, 3, 1)
    np.testing.assert_allclose(certificate.reflectance(np.array([400.0, 500, 800])), [0.985, 0.9875, 0.988])
    np.testing.assert_allclose(certificate.u_reflectance, [0.004, 0.003, 0.003])


def test_the_tabs_of_a_laboratory_and_the_marks_of_a_spreadsheet_are_no_obstacle(tmp_path: Path) -> None:
    header = HEADER.replace("\n", ",,\n")
    table = "wavelength_nm\treflectance\tstandard_uncertainty\n250\t0.95\t0.005\n251\t0.96\t0.005\n"
    path = tmp_path / "panel.txt"
    path.write_bytes(b"\xef\xbb\xbf" + (header + table).replace("\n", "\r\n").encode())
    certificate = parse_certificate(read_certificate(path), str(path))
    assert (certificate.serial_number, certificate.valid_until) == ("SRS-99-010-0001", datetime.date(2025, 3, 1))
    np.testing.assert_array_equal(certificate.wavelengths, [250, 251])


def test_the_rows_of_a_table_may_stand_in_any_order() -> None:
    lines = BRDF.splitlines()
    shuffled = [*lines[:5], *np.random.default_rng(5).permutation(lines[5:]).tolist()]
    table = parse_certificate("\n".join(shuffled), "panel.csv")
    assert isinstance(table, BrdfTable)
    np.testing.assert_array_equal(table.theta_out, [-60, 60])
    expected = [[[0.30, 0.32], [0.31, 0.33]], [[0.34, 0.36], [0.35, 0.37]]]
    np.testing.assert_array_equal(table.values, expected)
    np.testing.assert_array_equal(table.u_values, np.full((2, 2, 2), 0.003))


@pytest.mark.parametrize(
    "certificate",
    [
        NOMINAL_SRS99,
        replace(
            NOMINAL_SRS99,
            calibrated=datetime.date(2024, 2, 29),
            valid_until=datetime.date(2026, 2, 28),
            wavelengths=np.sort(np.random.default_rng(1).uniform(250, 1100, 11)),
        ),
        _table(),
    ],
    ids=["nominal", "reflectance", "table"],
)
def test_a_certificate_that_was_written_down_reads_back_to_the_last_bit(certificate: PanelCertificate) -> None:
    again = parse_certificate(certificate_csv(certificate), "panel.csv")
    assert type(again) is type(certificate)
    for field in fields(certificate):
        np.testing.assert_array_equal(getattr(again, field.name), getattr(certificate, field.name))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("600,0.990", "600,99.0", r"line 7: reflectance 99 is impossible"),
        ("600,0.990,0.003", "600;0,990;0,003", r"line 7: .* 3 numbers"),
        ("600,0.990,0.003", "600,0.990", r"line 7: .* 3 numbers"),
        ("600,0.990,0.003", "600,nan,0.003", r"line 7: reflectance nan"),
        ("600,0.990,0.003", "600,0.99,-0.1", r"line 7: standard uncertainty -0.1"),
        ("600,0.990", "300,0.990", r"line 7: 300 nm is out of order"),
        ("2024-03-01", "1 March 2024", r"line 2: '1 March 2024' is not a day"),
        ("2024-03-01", "never", r"line 3: what was never calibrated"),
        ("2025-03-01", "2023-03-01", r"line 3: .* before the calibration"),
        ("# a comment of the laboratory", "# valid_until: 2026-01-01", r"line 4: valid_until stands in line 3 already"),
        ("# valid_until: 2025-03-01\n", "", r"'# valid_until: \.\.\.' is missing"),
        ("SRS-99-010-0001", "", r"line 1: serial_number has no value"),
        ("wavelength_nm", "lambda", r"line 5: the columns must be"),
        ("600,0.990,0.003\n800,0.988,0.003\n", "", r"line 6: at least two rows"),
    ],
)
def test_a_typing_error_in_a_certificate_is_named_with_its_line(old: str, new: str, message: str) -> None:
    assert old in REFLECTANCE
    with pytest.raises(CertificateError, match=f"^panel.csv(, |: .*){message}"):
        parse_certificate(REFLECTANCE.replace(old, new), "panel.csv")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("0,60,400,0.31", "0,60,400", r"line 7: .* 5 numbers"),
        ("0,60,400,0.31", "0,95,400,0.31", r"line 7: theta_in = 0 and theta_out = 95 deg are no directions"),
        ("0,60,400,0.31", "-5,60,400,0.31", r"line 7: theta_in = -5 and theta_out = 60 deg are no directions"),
        ("0,60,400,0.31", "0,nan,400,0.31", r"line 7: theta_in = 0 and theta_out = nan deg"),
        ("0,60,400,0.31", "0,60,inf,0.31", r"line 7: inf nm is no wavelength"),
        ("0,60,400,0.31", "0,60,400,-0.31", r"line 7: a BRDF of -0.31 1/sr is impossible"),
        ("0.31,0.003", "0.31,1", r"line 7: standard uncertainty 1 is impossible"),
        ("0,60,400,0.31", "0,-60,400,0.31", r"line 7: .* stand in line 6 already"),
        ("0,60,400,0.31,0.003\n", "", r"the row theta_in = 0 deg, theta_out = 60 deg, 400 nm is missing"),
        ("0,60,400", "0.5,60,400", r"the row theta_in = 0 deg, theta_out = 60 deg, 400 nm is missing"),
        (",0.3", ",1.3", r"no BRDF is below 0.5 1/sr, .* divide radiance factors by pi"),
        (",-60,", ",60,", r"line 7: .* stand in line 6 already"),
        ("50,", "0,", r"line 10: .* stand in line 6 already"),
        (
            "50,-60,400,0.34,0.003\n50,60,400,0.35,0.003\n50,-60,800,0.36,0.003\n50,60,800,0.37,0.003\n",
            "",
            r"the column theta_in has only the value 0; two are needed",
        ),
    ],
)
def test_a_typing_error_in_a_table_is_named_with_its_line(old: str, new: str, message: str) -> None:
    assert old in BRDF
    with pytest.raises(CertificateError, match=f"^panel.csv(, |: ){message}"):
        parse_certificate(BRDF.replace(old, new), "panel.csv")


def test_a_file_that_is_missing_empty_or_no_text_is_refused_in_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(CertificateError, match=r"nowhere\.csv: the certificate cannot be read"):
        read_certificate(tmp_path / "nowhere.csv")
    with pytest.raises(CertificateError, match="is missing"):
        parse_certificate("", "empty.csv")
    with pytest.raises(CertificateError, match="line 1: the columns must be"):
        parse_certificate(HEADER, "headers.csv")
    (tmp_path / "binary.csv").write_bytes(b"\xff\xfe\x00\x80")
    with pytest.raises(CertificateError, match="not a text file"):
        read_certificate(tmp_path / "binary.csv")


@pytest.mark.parametrize("day", [datetime.date(2024, 3, 1), datetime.date(2024, 9, 9), datetime.date(2025, 3, 1)])
def test_a_certificate_that_is_valid_needs_nobodys_word(day: datetime.date) -> None:
    certificate = parse_certificate(REFLECTANCE, "panel.csv")
    assert check_validity(certificate, day, None) is None
    assert check_validity(certificate, day, Override("A. Meyer", "to be sure")) is None


@pytest.mark.parametrize(
    ("certificate", "day", "fault"),
    [
        (NOMINAL_SRS99, datetime.date(2024, 9, 9), "nominal SRS-99 is nominal: nobody has measured this panel"),
        (_table(), datetime.date(2024, 2, 29), "T-1 dates from 2024-03-01, after the reference scan of 2024-02-29"),
        (_table(), datetime.date(2025, 3, 2), "T-1 expired on 2025-03-01, before the reference scan of 2025-03-02"),
    ],
    ids=["nominal", "too new", "expired"],
)
def test_nobody_calibrates_with_a_stale_or_missing_certificate_unless_somebody_answers_for_it(
    certificate: PanelCertificate, day: datetime.date, fault: str
) -> None:
    with pytest.raises(CertificateError, match=f"{fault}; name a certificate .* valid on {day}, or override this"):
        check_validity(certificate, day, None)
    sentence = check_validity(certificate, day, Override("A. Meyer", "the panel was kept in the dark"))
    assert sentence is not None
    for part in (fault, "A. Meyer", "the panel was kept in the dark"):
        assert part in sentence


@pytest.mark.parametrize(("name", "reason"), [("", "why not"), ("A. Meyer", " ")])
def test_nobody_overrides_without_a_name_and_a_reason(name: str, reason: str) -> None:
    with pytest.raises(CertificateError, match="both the name of who decides and a reason"):
        Override(name, reason)
