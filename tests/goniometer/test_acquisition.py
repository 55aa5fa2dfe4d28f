"""What a scan takes, and when, on the wire-level simulators: exposures, darks, stray light, the lamp, other spots."""

import asyncio
import logging
from itertools import pairwise

import numpy as np
import pytest

from drivers.errors import DeviceTimeout
from goniometer.bench.safety import Forbidden
from goniometer.campaigns.campaign import Campaign, Homogeneity, Integration, Monitor, OutgoingRange, Resolution, Sample
from goniometer.geometry import Geometry
from goniometer.plans.plan import Measured, spot_points
from goniometer.plans.plan_spec import PlanSpec, monitor_direction
from goniometer.radiometry.calibration import calibrate_scan
from goniometer.radiometry.raw import read_raw
from goniometer.scans.exposure import DarkSignal, below_wanted, detector_of, take
from goniometer.scans.scheduler import run_campaign
from goniometer.storage.store import Store
from simulators.bench.imperfections import Imperfections
from tests.campaign_bench import NOMINAL_PANEL, bench, run

CAMPAIGN = Campaign(
    name="Test",
    seed=3,
    samples=(Sample(name="Rough", material="sample-1"),),
    incident=(30.0,),
    resolution=Resolution(mode="uniform", step=11.5),
    reference=NOMINAL_PANEL,
    monitor=None,
    stray_light=False,
)
MIRROR = (Sample(name="Mirror", material="sample-6"),)


@pytest.fixture
def store(tmp_path):
    opened = Store.open(tmp_path / "bench.db")
    yield opened
    opened.close()


def changed(**changes):
    return CAMPAIGN.model_copy(update=changes)


def kinds(store, scan_id):
    """Kinds of all exposures in the order in which they were written, those in a row as one."""
    found = [e.kind for e in store.exposures(scan_id)]
    return [kind for kind, before in zip(found, [None, *found], strict=False) if kind != before]


# Exposures


@pytest.mark.parametrize(("theta_out", "wanted"), [(10.0, 300.0), (-70.0, 60.0)])
def test_the_wanted_signal_to_noise_ratio_is_the_scatter_of_a_point_that_is_repeated(theta_out, wanted):
    # so short that several are averaged: a single spectrum may be longer than it had to be, by up to a factor of two
    policy = Integration(signal_to_noise=wanted, maximum=0.25)

    async def repeat():
        async with bench(1) as (instrument, _, laboratory):
            laboratory.mount("sample-1")
            constants = await instrument.constants()
            detector, darks = detector_of(constants), {}

            async def dark(time, temperature):
                if time not in darks:
                    counts = np.stack([(await instrument.dark(time)).counts for _ in range(4)])
                    darks[time] = DarkSignal(counts.mean(0), counts.var(0, ddof=1).mean(), temperature)
                return darks[time]

            await instrument.arm.goto(Geometry(30.0, theta_out))
            rates = []
            for _ in range(30):
                taken = await take(instrument, detector, policy, None, dark)
                assert taken.reason == ""
                (time,) = {s.integration_time for s in taken.spectra}
                light = np.mean([s.counts for s in taken.spectra], axis=0) - darks[time].mean
                rates.append(light[detector.bins].sum(axis=1) / time)
            return np.array(rates)

    rates = asyncio.run(repeat())
    ratio = np.median(rates.mean(axis=0) / rates.std(axis=0, ddof=1))
    print(f"signal-to-noise ratio: {ratio:.0f}, wanted {wanted:.0f}")
    assert ratio == pytest.approx(wanted, rel=0.1)


