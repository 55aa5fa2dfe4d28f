"""Each thing that the bench does wrong is found again in its raw counts, as large as it was put in."""

import asyncio
import re
from pathlib import Path

import numpy as np
import pytest

from drivers.qepro import QEPro
from goniometer.constants import BenchData
from simulators.bench.imperfections import DRAWN_STRAY_LIGHT, STRAY_LIGHT, Imperfections, drawn
from simulators.bench.laboratory import MOUNT_TIME, simulated_laboratory
from simulators.bench.optics import FULL_SCALE, RESOLUTION, share_on_disc
from simulators.materials.materials import MERCURY_ARGON, PANEL_CERTIFICATE, SAMPLES, true_brdf
from tests.optical_bench import Bench

ISOLATED = (253.6517, 435.8328, 546.0735, 696.5431, 763.5106, 852.1442, 912.2967)
"""Lines of the calibration lamp with no other within 5 nm; wavelengths in air, nm."""


def at(bench: Bench, signal: np.ndarray, wavelength: float) -> float:
    """Mean over 80 nm, in which the noise of one pixel is lost."""
    return float(signal[np.abs(bench.wavelengths - wavelength) < 40].mean())


def line(bench: Bench, wavelength: float) -> tuple[float, float]:
    """Centre and standard deviation of a line of the calibration lamp by its moments, nm."""
    signal = bench.signal(0.1)
    near = np.abs(bench.wavelengths - wavelength) < 2.5
    x, weight = bench.wavelengths[near], signal[near]
    centre = np.average(x, weights=weight)
    return float(centre), float(np.sqrt(np.average((x - centre) ** 2, weights=weight)))


def test_a_lamp_that_gets_hotter_brightens_the_blue_most() -> None:
    steady, drifting = Bench().turn(0, 45), Bench(lamp_drift=0.02).turn(0, 45)
    before = [bench.signal(10.0) for bench in (steady, drifting)]
    for bench in (steady, drifting):
        bench.clock.advance_to(900.0)
    after = [bench.signal(10.0) for bench in (steady, drifting)]
    assert after[0].sum() / before[0].sum() == pytest.approx(1, abs=2e-4)
    for wavelength in (450.0, 600.0, 900.0):  # Wien: d ln(radiance) / dT goes with 1 / lambda
        hotter = before[1] * (1 + 0.02 * 600 / drifting.wavelengths)
        gain, expected = (at(drifting, x, wavelength) / at(drifting, before[1], wavelength) for x in (after[1], hotter))
        assert gain == pytest.approx(expected, abs=2e-4)


def test_the_drift_begins_where_its_phase_says() -> None:
    low = Bench(lamp_drift=0.02, lamp_phase=-90.0).turn(0, 45)
    assert at(low, low.signal(10.0), 600) / at(low, Bench().turn(0, 45).signal(10.0), 600) == pytest.approx(
        0.98, abs=4e-4
    )


def test_a_lamp_that_warms_up_lacks_less_and_less_and_most_in_the_blue() -> None:
    cold = Bench(lamp_warm_up=0.1).turn(0, 45)
    warm = Bench().turn(0, 45).signal(10.0)
    for moment in (0.0, 300.0, 1200.0):
        cold.clock.advance_to(moment)
        seen = cold.signal(10.0)
        dimmed = warm * (1 - 0.1 * np.exp(-moment / 300.0) * 600 / cold.wavelengths)
        for wavelength in (450.0, 900.0):
            assert at(cold, seen, wavelength) == pytest.approx(at(cold, dimmed, wavelength), rel=1e-3)


@pytest.mark.parametrize(("material", "theta_in", "theta_out"), [("nothing", 0, 45), ("sample-1", 30, -30)])
def test_stray_light_is_all_there_is_on_an_empty_stage_and_behind_the_detector(
    material: str, theta_in: float, theta_out: float
) -> None:
    stray = Bench(material, stray_light=5e-4).turn(theta_in, theta_out).signal(60.0)
    panel = Bench().turn(0, 45).signal(60.0)
    usable = slice(300, 950)
    brdf = PANEL_CERTIFICATE.brdf(np.array([0.0]), np.array([45.0]), Bench().wavelengths)[0]
    expected = 5e-4 / (brdf + STRAY_LIGHT)
    assert np.mean((stray / panel)[usable] / expected[usable]) == pytest.approx(1, abs=3e-3)


