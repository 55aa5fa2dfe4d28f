"""Calibration is judged against known truth: counts computed forwards from a known BRDF, lamp and noise."""

import re
from dataclasses import replace
from datetime import date

import numpy as np
import pytest
from scipy.integrate import quad
from uncertainties import ufloat, umath

from goniometer.campaigns.campaign import Campaign
from goniometer.certificates.certificate import NOMINAL_SRS99, Override
from goniometer.datasets.dataset import Flag
from goniometer.errors import CalibrationError, CertificateError
from goniometer.geometry import Geometry
from goniometer.radiometry.calibration import BANDS, band_values, calibrate, check_certificate
from goniometer.radiometry.raw import sample_visits
from goniometer.radiometry.response import CORRECTIONS, STANDARD, Settings, response
from tests.goniometer.forward import (
    CONSTANTS,
    DATA,
    FULL,
    GAIN,
    POLYNOMIAL,
    RIGHT,
    WAVELENGTHS,
    Bench,
    Wrong,
    as_read,
    lobe,
    spectralon,
    truth,
)

REFERENCE_ANGLES = [Geometry(t, o) for t in (0.0, 50.0) for o in range(-35, 86, 10)]
SAMPLE_ANGLES = [Geometry(0.0, 12.0), Geometry(0.0, 45.0), Geometry(50.0, -20.0), Geometry(50.0, 50.0)]
ROUGH = lobe(0.3)


def ideal(angles=SAMPLE_ANGLES, brdf=ROUGH, times=10.0, wrong=RIGHT, settings=STANDARD, **options):
    """What calibration makes of a noiseless measurement, and the truth at its points."""
    bench = Bench(wrong, noisy=False)
    reference = bench.scan(REFERENCE_ANGLES, spectralon(wrong), 60.0, scan_id=1, **options)
    sample = bench.scan(angles, brdf, times, scan_id=2, **options)
    dataset = calibrate(sample, reference, NOMINAL_SRS99, settings)
    return dataset, truth(angles, brdf, dataset.wavelengths)


def lighted(dataset):
    """Wavelengths at which whole counts are fine enough."""
    return (dataset.wavelengths > 450) & (dataset.wavelengths < 850)


def part(dataset, name):
    """Combined standard uncertainty of the sources of a part."""
    return np.sqrt(sum(s.values**2 for s in dataset.sources if s.part == name))


def test_the_true_brdf_is_recovered_through_dark_nonlinearity_time_and_reference():
    dataset, true = ideal(times=20.0)
    lit = lighted(dataset)
    assert lit.sum() > 80
    assert dataset.brdf[:, lit] == pytest.approx(true[:, lit], rel=5e-4)  # counts are whole numbers
    assert dataset.wavelengths[0] > 380
    assert dataset.wavelengths[-1] < 995
    assert np.all(np.diff(dataset.wavelengths) > 0)


def test_the_uncertainties_of_counts_are_those_of_repeated_measurements():
    steady = Bench(noisy=False)
    steady_reference = steady.scan(REFERENCE_ANGLES, spectralon(), 30.0)
    steady_sample = steady.scan(SAMPLE_ANGLES, ROUGH, 5.0)
    by_sample, by_reference = [], []
    for seed in range(30):
        bench = Bench(seed=seed)
        sample = bench.scan(SAMPLE_ANGLES, ROUGH, 5.0, scans=2)
        by_sample.append(calibrate(sample, steady_reference, NOMINAL_SRS99))
        reference = bench.scan(REFERENCE_ANGLES, spectralon(), 30.0, scans=2)
        by_reference.append(calibrate(steady_sample, reference, NOMINAL_SRS99))
    for datasets, names in (
        (by_sample, {"random", "dark: 5 s"}),
        (by_reference, {"reference: counts", "reference: dark"}),
    ):
        spread = np.std([d.brdf for d in datasets], axis=0, ddof=1)
        stated = np.mean([np.sqrt(sum(s.values**2 for s in d.sources if s.name in names)) for d in datasets], axis=0)
        # 30 repetitions know each spread to 13 %, and the mean over 134 wavelengths to better than 2 %.
        ratio = np.sqrt(np.mean((spread / stated) ** 2, axis=1))
        assert ratio == pytest.approx(np.ones(len(SAMPLE_ANGLES)), abs=0.08)