def test_a_mirror_peak_and_its_dark_background_are_measured_in_one_campaign(store):
    policy = Integration(signal_to_noise=50.0, time_limit=60.0)
    asyncio.run(run(store, changed(samples=MIRROR, integration=policy)))
    scan = store.scans()[1]
    raw = read_raw(store, scan.id)
    costs = {shot.point: len(shot.counts) * shot.integration_time for shot in raw.shots}
    assert max(shot.counts.max() for shot in raw.shots) < raw.constants.saturation
    peak = raw.planned.index(Geometry(30.0, 30.0))
    assert costs[peak] < 0.1
    assert max(costs.values()) <= 60.0
    reasons = {p.geometry: p.reason for p in store.points(scan.id)}
    assert reasons[Geometry(30.0, 30.0)] == ""
    assert reasons[Geometry(30.0, -85.0)].startswith("reached a signal-to-noise ratio of ")
    assert reasons[Geometry(30.0, -85.0)].endswith(" of 50 within 60 s")
    short = [p for p in store.points(scan.id) if p.reason]
    worst = min(short, key=lambda p: float(p.reason.split()[5]))
    told = below_wanted(store.points(scan.id), 50.0)
    assert told.startswith(f"{len(short)} points stayed below the wanted signal-to-noise ratio, the worst at ")
    assert f"theta_out = {worst.geometry.theta_out:g} deg: reached {worst.reason.split()[5]} of 50." in told
    dataset = calibrate_scan(store, scan.id)
    ratio = np.median(np.abs(dataset.brdf) / dataset.u_counts, axis=1)
    assert ratio[peak] > 45.0
    assert dataset.brdf[peak].max() > 1e5 * np.abs(np.median(dataset.brdf, axis=1)).min()


def test_combined_exposures_make_violet_less_uncertain_and_nothing_is_lost_at_the_bright_end(tmp_path):
    found = []
    for exposures in (1, 2):
        store = Store.open(tmp_path / f"{exposures}.db")
        asyncio.run(run(store, changed(integration=Integration(maximum=120.0, exposures=exposures))))
        found.append(calibrate_scan(store, store.scans()[1].id))
        raw = read_raw(store, store.scans()[1].id)
        store.close()
    one, two = found
    violet, bright = (int(np.argmin(np.abs(one.wavelengths - w))) for w in (400.0, 620.0))
    relative = [np.median(d.u_counts / d.brdf, axis=0) for d in found]
    print(
        f"relative uncertainty at 400 nm: {relative[0][violet]:.2e} with one time, {relative[1][violet]:.2e} with two"
    )
    assert relative[1][violet] < 0.7 * relative[0][violet]
    assert relative[1][bright] < 1.1 * relative[0][bright]
    assert np.isfinite(two.brdf).all()
    assert not two.flags.any()
    for point in range(len(raw.planned)):
        first, *more = (shot for shot in raw.shots if shot.point == point)
        assert first.counts.max() < raw.constants.saturation
        assert all(a.integration_time < b.integration_time for a, b in pairwise([first, *more]))
    assert any(shot.counts.max() == raw.constants.saturation for shot in raw.shots)


@pytest.mark.slow
def test_interruptions_change_no_exposure_of_a_campaign_that_controls_its_exposures(tmp_path):
    campaign = changed(
        samples=MIRROR,
        integration=Integration(signal_to_noise=200.0, time_limit=60.0, exposures=2),
        stray_light=True,
        homogeneity=Homogeneity(points=3),
        resolution=Resolution(tolerance=0.02, points=14),
    )

    async def stopped_after(store, count):
        async with bench(campaign.seed) as (instrument, mount, _):
            seen = iter(range(1, 10**6))

            def report(_):
                if next(seen) == count:
                    task.cancel()

            task = asyncio.create_task(run_campaign(store, campaign, instrument, mount, report, lambda _: None))
            with pytest.raises(asyncio.CancelledError):
                await task

    def content(store):
        return [
            [(e.kind, e.geometry, e.integration_time, e.counts.tobytes()) for e in store.exposures(scan.id)]
            for scan in store.scans()
        ]

    undisturbed, stopped = (Store.open(tmp_path / f"{name}.db") for name in ("undisturbed", "stopped"))
    asyncio.run(run(undisturbed, campaign))
    for count in (2, 4, 7, 30, 31):
        asyncio.run(stopped_after(stopped, count))
    asyncio.run(run(stopped, campaign))
    assert [s.outcome for s in stopped.scans()] == ["completed"] * 3
    for mine, expected in zip(content(stopped), content(undisturbed), strict=True):
        light, known = ([e for e in exposures if e[0] in {"light", "stray"}] for exposures in (mine, expected))
        assert light == known
        # a dark is taken where the stages happen to stand
        assert [e[2] for e in mine if e[0] == "dark"] == [e[2] for e in expected if e[0] == "dark"]
    undisturbed.close()
    stopped.close()