def test_what_the_polynomial_leaves_of_the_non_linearity_grows_with_the_counts() -> None:
    bench = Bench("mirror", nonlinearity=0.02).turn(10, 10)
    short, long = bench.signal(0.008), bench.signal(0.016)
    ideal = 2 * Bench("mirror").turn(10, 10).signal(0.008)
    bright = ideal > 100_000
    expected = 1 + 0.02 * ideal / FULL_SCALE
    np.testing.assert_allclose((long / ideal)[bright].mean(), expected[bright].mean(), rtol=5e-4)
    np.testing.assert_allclose(
        (2 * short / ideal)[bright].mean(), 1 + 0.02 * (ideal / 2 / FULL_SCALE)[bright].mean(), rtol=5e-4
    )


@pytest.mark.parametrize("offset", [0.0, 0.3, -1.5])
def test_lines_of_the_calibration_lamp_tell_how_far_the_wavelength_scale_is_off(offset: float) -> None:
    bench = Bench("mercury-argon", wavelength_offset=offset)
    centres = np.array([line(bench, wavelength - offset)[0] for wavelength in ISOLATED])
    np.testing.assert_allclose(centres, np.array(ISOLATED) - offset, atol=0.01)
    assert (centres - np.array(ISOLATED)).mean() == pytest.approx(-offset, abs=0.003)


def test_lines_are_as_wide_as_the_resolution_and_neither_saturated_nor_lost_at_a_tenth_of_a_second() -> None:
    bench = Bench("mercury-argon")
    pixel = 0.8
    expected = np.hypot(RESOLUTION / 2.3548, pixel / np.sqrt(12))
    assert line(bench, 546.0735)[1] == pytest.approx(expected, rel=0.02)
    peaks = bench.signal(0.1)
    assert 20_000 < peaks.max() < 0.9 * FULL_SCALE
    for wavelength, _ in MERCURY_ARGON.lines:
        assert peaks[np.argmin(np.abs(bench.wavelengths - wavelength))] > 500
    lit = Bench("mercury-argon", stray_light=0.0)
    sums = [lit.turn(*angles).signal(0.1).sum() for angles in ((0, 0), (60, 20))]
    assert sums[0] == pytest.approx(sums[1], rel=1e-3)
    assert sums[0] == pytest.approx(0.1 * sum(strength for _, strength in MERCURY_ARGON.lines), rel=1e-3)


def test_the_mirror_direction_tells_the_zeros_of_the_stages() -> None:
    def specular(**errors: float) -> float:
        """Where the detector arm reads the reflection at 20 degrees of incidence, degrees."""
        bench = Bench("mirror", **errors)
        arm = np.arange(37.0, 43.01, 0.1)
        light = [bench.turn(20.0, angle - 20.0).signal(0.008, times=2).sum() for angle in arm]
        return float(np.average(arm, weights=np.maximum(light, 0)))

    # the arm truly stands at twice the true angle of the sample
    assert specular() == pytest.approx(40.0, abs=5e-3)
    assert specular(sample_zero=0.05) - specular() == pytest.approx(2 * 0.05, abs=5e-3)
    assert specular(sample_zero=0.03, detector_zero=-0.08) - specular() == pytest.approx(0.14, abs=5e-3)


def test_a_wider_aperture_sees_less_of_the_peak_of_the_mirror() -> None:
    # average of GGX, (1 + (tilt / alpha)^2)^-2, over a disc of radius r: 1 / (1 + (r / 2 alpha)^2) near the normal
    def peak(full_angle: float) -> float:
        return 1 / (1 + (np.radians(full_angle / 2) / (2 * SAMPLES["sample-6"].alpha)) ** 2)

    wide, true = (Bench("mirror", aperture_error=e).turn(5, 5).signal(0.008).sum() for e in (0.3, 0.0))
    assert wide / true == pytest.approx(peak(1.3) / peak(1.0), rel=5e-3)