def test_the_parts_of_a_small_case_are_those_of_the_uncertainties_package():
    # one point, one pixel, two reference points; every number with its error, propagated by automatic differentiation
    bench = Bench(seed=5)
    angles, between = [Geometry(50.0, 20.0), Geometry(50.0, 30.0)], [Geometry(50.0, 24.0)]
    reference, sample = bench.scan(angles, spectralon(), 40.0), bench.scan(between, ROUGH, 10.0, scans=3)
    pixel = 600
    wavelength = WAVELENGTHS[pixel]
    settings = Settings(bin_size=1, lowest=wavelength - 0.1, highest=wavelength + 0.1)
    dataset = calibrate(sample, reference, NOMINAL_SRS99, settings)

    scale = ufloat(0, DATA.u_nonlinearity, "non-linearity")
    panel = [ufloat(0, 1, f"panel {i}") for i in range(4)]
    errors = NOMINAL_SRS99.errors(np.array([50.0, 50.0]), np.array([20.0, 30.0]), np.array([wavelength]))

    def rate(raw, shot, tag):
        darks = next(d for d in raw.darks if d.integration_time == shot.integration_time)
        noise = darks.counts.var(axis=0, ddof=1).mean()
        dark = ufloat(darks.counts[:, pixel].mean(), np.sqrt(noise / len(darks.counts)), f"{tag} dark")
        above = shot.counts[:, pixel].mean() - dark.nominal_value
        linear = above / np.polynomial.polynomial.polyval(above, POLYNOMIAL)
        scans = len(shot.counts)
        counts = ufloat(0, np.sqrt((linear / GAIN + noise / (above / linear) ** 2) / scans), f"{tag} counts")
        # the noise of counts is stated on the linear scale, as in the module's formula
        x = above + (dark.nominal_value - dark) if tag.startswith("s") else above - (dark - dark.nominal_value)
        factor = np.polynomial.polynomial.polyval(above, POLYNOMIAL)
        true = x / factor + counts
        return true * (1 + scale * true / FULL) / shot.integration_time, dark

    s, _ = rate(sample, sample.shots[0], "sample")
    responses = []
    shared_dark = None
    for i, shot in enumerate(reference.shots):
        r, dark = rate(reference, shot, f"reference {i}")
        if shared_dark is None:
            shared_dark = dark
        else:  # one dark serves both points
            factor = 1.0
            x = r.nominal_value
            error = r - x
            slope = error.derivatives[dark]
            r = x + sum(d * (v - v.nominal_value) for v, d in error.derivatives.items() if v is not dark)
            r = r + factor * slope * (shared_dark - shared_dark.nominal_value)
        off = sum(p * e[i, 0] for p, e in zip(panel, errors.values(), strict=True))
        f = NOMINAL_SRS99.brdf(np.array([50.0]), np.array([[20.0, 30.0][i]]), np.array([wavelength]))[0, 0]
        responses.append(r / (f * (1 + off) * np.cos(np.radians(50))))
    brdf = s / (0.6 * responses[0] + 0.4 * responses[1]) / umath.cos(np.radians(50))

    found = {}
    for variable, contribution in brdf.error_components().items():
        tag = variable.tag
        name = (
            "random" if tag == "sample counts"
            else "dark: 10 s" if tag == "sample dark"
            else "reference: counts" if tag.endswith("counts")
            else "reference: dark" if tag.endswith("dark")
            else tag
        )  # fmt: skip
        found[name] = np.hypot(found.get(name, 0.0), contribution)
    values = {source.name: abs(source.values[0, 0]) for source in dataset.sources}
    assert dataset.brdf[0, 0] == pytest.approx(brdf.nominal_value, rel=1e-4)  # but for the bias taken off the ratio
    for name in ("random", "dark: 10 s", "reference: counts", "reference: dark", "non-linearity"):
        assert values[name] == pytest.approx(found[name], rel=2e-3), name
    for i, name in enumerate(errors):
        assert values[f"reference: {name}"] == pytest.approx(found[f"panel {i}"], rel=1e-3), name