# Darks


def test_darks_are_taken_once_while_the_detector_keeps_its_temperature(store):
    asyncio.run(run(store, CAMPAIGN))
    for scan in store.scans():
        darks = read_raw(store, scan.id).darks
        assert len({dark.integration_time for dark in darks}) == len(darks)
        assert {dark.counts.shape for dark in darks} == {(4, 1044)}


def test_darks_are_taken_again_when_the_detector_has_another_temperature(store):
    asyncio.run(run(store, CAMPAIGN, imperfections=Imperfections(cooler_ripple=0.45)))
    raw = read_raw(store, store.scans()[1].id)
    temperatures = [shot.temperature for shot in raw.shots]
    assert max(temperatures) - min(temperatures) > 0.6
    again = {
        time: [d for d in raw.darks if d.integration_time == time] for time in {d.integration_time for d in raw.darks}
    }
    assert 2 <= max(len(sets) for sets in again.values()) <= 4
    # a dark that was taken because of a spectrum comes a little later than it
    off = [min(abs(d.temperature - s.temperature) for d in again[s.integration_time]) for s in raw.shots]
    assert max(off) <= 0.35


# Stray light


def test_stray_light_is_measured_once_at_each_incident_angle_of_every_scan_before_its_points(store):
    campaign = changed(incident=(20.0, 50.0), stray_light=True)
    asyncio.run(run(store, campaign, imperfections=Imperfections(stray_light=5e-4)))
    for scan in store.scans():
        raw = read_raw(store, scan.id)
        assert [round(shot.geometry.theta_in) for shot in raw.stray] == [20, 50]
        assert {shot.integration_time for shot in raw.stray} == {campaign.integration.maximum}
        for shot in raw.stray:
            assert shot.geometry.detector_angle == pytest.approx(0.0, abs=0.01)
            theta_in = shot.geometry.theta_in
            first = min(s.ids[0] for s in raw.shots if abs(s.geometry.theta_in - theta_in) < 0.1)
            assert shot.ids[-1] < first
            (dark,) = (d for d in raw.darks if d.integration_time == shot.integration_time)
            seen = (shot.counts.mean(axis=0) - dark.counts.mean(axis=0)) / shot.integration_time
            # Spectralon at theta_in 0, theta_out 45 deg gives 2000 counts a second in the brightest pixel
            assert np.sort(seen)[-200:].mean() == pytest.approx(5e-4 * np.pi * 2000.0, rel=0.1)


def test_stray_light_that_would_saturate_is_measured_in_less_time(store):
    asyncio.run(run(store, changed(stray_light=True), imperfections=Imperfections(stray_light=3.0)))
    raw = read_raw(store, store.scans()[1].id)
    (shot,) = raw.stray
    assert shot.integration_time < CAMPAIGN.integration.maximum
    assert shot.counts.max() < raw.constants.saturation
    assert shot.integration_time in {dark.integration_time for dark in raw.darks}


def test_a_bench_whose_arm_cannot_stand_before_the_source_measures_without_stray_light_and_says_so(store, caplog):
    def change(instrument):
        instrument.arm.forbidden = (Forbidden(sample=(20.0, 40.0), detector=(-4.0, 4.0)),)

    campaign = changed(stray_light=True, outgoing=OutgoingRange(start=-20.0, stop=85.0))
    with caplog.at_level(logging.WARNING, logger="goniometer.scans.auxiliary"):
        asyncio.run(run(store, campaign, change=change))
    assert [s.outcome for s in store.scans()] == ["completed", "completed"]
    assert {p.status for s in store.scans() for p in store.points(s.id)} == {"done"}
    assert "stray" not in {e.kind for s in store.scans() for e in store.exposures(s.id)}
    told = [r.getMessage() for r in caplog.records if r.name == "goniometer.scans.auxiliary"]
    assert len(told) == 2
    assert all("At theta_in = 30 deg stray light is not measured" in text and "forbidden" in text for text in told)


# The lamp