@pytest.mark.parametrize("field_of_view", [2.5, 3.1])
@pytest.mark.parametrize("theta_out", [60.0, 81.0, -84.0])
def test_the_detector_looks_past_a_small_sample_at_grazing_angles(field_of_view: float, theta_out: float) -> None:
    # by counting the points of a grid that lie on both, the ellipse and the disc
    a, b = field_of_view / 2 / np.cos(np.radians(theta_out)), field_of_view / 2
    x, y = np.meshgrid(*((np.arange(2000) + 0.5) / 1000 - 1 for _ in range(2)))
    inside = x**2 + y**2 <= 1
    counted = np.mean(((a * x) ** 2 + (b * y) ** 2 <= 7.5**2)[inside])
    assert share_on_disc(theta_out, field_of_view, 15.0) == pytest.approx(counted, abs=2e-4)
    error = field_of_view - BenchData().field_of_view
    coupon, disc = (
        Bench(name, field_of_view_error=error).turn(60, theta_out).signal(2.0, times=80).sum()
        for name in ("coupon", "sample-4")
    )
    assert coupon / disc == pytest.approx(counted, rel=1e-3)


def test_a_panel_that_is_brighter_than_certified_is_so_at_all_wavelengths() -> None:
    bright, certified = Bench(panel_level=2.0).turn(0, 45), Bench().turn(0, 45)
    signals = bright.signal(60.0), certified.signal(60.0)
    for wavelength in (380.0, 600.0, 900.0):
        ratio = at(bright, signals[0], wavelength) / at(certified, signals[1], wavelength)
        assert ratio == pytest.approx(1 + 2 * 0.003 / 0.988, abs=2e-4)


def test_a_panel_that_spreads_light_differently_leaves_samples_as_they_are() -> None:
    truth = Imperfections(panel_seed=5)
    angles = np.array([30.0]), np.array([-60.0])
    expected = truth.panel(PANEL_CERTIFICATE, *angles, np.array([600.0]))[0, 0]
    assert abs(expected - 1) > 1e-3
    for name, departure in (("spectralon", expected), ("sample-1", 1.0)):
        ratio = Bench(name, panel_seed=5).turn(30, -60).signal(10.0) / Bench(name).turn(30, -60).signal(10.0)
        assert at(Bench(), ratio, 600) == pytest.approx(departure, abs=4e-4)


def test_panels_differ_from_the_table_as_much_as_its_uncertainty_says_and_smoothly() -> None:
    theta_in, theta_out = np.array([20.0, 20, 20, 55, 60]), np.array([30.0, 31, 65, 30, 85])
    panels = np.array(
        [
            Imperfections(panel_seed=seed).panel(PANEL_CERTIFICATE, theta_in, theta_out, np.array([600.0]))[:, 0] - 1
            for seed in range(2000)
        ]
    )
    sampling = 1 / np.sqrt(2000)
    np.testing.assert_allclose(panels.mean(axis=0) / [0.009, 0.009, 0.009, 0.009, 0.05], 0, atol=4 * sampling)
    np.testing.assert_allclose(panels.std(axis=0), [0.009, 0.009, 0.009, 0.009, 0.05], rtol=3 * sampling)
    correlation = np.corrcoef(panels.T)
    assert correlation[0, 1] > 0.999
    assert correlation[0, 2] == pytest.approx(np.exp(-0.5), abs=4 * sampling)
    assert correlation[0, 3] == pytest.approx(np.exp(-0.5), abs=4 * sampling)