def test_dim_ends_of_the_spectrum_are_not_biased():
    values, steady = [], None
    for seed in range(40):
        bench = Bench(seed=seed)
        sample = bench.scan(SAMPLE_ANGLES, ROUGH, 0.25)
        reference = bench.scan(REFERENCE_ANGLES, spectralon(), 1.0)
        dataset = calibrate(sample, reference, NOMINAL_SRS99)
        steady = dataset if steady is None else steady
        values.append(dataset.brdf)
    expected = truth(SAMPLE_ANGLES, ROUGH, steady.wavelengths)
    bias = np.mean(values, axis=0) / expected - 1
    scatter = np.std(values, axis=0) / expected
    assert np.median(scatter) > 0.02
    # What is left of the bias of a ratio is the square of the relative noise of the response.
    bright = [0, 1, 3]
    assert np.mean(bias[bright]) == pytest.approx(0, abs=0.004)


def test_a_saturated_pixel_has_no_value_and_its_point_is_flagged():
    bench = Bench(noisy=False)
    sample = bench.scan(SAMPLE_ANGLES, ROUGH, 150.0)
    reference = bench.scan(REFERENCE_ANGLES, spectralon(), 60.0)
    dataset = calibrate(sample, reference, NOMINAL_SRS99)
    clipped = np.array([np.any(shot.counts >= FULL) for shot in sample.shots])
    assert 0 < clipped.sum() < len(clipped)
    assert np.array_equal(dataset.flagged(Flag.SATURATED), clipped)
    assert np.array_equal(np.isnan(dataset.brdf).any(axis=1), clipped)
    assert np.isfinite(dataset.brdf[clipped]).any()
    assert np.array_equal(dataset.usable, ~clipped)


def test_a_long_exposure_measures_the_dim_wavelengths_and_a_short_one_those_that_it_saturates():
    combined, true = ideal(times=[(1.0, 150.0)] * len(SAMPLE_ANGLES))
    assert not combined.flagged(Flag.SATURATED).any()
    short, _ = ideal(times=1.0)
    lit = lighted(combined)
    assert combined.brdf[:, lit] == pytest.approx(true[:, lit], rel=3e-3)
    gain = (part(short, "random") / part(combined, "random"))[3]
    dim = combined.wavelengths < 420
    assert np.all(gain[dim] > np.sqrt(151) * 0.95)  # all of the light; read-out noise makes it more
    assert gain[np.argmax(true[3] * np.exp(-(((combined.wavelengths - 650) / 180) ** 2)))] == pytest.approx(1)


def test_a_change_of_the_response_with_angle_is_divided_out():
    def tilted(brdf):
        return lambda t, o, wavelengths, a: brdf(t, o, wavelengths, a) * (1 + 0.002 * o[:, None])

    bench = Bench(noisy=False)
    sample = bench.scan(SAMPLE_ANGLES, tilted(ROUGH), 20.0)
    reference = bench.scan(REFERENCE_ANGLES, tilted(spectralon()), 60.0)
    dataset = calibrate(sample, reference, NOMINAL_SRS99)
    true = truth(SAMPLE_ANGLES, ROUGH, dataset.wavelengths)
    lit = lighted(dataset)
    assert dataset.brdf[:, lit] == pytest.approx(true[:, lit], rel=1e-3)


