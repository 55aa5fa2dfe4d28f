"""Calibration is judged against known truth: counts made here from a known BRDF, lamp and noise."""

from dataclasses import replace

import numpy as np
import pytest

from goniometer.calibration import BANDS, RawScan, Settings, band_values, calibrate, check_certificate, response
from goniometer.campaign import Campaign, Reference, Sample
from goniometer.errors import CalibrationError, CertificateError
from goniometer.geometry import Geometry
from goniometer.instrument import Constants
from goniometer.reference import NOMINAL_SRS99, reference_brdf

WAVELENGTHS = np.linspace(250, 1050, 1044)
POLYNOMIAL = np.array([0.998, 5e-8, -7.5e-13])
GAIN, READ_NOISE, OFFSET, DARK_RATE = 5.0, 6.0, 1500.0, 4.0
LAMP = 1000 * np.exp(-(((WAVELENGTHS - 650) / 180) ** 2))
"""True counts per second for cos(theta_in) f = 1/sr."""
CONSTANTS = Constants("QE Pro QEP00001", {}, WAVELENGTHS, POLYNOMIAL, 200_000, GAIN, 0.005, 1.0)
REFERENCE_ANGLES = [Geometry(t, o) for t in (0.0, 50.0) for o in range(-35, 86, 10)]
SAMPLE_ANGLES = [Geometry(0.0, 12.0), Geometry(0.0, 45.0), Geometry(50.0, -20.0), Geometry(50.0, 50.0)]


def sample_brdf(geometries):
    """A steep lobe with a red tilt, 1/sr."""
    theta_h = np.array([0.5 * (g.theta_out - g.theta_in) for g in geometries])
    return 0.8 * np.exp(-((theta_h / 20) ** 2))[:, None] * (1 + 0.4e-3 * (WAVELENGTHS - 600))


def panel_brdf(geometries):
    theta_in, theta_out = (np.array([getattr(g, n) for g in geometries]) for n in ("theta_in", "theta_out"))
    return reference_brdf(theta_in, theta_out, WAVELENGTHS, NOMINAL_SRS99)


def as_read(true):
    """Dark-subtracted counts x with true = x / polynomial(x), by fixed-point iteration."""
    x = true
    for _ in range(30):
        x = true * np.polynomial.polynomial.polyval(x, POLYNOMIAL)
    return x


def scan(geometries, brdf, time, random, *, scans=1, noisy=True, drift=1.0):
    """A raw scan as the bench would give it."""
    cosine = np.cos(np.radians([g.theta_in for g in geometries]))[:, None]
    true = drift * LAMP * time * cosine * brdf
    if noisy:
        light = np.stack([random.poisson(GAIN * true) / GAIN for _ in range(scans)], axis=1)
        dark_light = random.poisson(GAIN * DARK_RATE * time, light.shape) / GAIN
        counts = as_read(light) + dark_light + OFFSET + random.normal(0, READ_NOISE, light.shape)
        darks = random.poisson(GAIN * DARK_RATE * time, (4, 1044)) / GAIN + OFFSET
        darks = darks + random.normal(0, READ_NOISE, darks.shape)
    else:
        counts = as_read(true)[:, None, :] + OFFSET
        darks = np.full((4, 1044), OFFSET)
    as_counts = np.clip(np.rint(counts), 0, 200_000).astype(np.uint32)
    return RawScan(
        1,
        "a sample",
        CONSTANTS,
        tuple(geometries),
        tuple(geometries),
        np.full(len(geometries), time),
        tuple(as_counts),
        {time: np.rint(darks).astype(np.uint32)},
    )


def test_the_true_brdf_is_recovered_through_dark_nonlinearity_time_and_reference():
    random = np.random.default_rng(0)
    sample = scan(SAMPLE_ANGLES, sample_brdf(SAMPLE_ANGLES), 200.0, random, noisy=False)
    reference = scan(REFERENCE_ANGLES, panel_brdf(REFERENCE_ANGLES), 400.0, random, noisy=False)
    dataset = calibrate(sample, reference, NOMINAL_SRS99)
    truth = np.stack([np.interp(dataset.wavelengths, WAVELENGTHS, row) for row in sample_brdf(SAMPLE_ANGLES)])
    assert dataset.brdf == pytest.approx(truth, rel=2e-3)  # counts are whole numbers
    assert dataset.wavelengths[0] > 380
    assert dataset.wavelengths[-1] < 995
    assert np.all(np.diff(dataset.wavelengths) > 0)


