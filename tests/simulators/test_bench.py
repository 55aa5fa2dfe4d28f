"""The bench has the noise and the faults of a real one, and always the same ones."""

import subprocess
import sys

import numpy as np
import pytest

from goniometer.certificates.certificate import NOMINAL_SRS99
from simulators.bench.optics import (
    FULL_SCALE,
    GAIN,
    OFFSET,
    READ_NOISE,
    OpticalBench,
    positioning_error,
)
from simulators.devices.clock import SimulatedClock
from simulators.devices.motion import Axis
from simulators.errors import UnknownMaterial
from simulators.materials.materials import SAMPLES, true_brdf
from tests.optical_bench import Bench, Standing


def test_the_detector_has_the_shape_that_the_spectrometer_announces() -> None:
    bench = Bench().turn(10, 45)
    counts = bench.read(1.0)
    assert counts.shape == (1044,)
    assert counts.dtype == np.uint32
    assert len(bench.optics.wavelength_coefficients) == 4
    assert len(bench.optics.nonlinearity_coefficients) == 8
    assert np.all(np.diff(bench.wavelengths) > 0)
    assert bench.wavelengths[0] == pytest.approx(250, abs=1)
    assert bench.wavelengths[-1] == pytest.approx(1050, abs=1)


def test_spectralon_gives_the_stated_level() -> None:
    signal = Bench().turn(0, 45).signal(1.0)
    assert signal.max() == pytest.approx(2000, rel=0.02)
    assert 600 < Bench().wavelengths[np.argmax(signal)] < 850


def test_photon_transfer_gives_back_gain_and_read_noise() -> None:
    # Janesick, Photon Transfer: the variance is read noise^2 + mean / gain
    bench = Bench("sample-5").turn(30, 30)
    means, variances = [], []
    for seconds in (0.008, 0.05, 0.3, 1.0):
        reads = np.array([bench.read(seconds) for _ in range(100)], dtype=float)
        dark = bench.mean(seconds, light=False)
        order = np.argsort(reads.mean(axis=0))[-700:].reshape(7, 100)
        means += [(reads.mean(axis=0) - dark)[group].mean() for group in order]
        variances += [reads.var(axis=0, ddof=1)[group].mean() for group in order]
    slope, intercept = np.polyfit(means, variances, 1, w=1 / np.asarray(variances))
    assert 1 / slope == pytest.approx(GAIN, rel=0.03)
    assert np.sqrt(intercept) == pytest.approx(READ_NOISE, rel=0.03)


def test_doubling_the_exposure_doubles_the_signal_once_the_polynomial_is_divided_out() -> None:
    bench = Bench("mirror").turn(10, 10)
    short, long = bench.signal(0.008), bench.signal(0.016)
    bright = short > 5000
    assert long.max() > 150_000
    np.testing.assert_allclose(long[bright] / short[bright], 2, rtol=4e-3)
    assert (long[bright] / short[bright]).mean() == pytest.approx(2, rel=3e-4)
    raw = bench.mean(0.016) - bench.mean(0.016, light=False)
    assert raw.max() / long.max() == pytest.approx(0.988, abs=0.003)


def test_saturation_ends_at_full_scale_and_spares_the_dark_end_of_the_spectrum() -> None:
    counts = Bench("mirror").turn(10, 10).read(1.0)
    assert counts.max() == FULL_SCALE
    assert np.count_nonzero(counts == FULL_SCALE) > 400
    assert counts[0] < 10_000


def test_the_brightest_peak_stays_below_saturation_at_the_shortest_exposure() -> None:
    assert Bench("mirror").turn(80, 80).read(0.008).max() < 0.8 * FULL_SCALE


@pytest.mark.parametrize("theta_out", [-26.0, -30.0, -34.0])
def test_the_detector_shades_the_sample_near_the_source(theta_out: float) -> None:
    bench = Bench("sample-1").turn(30, theta_out)
    assert np.abs(bench.signal(1.0).mean()) < 0.5
    assert bench.turn(30, -24.9).signal(1.0).mean() > 20


def test_a_point_just_outside_the_blocked_sector_is_not_lost_to_a_positioning_error() -> None:
    assert Bench("sample-1").turn(30, -25.02).signal(1.0).mean() > 20


def test_closed_shutter_and_cold_lamp_are_dark_alike() -> None:
    bench = Bench("mirror").turn(10, 10)
    closed = bench.optics.read_out(1.0, shutter_open=False, lamp_on=True, sensor_temperature=-10.0)
    off = bench.optics.read_out(1.0, shutter_open=True, lamp_on=False, sensor_temperature=-10.0)
    assert closed.mean() == pytest.approx(off.mean(), abs=1)
    assert closed.mean() == pytest.approx(OFFSET, abs=10)


def test_dark_signal_grows_with_time_and_doubles_every_six_degrees() -> None:
    bench, warm = Bench(), Bench(sensor_temperature=-4.0)
    bias, base = bench.mean(0.0, light=False), bench.mean(30.0, light=False)
    assert (bench.mean(60.0, light=False) - bias).mean() == pytest.approx(2 * (base - bias).mean(), rel=0.01)
    assert (warm.mean(30.0, light=False) - bias).mean() == pytest.approx(2 * (base - bias).mean(), rel=0.01)
    # pixels differ, so a dark spectrum must be subtracted pixel by pixel
    assert (base - bias).std() > 0.2 * (base - bias).mean()