def test_read_back_angles_are_what_a_dataset_holds():
    bench = Bench()
    sample = bench.scan(SAMPLE_ANGLES, ROUGH, 10.0)
    read_back = tuple(Geometry(g.theta_in + 0.01, g.theta_out - 0.02) for g in SAMPLE_ANGLES)
    reference = bench.scan(REFERENCE_ANGLES, spectralon(), 10.0)
    dataset = calibrate(replace(sample, read_back=read_back), reference, NOMINAL_SRS99)
    assert dataset.theta_in == pytest.approx([g.theta_in + 0.01 for g in SAMPLE_ANGLES])
    assert dataset.theta_out == pytest.approx([g.theta_out - 0.02 for g in SAMPLE_ANGLES])


def test_the_plan_sees_cos_f_in_its_bands():
    bench = Bench(seed=6)
    sample = bench.scan(SAMPLE_ANGLES, ROUGH, 20.0)
    reference = bench.scan(REFERENCE_ANGLES, spectralon(), 40.0)
    values, noise = band_values(sample, response(reference, NOMINAL_SRS99))
    centres = np.array([np.mean(band) for band in BANDS])
    cosine = np.cos(np.radians([g.theta_in for g in SAMPLE_ANGLES]))[:, None]
    assert values == pytest.approx(cosine * truth(SAMPLE_ANGLES, ROUGH, centres), rel=0.02)
    assert np.all(noise < 0.01 * values)


def test_nothing_is_invented_beyond_the_outermost_reference_point():
    angles = [Geometry(50.0, o) for o in (-35.15, -35.05, 20.0, 85.05, 85.15)]
    bench = Bench()
    sample = bench.scan(angles, ROUGH, 10.0)
    reference = bench.scan(REFERENCE_ANGLES, spectralon(), 40.0)
    dataset = calibrate(sample, reference, NOMINAL_SRS99)
    known = [False, True, True, True, False]
    for array in (dataset.brdf, dataset.u):
        assert np.isfinite(array).all(axis=1).tolist() == np.isfinite(array).any(axis=1).tolist() == known
    assert dataset.flagged(Flag.BEYOND_REFERENCE).tolist() == [not k for k in known]
    values, _ = band_values(sample, response(reference, NOMINAL_SRS99))
    assert np.isfinite(values).all(axis=1).tolist() == known


def off(settings_without, wrong, **options):
    """Largest relative bias, where there is signal, with a correction and without it."""
    found = []
    for corrections in (STANDARD.corrections, STANDARD.corrections - {settings_without}):
        dataset, true = ideal(wrong=wrong, settings=Settings(corrections=corrections), **options)
        bright = np.isfinite(dataset.brdf) & (true > 0.01 * true.max()) & lighted(dataset)
        found.append((np.abs(dataset.brdf / true - 1)[bright].max(), dataset))
    return found


WIDE = [Geometry(50.0, float(o)) for o in range(-40, 81, 10)]


@pytest.mark.parametrize(
    ("correction", "wrong", "options", "least", "left"),
    [
        ("dark", Wrong(), {}, 0.03, 2e-3),
        ("non-linearity", Wrong(), {"times": 60.0}, 3e-3, 2e-3),
        ("stray light", Wrong(stray=5e-3), {"stray_time": 60.0}, 0.02, 2e-3),
        # in the minute between both scans the lamp changes by up to 3e-3, unwatched
        ("drift", Wrong(drift=0.03), {"monitor_every": 3}, 0.02, 6e-3),
    ],
)
def test_a_correction_that_is_left_out_leaves_its_bias_in_the_brdf(correction, wrong, options, least, left):
    (with_it, dataset), (without, plain) = off(correction, wrong, angles=WIDE, **options)
    assert with_it < left
    assert without > least
    assert dataset.lineage["corrections"][correction] == "made"
    assert plain.lineage["corrections"][correction] == "not made"
    # what is left out is not forgotten; of stray light the stated bound counts, whatever was measured
    if correction != "stray light":
        assert part(plain, correction).mean() > part(dataset, correction).mean()