def test_the_stated_uncertainties_are_those_of_repeated_measurements():
    random = np.random.default_rng(1)
    truth_panel, truth_sample = panel_brdf(REFERENCE_ANGLES), sample_brdf(SAMPLE_ANGLES)
    steady_reference = scan(REFERENCE_ANGLES, truth_panel, 30.0, random, noisy=False)
    steady_sample = scan(SAMPLE_ANGLES, truth_sample, 10.0, random, noisy=False)
    by_sample, by_reference = [], []
    for _ in range(30):
        sample = scan(SAMPLE_ANGLES, truth_sample, 10.0, random, scans=2)
        by_sample.append(calibrate(sample, steady_reference, NOMINAL_SRS99))
        reference = scan(REFERENCE_ANGLES, truth_panel, 30.0, random, scans=2)
        by_reference.append(calibrate(steady_sample, reference, NOMINAL_SRS99))
    for datasets, own, dark in (
        (by_sample, "u_random", "u_dark"),
        (by_reference, "u_reference", "u_reference_dark"),
    ):
        spread = np.std([d.brdf for d in datasets], axis=0, ddof=1)
        stated = np.mean([np.hypot(getattr(d, own), getattr(d, dark)) for d in datasets], axis=0)
        # 30 repetitions know each spread to 13 %, and the mean over 134 wavelengths to better than 2 %.
        ratio = np.sqrt(np.mean((spread / stated) ** 2, axis=1))
        assert ratio == pytest.approx(np.ones(len(SAMPLE_ANGLES)), abs=0.08)


def test_dim_ends_of_the_spectrum_are_not_biased():
    random = np.random.default_rng(2)
    truth = sample_brdf(SAMPLE_ANGLES)
    values, steady = [], None
    for _ in range(40):
        sample = scan(SAMPLE_ANGLES, truth, 1.0, random)
        reference = scan(REFERENCE_ANGLES, panel_brdf(REFERENCE_ANGLES), 4.0, random)
        dataset = calibrate(sample, reference, NOMINAL_SRS99)
        steady = dataset if steady is None else steady
        values.append(dataset.brdf)
    expected = np.stack([np.interp(steady.wavelengths, WAVELENGTHS, row) for row in truth])
    bias = np.mean(values, axis=0) / expected - 1
    scatter = np.std(values, axis=0) / expected
    assert np.median(scatter) > 0.02
    # What is left of the bias of a ratio is the square of the relative noise of the response.
    bright = [0, 1, 3]
    assert np.mean(bias[bright]) == pytest.approx(0, abs=0.003)


def test_a_saturated_pixel_has_no_value_and_its_point_is_flagged():
    random = np.random.default_rng(3)
    sample = scan(SAMPLE_ANGLES, sample_brdf(SAMPLE_ANGLES), 400.0, random, noisy=False)
    reference = scan(REFERENCE_ANGLES, panel_brdf(REFERENCE_ANGLES), 100.0, random, noisy=False)
    dataset = calibrate(sample, reference, NOMINAL_SRS99)
    clipped = np.array([np.any(c >= 200_000) for c in sample.counts])
    assert 0 < clipped.sum() < len(clipped)
    assert np.array_equal(dataset.saturated, clipped)
    assert np.array_equal(np.isnan(dataset.brdf).any(axis=1), clipped)
    assert np.isfinite(dataset.brdf[clipped]).any()


def test_a_change_of_the_response_with_angle_is_divided_out():
    random = np.random.default_rng(4)
    tilt = {g: 1 + 0.002 * g.theta_out for g in [*REFERENCE_ANGLES, *SAMPLE_ANGLES]}
    sample_tilt = np.array([[tilt[g]] for g in SAMPLE_ANGLES])
    panel_tilt = np.array([[tilt[g]] for g in REFERENCE_ANGLES])
    sample = scan(SAMPLE_ANGLES, sample_brdf(SAMPLE_ANGLES), 200.0, random, noisy=False, drift=sample_tilt)
    reference = scan(REFERENCE_ANGLES, panel_brdf(REFERENCE_ANGLES), 300.0, random, noisy=False, drift=panel_tilt)
    dataset = calibrate(sample, reference, NOMINAL_SRS99)
    truth = np.stack([np.interp(dataset.wavelengths, WAVELENGTHS, row) for row in sample_brdf(SAMPLE_ANGLES)])
    assert dataset.brdf == pytest.approx(truth, rel=2e-3)  # counts are whole numbers


def test_read_back_angles_are_what_a_dataset_holds():
    random = np.random.default_rng(5)
    sample = scan(SAMPLE_ANGLES, sample_brdf(SAMPLE_ANGLES), 10.0, random)
    read_back = tuple(Geometry(g.theta_in + 0.01, g.theta_out - 0.02) for g in SAMPLE_ANGLES)
    reference = scan(REFERENCE_ANGLES, panel_brdf(REFERENCE_ANGLES), 10.0, random)
    dataset = calibrate(replace(sample, read_back=read_back), reference, NOMINAL_SRS99)
    assert dataset.theta_in == pytest.approx([g.theta_in + 0.01 for g in SAMPLE_ANGLES])
    assert dataset.theta_out == pytest.approx([g.theta_out - 0.02 for g in SAMPLE_ANGLES])


def test_the_plan_sees_cos_f_in_its_bands():
    random = np.random.default_rng(6)
    sample = scan(SAMPLE_ANGLES, sample_brdf(SAMPLE_ANGLES), 100.0, random)
    reference = scan(REFERENCE_ANGLES, panel_brdf(REFERENCE_ANGLES), 100.0, random)
    values, noise = band_values(sample, response(reference, NOMINAL_SRS99))
    centres = [np.mean(band) for band in BANDS]
    cosine = np.cos(np.radians([g.theta_in for g in SAMPLE_ANGLES]))[:, None]
    truth = cosine * np.stack([np.interp(centres, WAVELENGTHS, row) for row in sample_brdf(SAMPLE_ANGLES)])
    assert values == pytest.approx(truth, rel=0.02)
    assert np.all(noise < 0.01 * values)