def test_sample_over_reference_is_the_brdf_of_the_sample() -> None:
    theta_in, theta_out = 40.0, 20.0
    panel = Bench().turn(theta_in, theta_out).signal(30.0)
    disc = Bench("sample-2").turn(theta_in, theta_out).signal(30.0)
    usable = slice(300, 950)
    wavelengths = Bench().wavelengths[usable]
    angles = np.array([theta_in]), np.array([theta_out])
    expected = true_brdf(SAMPLES["sample-2"], *angles, wavelengths)[0]
    measured = (disc / panel)[usable] * NOMINAL_SRS99.brdf(*angles, wavelengths)[0]
    assert (measured / expected).mean() == pytest.approx(1, abs=3e-4)
    np.testing.assert_allclose(measured, expected, rtol=0.02)


def test_irradiance_follows_the_cosine_of_incidence() -> None:
    bench = Bench()
    near, far = bench.turn(0, 45).signal(10.0).sum(), bench.turn(60, -10).signal(10.0).sum()
    # published model of the panel: the BRF falls from 1.010 to 0.975 or so, the rest is cos 60 deg
    assert far / near == pytest.approx(0.5, rel=0.05)


def test_a_resumed_measurement_reads_the_same_counts_whatever_was_read_before() -> None:
    first, second = Bench("sample-3"), Bench("sample-3")
    second.turn(10, 20).read(0.5)
    second.optics.mount("spectralon")
    second.read(0.5)
    second.optics.mount("sample-3")
    a, b = first.turn(20, 30).read(0.5), second.turn(20, 30).read(0.5)
    np.testing.assert_array_equal(a, b)
    again = first.read(0.5)
    assert not np.array_equal(a, again)
    np.testing.assert_array_equal(again, second.read(0.5))
    assert not np.array_equal(a, Bench("sample-3", seed=2).turn(20, 30).read(0.5))


def test_another_process_draws_the_same_noise() -> None:
    script = (
        "from simulators.bench.optics import OpticalBench, positioning_error as p;"
        "from simulators.devices.clock import SimulatedClock;"
        "a = type('A', (), {'true_positions': lambda self, moments: 7.0 + 0 * moments})();"
        "b = OpticalBench(SimulatedClock(), seed=3, sample_axis=a, detector_axis=a);"
        "counts = b.read_out(0.1, shutter_open=False, lamp_on=True, sensor_temperature=-10.0);"
        "print(counts.sum(), p(3, 'sample stage')(12.5))"
    )
    outputs = {
        subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout
        for _ in range(2)
    }
    assert len(outputs) == 1


def test_stages_miss_their_target_by_the_same_small_amount_every_time() -> None:
    sample, detector = positioning_error(1, "sample stage"), positioning_error(1, "detector stage")
    targets = np.arange(4000) / 50
    errors = np.array([sample(float(t)) for t in targets])
    assert errors.std() == pytest.approx(0.005, rel=0.04)
    assert abs(errors.mean()) < 4 * 0.005 / np.sqrt(targets.size)
    assert sample(12.5) == sample(12.5) != detector(12.5)


def test_a_sample_that_is_looked_at_elsewhere_has_other_noise() -> None:
    first, second = Bench("sample-1").turn(20, 30), Bench("sample-1", spot=1).turn(20, 30)
    np.testing.assert_allclose(first.signal(10.0).mean(), second.signal(10.0).mean(), rtol=1e-4)
    assert not np.array_equal(first.read(1.0), second.read(1.0))


def test_what_is_mounted_has_one_name_and_an_unknown_one_changes_nothing() -> None:
    bench = Bench("mirror")
    assert (bench.optics.mounted, bench.optics.spot) == ("sample-6", 0)
    with pytest.raises(UnknownMaterial):
        bench.optics.mount("sample-9")
    assert bench.optics.mounted == "sample-6"


@pytest.mark.parametrize("name", ["mirror", "embossed", "sample-1"])
def test_a_moving_detector_reads_the_average_of_what_it_passes(name: str) -> None:
    clock, sample = SimulatedClock(), Standing()
    sample.angle = 30.0
    arm = Axis(clock, start=20.0, velocity=4.0, acceleration=60.0, limits=(-90.0, 180.0))
    bench = OpticalBench(clock, seed=1, sample_axis=sample, detector_axis=arm)
    bench.mount(name)
    arm.move(120.0)
    clock.advance_to(20.0)
    still = Bench(name)
    for ended in (3.3, 9.0, 9.4, 9.7, 9.9, 16.05):
        seconds = 0.01 if name == "mirror" else 0.5
        # constant acceleration over 4^2 / (2 * 60) degrees, then 4 degrees/s
        passed = 20 + 4 * (ended - seconds * (np.arange(200) + 0.5) / 200) - 4**2 / 120
        light = np.mean(
            [still.turn(30.0, angle - 30.0).optics.light(still.optics.geometry()) for angle in passed], axis=0
        )
        options = {"lamp_on": True, "sensor_temperature": -10.0, "ended": ended}
        reads = [bench.read_out(seconds, shutter_open=True, **options) for _ in range(20)]
        darks = [bench.read_out(seconds, shutter_open=False, **options) for _ in range(20)]
        x = np.mean(reads, axis=0) - np.mean(darks, axis=0)
        signal = x / np.polynomial.polynomial.polyval(x, bench.nonlinearity_coefficients)
        noise = np.sqrt(seconds * light.sum() / GAIN / 20 + 1044 * 2 * READ_NOISE**2 / 20)
        assert signal.sum() == pytest.approx(seconds * light.sum(), rel=2e-3, abs=5 * noise)