@pytest.mark.parametrize(
    ("correction", "source", "wrong", "options"),
    [
        ("dark", "dark: not subtracted", RIGHT, {}),
        ("non-linearity", "non-linearity", RIGHT, {"times": 60.0}),
        ("stray light", "stray light: not subtracted", Wrong(stray=1e-3), {"stray_time": 60.0}),
    ],
)
def test_the_uncertainty_of_a_correction_that_is_left_out_is_its_size(correction, source, wrong, options):
    (_, corrected), (_, plain) = off(correction, wrong, angles=WIDE[1:], **options)
    stated = next(s for s in plain.sources if s.name == source)
    assert stated.shared_by_wavelengths
    change = plain.brdf - corrected.brdf
    seen = lighted(plain) & np.isfinite(change)
    # with its sign, and to first order: a dark signal is a tenth of the panel's
    assert seen.mean() > 0.4
    np.testing.assert_allclose(stated.values[seen], change[seen], rtol=0.12, atol=2e-3 * np.abs(change[seen]).max())


def test_stray_light_that_nobody_measured_changes_a_value_as_stated_bright_or_dark():
    angles = [Geometry(50.0, o) for o in (-30.0, 0.0, 30.0, 50.0, 70.0)]
    narrow = lobe(0.1)
    times = [100.0, 100.0, 20.0, 2.0, 10.0]
    clean, _ = ideal(angles, narrow, times=times)
    veiled, _ = ideal(angles, narrow, times=times, wrong=Wrong(stray=DATA.u_stray_light))
    lit = (clean.wavelengths > 600) & (clean.wavelengths < 700)
    stated = next(s for s in clean.sources if s.name == "stray light: not measured").values[:, lit].mean(axis=1)
    change = (veiled.brdf - clean.brdf)[:, lit].mean(axis=1)
    assert (stated > 0).tolist() == [True, True, False, False, False]
    np.testing.assert_allclose(stated, change, rtol=0.1, atol=1e-5)


def test_a_field_of_view_that_is_wider_clips_sample_and_panel_alike():
    bench = Bench(noisy=False)
    reference = bench.scan(REFERENCE_ANGLES, spectralon(), 60.0, diameter=10.0)
    angles = [Geometry(50.0, float(o)) for o in (65, 75, 85)]
    for diameter, least, most in ((10.0, 0.0, 2e-3), (20.0, 5e-3, 0.04)):
        sample = bench.scan(angles, ROUGH, 20.0, diameter=diameter)
        dataset = calibrate(sample, reference, NOMINAL_SRS99)
        relative = (part(dataset, "footprint") / dataset.brdf)[-1, 60]
        assert least <= relative < most


def test_a_detector_that_is_warmer_than_for_its_dark_has_more_uncertainty_and_not_more_light():
    bench = Bench(seed=3)
    sample = bench.scan(SAMPLE_ANGLES, ROUGH, [1.0, 10.0, 10.0, 10.0])
    reference = bench.scan(REFERENCE_ANGLES, spectralon(), 10.0)
    warm = replace(sample, shots=tuple(replace(shot, temperature=-9.7) for shot in sample.shots))
    steady, warmer = (calibrate(raw, reference, NOMINAL_SRS99) for raw in (sample, warm))
    np.testing.assert_array_equal(steady.brdf, warmer.brdf)
    assert not any(source.name == "dark: temperature" for source in steady.sources)
    stated = next(source for source in warmer.sources if source.name == "dark: temperature").values
    # 0.3 degrees are 3.5 % of the dark current of 4 counts per second, which the light of the panel is divided into
    response = 4000 * np.exp(-(((warmer.wavelengths - 650) / 180) ** 2))
    expected = 4.0 * (10.0 - 1.0) / 10.0 * np.log(2) / 6 * 0.3 / response / np.cos(np.radians(50))
    # each of the two dark currents has its own noise
    assert np.median(stated[3] / expected) == pytest.approx(1, abs=0.03)