def test_sample_7_looks_different_at_another_spot() -> None:
    angles = np.array([10.0]), np.array([30.0])
    first, second = (Bench("sample-7", spot=spot).turn(10, 30) for spot in (0, 1))
    a, b = (true_brdf(SAMPLES["sample-7"], *angles, np.array([600.0]), spot=spot)[0, 0] for spot in (0, 1))
    assert abs(b / a - 1) > 0.05
    measured = at(second, second.signal(10.0), 600) / at(first, first.signal(10.0), 600)
    assert measured == pytest.approx(b / a, rel=5e-3)


def test_errors_of_drawn_benches_are_as_large_as_the_operator_states() -> None:
    data = BenchData(u_zero=0.02, u_wavelength=0.3, wavelength_offset=1.0)
    benches = [drawn(seed, data) for seed in range(600)]
    stated = {
        "sample_zero": data.u_zero,
        "detector_zero": data.u_zero,
        "wavelength_offset": data.u_wavelength,
        "nonlinearity": data.u_nonlinearity,
        "aperture_error": data.u_aperture,
        "field_of_view_error": data.u_field_of_view,
        "panel_level": 1.0,
    }
    drawn_values = {name: np.array([getattr(bench, name) for bench in benches]) for name in stated}
    for name, u in stated.items():
        assert drawn_values[name].std() == pytest.approx(u, rel=0.1), name
        mean = 1.0 if name == "wavelength_offset" else 0.0
        assert drawn_values[name].mean() == pytest.approx(mean, abs=4 * u / np.sqrt(600)), name
    independent = np.corrcoef(list(drawn_values.values())) - np.eye(len(stated))
    assert np.abs(independent).max() < 4.5 / np.sqrt(600)
    assert all(DRAWN_STRAY_LIGHT[0] <= bench.stray_light <= DRAWN_STRAY_LIGHT[1] for bench in benches)
    assert len({bench.panel_seed for bench in benches}) == 600
    assert drawn(7, data) == benches[7]


def test_the_demo_bench_has_errors_and_none_that_a_resumed_scan_would_miss() -> None:
    with simulated_laboratory(3) as laboratory:
        errors = laboratory.bench.imperfections
        assert errors == drawn(3, laboratory.data)
        assert (errors.lamp_drift, errors.cooler_ripple) == (0.0, 0.0)
        assert errors.sample_zero != 0


def test_samples_are_exchanged_in_time_so_that_a_lamp_drifts_meanwhile() -> None:
    with simulated_laboratory(3, imperfections=Imperfections()) as laboratory:
        laboratory.mount("sample-7", spot=2)
        assert laboratory.clock.now() == MOUNT_TIME
        assert (laboratory.bench.mounted, laboratory.bench.spot) == ("sample-7", 2)
        assert laboratory.bench.imperfections == Imperfections()


def test_the_benches_in_the_documents_can_be_made(capsys: pytest.CaptureFixture[str]) -> None:
    text = (Path(__file__).parents[2] / "docs" / "simulated-laboratory.md").read_text(encoding="utf-8")
    _, _, code = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    exec(code, {})
    assert capsys.readouterr().out == f"{drawn(1, BenchData(), lamp_drift=0.01)}\n"


def test_dark_spectra_follow_the_temperature_that_the_device_reports() -> None:
    async def darks(spectrometer: QEPro) -> list[tuple[float, float]]:
        await spectrometer.open()
        found = []
        for moment in (1250.0, 1750.0):
            laboratory.clock.advance_to(moment - 60.0)
            spectrum = await spectrometer.expose(60.0)
            bias = await spectrometer.expose(0.01)
            found.append((spectrum.detector_temperature, float(spectrum.counts.mean() - bias.counts.mean())))
        await spectrometer.close()
        return found

    with simulated_laboratory(3, imperfections=Imperfections(cooler_ripple=0.45)) as laboratory:
        spectrometer = QEPro("spectrometer", laboratory.clock, usb_backend=laboratory.usb_backend)
        (warm, more), (cold, less) = asyncio.run(darks(spectrometer))
    assert warm - cold == pytest.approx(0.9, abs=0.03)
    assert more / less == pytest.approx(2 ** ((warm - cold) / 6), abs=0.005)  # doubling every six degrees