def test_nothing_is_invented_beyond_the_outermost_reference_point():
    random = np.random.default_rng(11)
    angles = [Geometry(50.0, o) for o in (-35.15, -35.05, 20.0, 85.05, 85.15)]
    sample = scan(angles, sample_brdf(angles), 100.0, random)
    reference = scan(REFERENCE_ANGLES, panel_brdf(REFERENCE_ANGLES), 100.0, random)
    dataset = calibrate(sample, reference, NOMINAL_SRS99)
    for array in (dataset.brdf, dataset.u_random, dataset.u_dark, dataset.u_reference, dataset.u_reference_dark):
        known = np.isfinite(array)
        assert known.all(axis=1).tolist() == known.any(axis=1).tolist() == [False, True, True, True, False]
    values, _ = band_values(sample, response(reference, NOMINAL_SRS99))
    assert np.isnan(values).all(axis=1).tolist() == [True, False, False, False, True]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("400,0.985,0.004\n1000,0.988,0.003\n", "covers 400 to 1000 nm, but 380 to 995 nm"),
        ("350,0.985,0.004\n990,0.988,0.003\n", "covers 350 to 990 nm, but 380 to 995 nm"),
        ("350,98.5,0.4\n", r"panel\.csv, line 6: at least two rows"),
        (None, r"panel\.csv: the certificate cannot be read"),
        ("350,0.985,0.004\n1000,0.988,0.003\n", None),
    ],
)
def test_a_certificate_that_will_not_do_is_refused_before_hours_of_measuring(tmp_path, content, message):
    path = tmp_path / "panel.csv"
    if content is not None:
        path.write_text(
            "# serial_number: P1\n# calibrated: 2024-03-01\n# valid_until: 2025-03-01\n\n"
            "wavelength_nm,reflectance,standard_uncertainty\n" + content
        )
    campaign = Campaign(name="a", samples=(Sample(name="s", material="m"),), reference=Reference(certificate=str(path)))
    if message is None:
        check_certificate(campaign)
    else:
        with pytest.raises(CertificateError, match=message) as caught:
            check_certificate(campaign)
        assert "\n" not in str(caught.value)


def test_a_missing_incident_angle_of_the_reference_is_named():
    random = np.random.default_rng(7)
    sample = scan([Geometry(20.0, 0.0)], sample_brdf([Geometry(20.0, 0.0)]), 10.0, random)
    reference = scan(REFERENCE_ANGLES, panel_brdf(REFERENCE_ANGLES), 10.0, random)
    with pytest.raises(CalibrationError, match="theta_in = 20 deg"):
        calibrate(sample, reference, NOMINAL_SRS99)


def test_a_reference_without_light_is_refused_instead_of_giving_infinite_values():
    random = np.random.default_rng(8)
    sample = scan(SAMPLE_ANGLES, sample_brdf(SAMPLE_ANGLES), 10.0, random)
    reference = scan(REFERENCE_ANGLES, 0 * panel_brdf(REFERENCE_ANGLES), 10.0, random, noisy=False)
    with pytest.raises(CalibrationError, match="no light"):
        calibrate(sample, reference, NOMINAL_SRS99)


def test_missing_darks_and_too_narrow_ranges_are_refused():
    random = np.random.default_rng(9)
    sample = scan(SAMPLE_ANGLES, sample_brdf(SAMPLE_ANGLES), 10.0, random)
    reference = scan(REFERENCE_ANGLES, panel_brdf(REFERENCE_ANGLES), 10.0, random)
    with pytest.raises(CalibrationError, match="10 s"):
        calibrate(replace(sample, darks={}), reference, NOMINAL_SRS99)
    with pytest.raises(CalibrationError, match="two are needed"):
        calibrate(replace(sample, darks={10.0: sample.darks[10.0][:1]}), reference, NOMINAL_SRS99)
    with pytest.raises(CalibrationError, match="no 6 pixels"):
        calibrate(sample, reference, NOMINAL_SRS99, Settings(lowest=500, highest=501))


def test_lineage_says_what_a_dataset_was_made_from():
    random = np.random.default_rng(10)
    sample = replace(scan(SAMPLE_ANGLES, sample_brdf(SAMPLE_ANGLES), 10.0, random), exposure_ids=(5, 6), dark_ids=(4,))
    reference = replace(scan(REFERENCE_ANGLES, panel_brdf(REFERENCE_ANGLES), 10.0, random), scan_id=2)
    lineage = calibrate(sample, reference, NOMINAL_SRS99).lineage
    assert (lineage["scan"], lineage["reference_scan"]) == (1, 2)
    assert (lineage["exposures"], lineage["darks"]) == ([5, 6], [4])
    assert lineage["certificate"] == NOMINAL_SRS99.serial_number
    assert lineage["parameters"] == {"bin_size": 6, "lowest": 380.0, "highest": 995.0, "gain": GAIN}