def test_the_sample_stage_has_a_new_error_each_time_it_comes_back():
    bench = Bench()
    angles = [Geometry(50.0, o) for o in (0.0, 10.0, 20.0)]
    raw = bench.scan([*angles, Geometry(0.0, 30.0), Geometry(50.0, 40.0), Geometry(50.0, 60.0)], ROUGH, 5.0)
    assert sample_visits(raw).tolist() == [0, 0, 0, 1, 2, 2]
    watched = bench.scan(angles, ROUGH, 5.0, monitor_every=2)  # monitors stand at 30 degrees
    assert sample_visits(watched).tolist() == [1, 1, 3]
    reference = bench.scan(REFERENCE_ANGLES, spectralon(), 10.0)
    stage = next(s for s in calibrate(raw, reference, NOMINAL_SRS99).sources if s.name == "angle: sample stage")
    assert stage.groups.tolist() == [0, 0, 0, 1, 2, 2]


def test_stray_light_that_saturates_and_scans_without_points_are_refused():
    bench = Bench()
    reference = bench.scan(REFERENCE_ANGLES, spectralon(), 10.0)
    sample = bench.scan(SAMPLE_ANGLES, ROUGH, 10.0, stray_time=60.0)
    burnt = tuple(replace(shot, counts=np.full_like(shot.counts, FULL)) for shot in sample.stray)
    with pytest.raises(CalibrationError, match="stray light"):
        calibrate(replace(sample, stray=burnt), reference, NOMINAL_SRS99)
    with pytest.raises(CalibrationError, match="no measured point"):
        calibrate(replace(sample, planned=(), read_back=(), shots=()), reference, NOMINAL_SRS99)


def test_a_wavelength_offset_that_is_known_is_taken_off():
    offset = 2.0
    constants = replace(CONSTANTS, bench=replace(DATA, wavelength_offset=offset))
    bench = Bench(Wrong(wavelength=offset), noisy=False)
    reference = replace(bench.scan(REFERENCE_ANGLES, spectralon(), 60.0), constants=constants)
    tilted = lobe(0.3, h=1.9, w=0.5)
    sample = replace(bench.scan(SAMPLE_ANGLES, tilted, 20.0), constants=constants)
    biases = []
    for corrections in (STANDARD.corrections, STANDARD.corrections - {"wavelength"}):
        dataset = calibrate(sample, reference, NOMINAL_SRS99, Settings(corrections=corrections))
        true = truth(SAMPLE_ANGLES, tilted, dataset.wavelengths)
        inner = dataset.wavelengths > 450
        biases.append(np.abs(dataset.brdf / true - 1)[3, inner].max())
    assert biases[0] < 1.5e-3
    assert biases[1] > 3e-3


