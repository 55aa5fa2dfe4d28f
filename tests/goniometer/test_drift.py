"""What monitors say of the lamp, against a lamp whose drift is known."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from goniometer.certificates.certificate import NOMINAL_SRS99
from goniometer.errors import CalibrationError
from goniometer.geometry import Geometry
from goniometer.radiometry.calibration import calibrate
from goniometer.radiometry.drift import factor, lamp_between, lamp_drift
from tests.goniometer.forward import WAVELENGTHS, Bench, Wrong, lobe, spectralon

ANGLES = [Geometry(30.0, float(o)) for o in range(-20, 80, 4)]
BRDF = lobe(0.3)


def lamp(moment, amplitude):
    """Relative change at 600 nm, as the forward model has it."""
    return amplitude * np.sin(2 * np.pi * moment / 3600)


def scan(amplitude, every=5, seed=0, noisy=True, brdf=BRDF, bench=None, scan_id=1):
    bench = bench or Bench(Wrong(drift=amplitude), seed, noisy=noisy)
    return bench.scan(ANGLES, brdf, 4.0, scan_id=scan_id, monitor_every=every, monitor_time=4.0)


def expected(raw, amplitude):
    """Relative change since the first monitor at each point, at 600 nm."""
    first = 1 + lamp(raw.monitors[0].moment, amplitude)
    return (1 + lamp(np.array([s.moment for s in raw.shots]), amplitude)) / first - 1


def test_the_lamp_is_followed_between_the_monitors_within_the_stated_uncertainty():
    raw = scan(0.02, noisy=False)
    drift = lamp_drift(raw)
    off = drift.level - expected(raw, 0.02)
    assert np.abs(expected(raw, 0.02)).max() > 0.015
    assert np.sqrt(np.mean(off**2)) < 2 * drift.u_interval
    assert 2e-5 < drift.u_interval < 1e-3


def test_a_lamp_that_gets_hotter_gets_bluer_and_a_grey_change_has_no_tilt():
    raw = scan(0.02, noisy=False)
    drift = lamp_drift(raw)
    # Wien: the tilt is the level; the first monitor's own colour bends that by less than the drift itself
    assert drift.tilt == pytest.approx(drift.level, rel=0.06, abs=2e-4)
    brighter = replace(raw.monitors[-1], counts=np.rint(1500 + 1.03 * (raw.monitors[0].counts - 1500.0)))
    grey = lamp_drift(replace(scan(0.0, noisy=False), monitors=(raw.monitors[0], brighter)))
    assert grey.end == pytest.approx((0.03, 0.0), abs=2e-4)


def test_a_steady_lamp_gets_no_more_uncertainty_than_the_noise_of_its_monitors():
    drifts = [lamp_drift(scan(0.0, seed=seed)) for seed in range(10)]
    scatter = np.sqrt(np.mean([np.mean(d.level**2) for d in drifts]))
    stated = np.sqrt(np.mean([d.u_interval**2 for d in drifts]))
    assert scatter < 6e-4
    assert stated == pytest.approx(scatter, rel=0.6)


def test_points_after_a_restart_are_not_interpolated_across_it():
    before, after = scan(0.02, noisy=False), scan(0.02, noisy=False)

    def later(shot, point=None):
        ids = tuple(i + 1000 for i in shot.ids)
        return replace(shot, ids=ids, point=point, session="two")

    half = len(before.shots) // 2
    first = [s for s in before.shots if s.point < half]
    second = [later(s, s.point) for s in after.shots if s.point >= half]
    monitors = (*before.monitors[:3], *(later(m) for m in after.monitors))
    joined = replace(before, shots=(*first, *second), monitors=monitors)
    drift = lamp_drift(joined)
    last = [s for s in joined.shots if s.moment > joined.monitors[2].moment and s.point < half]
    for shot in last:  # beyond the last monitor of its run the lamp is taken as it was there
        assert drift.level[shot.point] == pytest.approx(drift.level[last[0].point], abs=1e-12)


def test_without_two_monitors_nothing_is_said_of_the_lamp():
    raw = scan(0.02)
    assert lamp_drift(replace(raw, monitors=raw.monitors[:1])) is None
    assert lamp_between([raw, replace(raw, monitors=())]) is None
    assert lamp_between([replace(raw, monitors=()), raw]) is None


def test_a_scan_without_monitors_in_between_only_makes_the_pause_longer():
    bench = Bench(Wrong(drift=0.04), noisy=False)
    first, middle, last = (scan(0.04, bench=bench, scan_id=i) for i in (1, 2, 3))
    watched, blind = lamp_between([first, middle, last]), lamp_between([first, replace(middle, monitors=()), last])
    true = (1 + lamp(last.monitors[0].moment, 0.04)) / (1 + lamp(first.monitors[0].moment, 0.04)) - 1
    assert blind.u > 5 * watched.u
    for between in (watched, blind):
        assert abs(between.level - true) < 2 * between.u


def test_two_monitors_that_agree_by_chance_do_not_make_a_lamp_certain():
    raw = scan(0.01, noisy=False)
    alike = lamp_drift(replace(raw, monitors=(raw.monitors[0], replace(raw.monitors[0], moment=2000.0))))
    assert alike.u_interval == pytest.approx(raw.constants.bench.u_lamp / 4)


def test_monitors_that_are_saturated_are_refused_in_a_sentence():
    raw = scan(0.0)
    burnt = tuple(replace(m, counts=np.full_like(m.counts, 200_000)) for m in raw.monitors)
    with pytest.raises(CalibrationError, match="saturated"):
        lamp_drift(replace(raw, monitors=burnt))


def test_a_sample_measured_long_after_the_panel_is_compared_with_the_lamp_of_then():
    bench = Bench(Wrong(drift=0.04), noisy=False)
    scans = [scan(0.04, bench=bench, brdf=spectralon(), scan_id=1)]
    scans += [scan(0.04, bench=bench, scan_id=2), scan(0.04, bench=bench, scan_id=3)]
    between = lamp_between(scans)
    true = (1 + lamp(scans[2].monitors[0].moment, 0.04)) / (1 + lamp(scans[0].monitors[0].moment, 0.04)) - 1
    assert abs(true) > 0.008
    assert abs(between.level - true) < 2 * between.u
    dataset = calibrate(scans[2], scans[0], NOMINAL_SRS99, scans_between=[scans[1]])
    truth = BRDF(dataset.theta_in, dataset.theta_out, dataset.wavelengths, 1.0)
    lit = (dataset.wavelengths > 500) & (dataset.wavelengths < 800)
    drift = np.sqrt(sum(s.values**2 for s in dataset.sources if s.part == "drift"))
    assert np.all(np.abs(dataset.brdf - truth)[:, lit] < 3 * drift[:, lit] + 2e-3 * truth[:, lit])


def test_points_between_the_same_monitors_share_their_error():
    raw = scan(0.02)
    drift = lamp_drift(raw)
    moments = [m.moment for m in raw.monitors]
    for number, (low, high) in enumerate(pairwise(moments)):
        inside = [s.point for s in raw.shots if low < s.moment < high]
        assert set(drift.interval[inside].tolist()) == {number}


def test_the_factor_is_level_and_tilt_about_600_nm():
    found = factor(np.array([0.02]), np.array([0.05]), np.array([400.0, 600.0, 1000.0]))
    np.testing.assert_allclose(found, [[1.045, 1.02, 1.0]])
    assert WAVELENGTHS.size == 1044