def test_the_lamp_is_looked_at_when_a_scan_begins_and_ends_and_as_often_as_was_asked_between(store):
    lamp = Imperfections(lamp_drift=0.02)
    campaign = changed(monitor=Monitor(every=300.0), resolution=Resolution(mode="uniform", step=6.0))
    asyncio.run(run(store, campaign, imperfections=lamp))
    for scan in store.scans():
        raw = read_raw(store, scan.id)
        moments = np.array([m.moment for m in raw.monitors])
        assert {(m.integration_time, m.counts.shape) for m in raw.monitors} == {
            (raw.monitors[0].integration_time, (1, 1044))
        }
        assert {(round(m.geometry.theta_in), round(m.geometry.theta_out)) for m in raw.monitors} == {(30, 30)}
        assert raw.monitors[0].ids[0] < raw.shots[0].ids[0]
        assert raw.monitors[-1].ids[0] > raw.shots[-1].ids[-1]
        assert all(a.moment <= b.moment for a, b in pairwise(raw.shots))
        longest = max(p.seconds for p in store.points(scan.id))
        assert len(moments) > 3
        assert (np.diff(moments)[:-1] >= 300.0 - 1.0).all()
        assert (np.diff(moments) <= 300.0 + longest).all()
        level = [float(m.counts.max() - 1500.0) for m in raw.monitors]
        truth = [float(lamp.lamp(m, np.array([650.0]))[0]) for m in moments]
        ratio = np.array(level) / level[0] / (np.array(truth) / truth[0])
        assert ratio == pytest.approx(1.0, abs=4e-3)


def test_a_resumed_scan_looks_at_the_lamp_first_and_as_it_did_before(store):
    campaign = changed(monitor=Monitor())

    def change(instrument):
        expose, count = instrument.expose, iter(range(10**6))

        async def gone(time):
            if next(count) > 12:
                raise DeviceTimeout("QE Pro: no answer within 1 s.")
            return await expose(time)

        instrument.expose = gone

    with pytest.raises(DeviceTimeout):
        asyncio.run(run(store, campaign, change=change))
    stopped = len(store.exposures(store.scans()[0].id))
    asyncio.run(run(store, campaign))
    raw = read_raw(store, store.scans()[0].id)
    resumed = [e.kind for e in store.exposures(raw.scan_id)][stopped:]
    assert resumed[0] == "monitor"
    assert len({m.integration_time for m in raw.monitors}) == 1
    assert len(raw.monitors) >= 3
    # moments of the first run cannot be compared with those of the second, whatever they are
    exposures = store.exposures(raw.scan_id)
    assert len({e.session for e in exposures[:stopped]}) == len({e.session for e in exposures[stopped:]}) == 1
    assert exposures[0].session != exposures[-1].session


def test_a_fault_on_the_way_to_the_lamp_costs_a_point_one_attempt_and_is_not_met_again_at_the_next(store):
    def change(instrument):
        goto, visits = instrument.arm.goto, iter(range(10**6))

        async def jammed(geometry):
            if geometry == Geometry(30.0, 30.0) and next(visits) == 1:
                raise DeviceTimeout("detector stage: it did not arrive within 20 s.")
            return await goto(geometry)

        instrument.arm.goto = jammed

    campaign = changed(monitor=Monitor(every=200.0), resolution=Resolution(mode="uniform", step=20.0))
    asyncio.run(run(store, campaign, change=change))
    points = store.points(store.scans()[0].id)
    assert {p.status for p in points} == {"done"}
    assert sorted(p.attempts for p in points)[-2:] == [1, 2]


def test_a_lamp_that_is_not_monitored_is_not_looked_at(store):
    asyncio.run(run(store, CAMPAIGN))
    assert {kind for scan in store.scans() for kind in kinds(store, scan.id)} == {"light", "dark"}


@pytest.mark.parametrize(
    ("incident", "lowest", "highest", "expected"),
    [
        ((0.0, 20.0, 50.0), -85.0, 85.0, Geometry(20.0, 20.0)),
        ((50.0, 70.0), -85.0, 30.0, Geometry(50.0, 30.0)),
    ],
)
def test_the_lamp_is_monitored_where_light_is_and_the_arm_may_go(incident, lowest, highest, expected):
    assert monitor_direction(PlanSpec(incident, lowest, highest)) == expected