def test_a_footprint_that_leaves_a_small_sample_is_corrected_and_flagged():
    angles = [Geometry(50.0, float(o)) for o in (20, 60, 70, 75, 80)]
    diameter, seen = 6.0, DATA.field_of_view

    def share(theta_out):
        # the chord of the ellipse lies within the disc where the disc is wider: areas by quadrature
        a, b, radius = seen / 2 / np.cos(np.radians(theta_out)), seen / 2, diameter / 2
        height = lambda x: min(b * np.sqrt(1 - (x / a) ** 2), np.sqrt(max(radius**2 - x**2, 0)))  # noqa: E731
        return quad(height, 0, min(a, radius), limit=200, epsabs=1e-10)[0] / (np.pi * a * b / 4)

    def small(theta_in, theta_out, wavelengths, aperture):
        return ROUGH(theta_in, theta_out, wavelengths, aperture) * share(theta_out[0])

    bench = Bench(noisy=False)
    reference = bench.scan(REFERENCE_ANGLES, spectralon(), 60.0)
    sample = bench.scan(angles, small, 20.0, diameter=diameter)
    dataset = calibrate(sample, reference, NOMINAL_SRS99)
    true = truth(angles, ROUGH, dataset.wavelengths)
    assert dataset.brdf == pytest.approx(true, rel=2e-3)
    assert dataset.flagged(Flag.CLIPPED).tolist() == [False, False, True, True, True]
    uncorrected = calibrate(
        sample, reference, NOMINAL_SRS99, Settings(corrections=STANDARD.corrections - {"footprint"})
    )
    assert uncorrected.brdf[-1] == pytest.approx(share(80.0) * true[-1], rel=2e-3)
    assert share(80.0) < 0.7
    relative = part(dataset, "footprint") / true
    assert relative[0] == pytest.approx(0, abs=1e-6)
    assert 0.005 < relative[-1].mean() < DATA.u_field_of_view / DATA.field_of_view


def test_the_average_over_the_aperture_is_taken_back_where_the_lobe_is_wider():
    narrow = lobe(0.05, h=0.0)
    near = [Geometry(50.0, 50.0 + o) for o in (-6.0, -4.0, -3.0, -2.0, -1.0, 0.0, 1.0, 2.0, 3.0, 4.0, 6.0)]
    settings = Settings(corrections=frozenset(CORRECTIONS))
    dataset, averaged = ideal(near, narrow, times=0.5, settings=settings)
    at_centre = truth(near, narrow, dataset.wavelengths, aperture=0.0)
    inner = slice(2, -2)
    before = np.abs(averaged / at_centre - 1)[inner].max()
    after = np.abs(dataset.brdf / at_centre - 1)[inner].max()
    assert before > 0.012
    assert after < 0.25 * before
    assert dataset.aperture == 0
    assert np.all(np.abs(dataset.brdf - at_centre)[inner] < 2.5 * dataset.u[inner])


@pytest.mark.parametrize(
    ("text", "override", "message"),
    [
        ("400,0.985,0.004\n1000,0.988,0.003\n", None, "covers 400 to 1000 nm, but 380 to 995 nm"),
        ("350,0.985,0.004\n990,0.988,0.003\n", None, "covers 350 to 990 nm, but 380 to 995 nm"),
        ("350,98.5,0.4\n", None, r"panel\.csv, line 6: at least two rows"),
        (None, None, "certificate"),
        (None, Override("A. Keeper", "the panel is new"), None),
        ("350,0.985,0.004\n1000,0.988,0.003\n", None, None),
    ],
)
def test_a_certificate_that_will_not_do_is_refused_before_hours_of_measuring(text, override, message):
    header = (
        "# serial_number: P1\n# calibrated: 2024-03-01\n# valid_until: 2125-03-01\n\n"
        "wavelength_nm,reflectance,standard_uncertainty\n"
    )
    content = None if text is None else header + text
    if message is None:
        check_certificate(content, "panel.csv", override, date(2026, 1, 1))
    else:
        with pytest.raises(CertificateError, match=message) as caught:
            check_certificate(content, "panel.csv", override, date(2026, 1, 1))
        assert "\n" not in str(caught.value)


def test_a_missing_incident_angle_of_the_reference_is_named():
    bench = Bench()
    sample = bench.scan([Geometry(20.0, 0.0)], ROUGH, 10.0)
    reference = bench.scan(REFERENCE_ANGLES, spectralon(), 10.0)
    with pytest.raises(CalibrationError, match="theta_in = 20 deg"):
        calibrate(sample, reference, NOMINAL_SRS99)