def test_at_normal_incidence_the_lamp_is_monitored_beside_the_source():
    direction = monitor_direction(PlanSpec((0.0,)))
    assert not direction.blocked
    assert abs(direction.theta_out) == pytest.approx(5.0, abs=1e-6)


# Another spot


def test_another_spot_is_measured_in_some_directions_of_the_sample_before_it_is_fitted(store):
    events = []

    async def work():
        campaign = changed(homogeneity=Homogeneity(points=4), resolution=Resolution())
        async with bench(3) as (instrument, mount, _):

            async def noted(scan):
                events.append((scan.kind, scan.sample))
                await mount(scan)

            def finished(scan):
                events.append(("finished", scan.sample))

            with store.exclusive():
                await run_campaign(store, campaign, instrument, noted, lambda _: None, finished)

    asyncio.run(work())
    assert events == [
        ("reference", "reference"),
        ("sample", "Rough"),
        ("spot", "Rough"),
        ("finished", "Rough"),
    ]
    _, sample, spot = store.scans()
    directions = [p.geometry for p in store.points(spot.id)]
    assert len(directions) == 4
    assert set(directions) <= {p.geometry for p in store.points(sample.id)}
    assert Geometry(30.0, 30.0) in directions
    assert min(g.theta_out for g in directions) < -30.0
    assert max(g.theta_out for g in directions) > 50.0
    assert read_raw(store, spot.id).diameter == 50.0


def test_a_spot_that_fails_costs_its_sample_no_dataset_and_is_in_it_when_it_was_measured_after_all(store):
    campaign = changed(homogeneity=Homogeneity(points=2))
    made = []

    def finished(scan):
        dataset = calibrate_scan(store, scan.id)
        made.append(dataset.lineage["spot_scan"])
        store.add_dataset(scan.id, dataset)

    async def work(lamp):
        async with bench(3) as (instrument, mount, _):

            async def mounted(scan):
                if scan.kind == "spot" and not lamp:
                    raise DeviceTimeout("QE Pro: no answer within 1 s.")
                await mount(scan)

            with store.exclusive():
                await run_campaign(store, campaign, instrument, mounted, lambda _: None, finished)

    for _ in range(2):  # the second time there is a dataset, and nothing new
        with pytest.raises(DeviceTimeout):
            asyncio.run(work(lamp=False))
        assert made == [None]
    asyncio.run(work(lamp=True))
    asyncio.run(work(lamp=True))
    assert made == [None, store.scans()[2].id]


def test_nobody_is_asked_to_mount_another_spot_that_could_be_compared_with_nothing(store, caplog, monkeypatch):
    monkeypatch.setattr("goniometer.scans.batches.spot_points", lambda measured, count: [])
    finished = []
    with caplog.at_level(logging.WARNING, logger="goniometer.scans.scheduler"):
        asyncio.run(run(store, changed(homogeneity=Homogeneity()), finished=finished.append))
    spot = store.scans()[2]
    assert (spot.outcome, store.points(spot.id)) == ("failed", [])
    assert spot.reason == "No direction of Rough has a value with which another spot could be compared."
    assert spot.reason in [record.getMessage() for record in caplog.records]
    assert [scan.sample for scan in finished] == ["Rough"]


def test_the_directions_of_another_spot_are_spread_and_bright():
    def measured(theta_in, theta_out, value):
        return Measured(Geometry(theta_in, theta_out), np.full(4, value), np.full(4, 1e-3))

    grid = [measured(t, float(a), 0.1) for t in (0.0, 40.0, 80.0) for a in range(-30, 81, 10)]
    dark = [measured(40.0, 85.0, 1e-3), measured(40.0, -70.0, -1e-3), measured(40.0, 75.0, np.nan)]
    found = spot_points(grid + dark, 5)
    assert len(found) == 5
    assert {g.theta_in for g in found} == {40.0}
    assert (found[0].theta_out, found[-1].theta_out) == (-30.0, 80.0)
    assert Geometry(40.0, 40.0) in found
    assert len(spot_points(grid[:2], 5)) == 2
    assert len(spot_points(dark, 5)) == 2
    assert spot_points([], 5) == []