def test_a_reference_without_light_is_refused_instead_of_giving_infinite_values():
    bench = Bench(noisy=False)
    sample = bench.scan(SAMPLE_ANGLES, ROUGH, 10.0)
    reference = bench.scan(REFERENCE_ANGLES, lambda t, o, w, a: 0 * ROUGH(t, o, w, a), 10.0)
    with pytest.raises(CalibrationError, match="no light") as caught:
        calibrate(sample, reference, NOMINAL_SRS99)
    keys = re.findall(r"\b([a-z_]+)\.([a-z_]+)\b", str(caught.value))
    assert len(keys) == 2
    for section, key in keys:  # what is advised can be written in a campaign file
        assert key in Campaign.model_json_schema()["$defs"][section.capitalize()]["properties"]


def test_missing_darks_and_too_narrow_ranges_are_refused():
    bench = Bench()
    sample = bench.scan(SAMPLE_ANGLES, ROUGH, 10.0)
    reference = bench.scan(REFERENCE_ANGLES, spectralon(), 10.0)
    with pytest.raises(CalibrationError, match="10 s"):
        calibrate(replace(sample, darks=()), reference, NOMINAL_SRS99)
    one = replace(sample.darks[0], counts=sample.darks[0].counts[:1])
    with pytest.raises(CalibrationError, match="two are needed"):
        calibrate(replace(sample, darks=(one,)), reference, NOMINAL_SRS99)
    with pytest.raises(CalibrationError, match="no 6 pixels"):
        calibrate(sample, reference, NOMINAL_SRS99, Settings(lowest=500, highest=501))


def test_the_dark_of_the_nearest_temperature_is_subtracted():
    bench = Bench(noisy=False)
    sample = bench.scan(SAMPLE_ANGLES, ROUGH, 10.0)
    warm = replace(sample.darks[0], temperature=-8.0, counts=sample.darks[0].counts + 400)
    warmed = tuple(replace(shot, temperature=-8.1, counts=shot.counts + 400) for shot in sample.shots[2:])
    mixed = replace(sample, darks=(*sample.darks, warm), shots=(*sample.shots[:2], *warmed))
    reference = bench.scan(REFERENCE_ANGLES, spectralon(), 10.0)
    steady, drifting = (calibrate(raw, reference, NOMINAL_SRS99) for raw in (sample, mixed))
    np.testing.assert_allclose(drifting.brdf, steady.brdf, rtol=1e-12)


def test_lineage_says_what_a_dataset_was_made_from():
    bench = Bench()
    sample = bench.scan(SAMPLE_ANGLES, ROUGH, 10.0, scans=2, stray_time=60.0)
    reference = replace(bench.scan(REFERENCE_ANGLES, spectralon(), 10.0, stray_time=60.0), scan_id=2)
    lineage = calibrate(sample, reference, NOMINAL_SRS99).lineage
    assert (lineage["scan"], lineage["reference_scan"]) == (1, 2)
    assert lineage["exposures"] == [i for shot in sample.shots for i in shot.ids]
    assert lineage["darks"] == [i for dark in sample.darks for i in dark.ids]
    assert len(lineage["stray"]) == 4
    assert lineage["certificate"] == NOMINAL_SRS99.serial_number
    assert lineage["corrections"] == {
        "dark": "made", "non-linearity": "made", "stray light": "made", "drift": "not measured",
        "wavelength": "made", "footprint": "made", "aperture": "not made",
    }  # fmt: skip
    parameters = lineage["parameters"]
    assert isinstance(parameters, dict)
    assert parameters.items() >= {"bin_size": 6, "lowest": 380.0, "highest": 995.0, "gain": GAIN}.items()


def test_light_that_is_not_linear_is_what_the_forward_model_makes():
    # the forward model itself: counts divided by the polynomial give the light back
    light = np.array([10.0, 1e4, 1.9e5])
    read = as_read(light)
    np.testing.assert_allclose(read / np.polynomial.polynomial.polyval(read, POLYNOMIAL), light, rtol=1e-9)
