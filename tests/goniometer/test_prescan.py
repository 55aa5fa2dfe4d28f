"""The pre-scan from end to end: real drivers sweep a simulated arm, and the plan uses what they saw."""

import asyncio
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from drivers.errors import ProtocolError
from goniometer.bench.route import Motion, StageMotion
from goniometer.campaigns.campaign import Campaign, OutgoingRange, Prescan, Resolution, Sample
from goniometer.datasets.between import interpolate
from goniometer.errors import CampaignError
from goniometer.geometry import Geometry
from goniometer.plans.plan_spec import plan_spec
from goniometer.radiometry.calibration import calibrate_scan, certificate_of
from goniometer.radiometry.raw import read_raw
from goniometer.radiometry.response import response
from goniometer.scans.prescan import check_prescan, cost, swept, way
from goniometer.scans.scheduler import run_campaign
from goniometer.storage.store import Store
from simulators.materials.materials import EMBOSSED, true_brdf
from tests import campaign_bench
from tests.campaign_bench import NOMINAL_PANEL, bench

INCIDENT = 30.0
LOBE = INCIDENT + 2 * EMBOSSED.tilt
CAMPAIGN = Campaign(
    name="Test",
    seed=3,
    samples=(Sample(name="Sheet", material="embossed"),),
    incident=(INCIDENT,),
    outgoing=OutgoingRange(start=-40, stop=80),
    resolution=Resolution(tolerance=0.02, colour_tolerance=None, points=24),
    prescan=Prescan(),
    reference=NOMINAL_PANEL,
    monitor=None,  # bound to time, which an interruption changes
)
SPEC = plan_spec(CAMPAIGN)


def run(store, campaign=CAMPAIGN, **options):
    asyncio.run(campaign_bench.run(store, campaign, **options))


def content(store):
    """All that must not depend on interruptions."""
    raw = read_raw(store, store.scans()[1].id)
    points = [(p.geometry, p.read_back, p.status) for p in store.points(raw.scan_id)]
    shots = [(s.geometry, s.integration_time, s.counts.tobytes()) for s in raw.shots]
    return points, shots, [s.shot.counts.tobytes() for s in raw.sweeps]


def top(store):
    """BRDF that is read at the top of a lobe, at about 550 nm, and what it is, 1/sr."""
    dataset = calibrate_scan(store, store.scans()[1].id)
    read = interpolate(dataset, np.array([INCIDENT]), np.array([LOBE])).brdf[0]
    truth = true_brdf(EMBOSSED, np.array([INCIDENT]), np.array([LOBE]), dataset.wavelengths)[0]
    here = int(np.argmin(np.abs(dataset.wavelengths - 550)))
    return read[here], truth[here]


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    store = Store.open(tmp_path_factory.mktemp("undisturbed") / "bench.db")
    run(store)
    yield store
    store.close()


@pytest.fixture
def store(tmp_path):
    opened = Store.open(tmp_path / "bench.db")
    yield opened
    opened.close()


def test_a_lobe_between_all_points_is_found(undisturbed):
    read, truth = top(undisturbed)
    assert truth > 1.5
    assert read == pytest.approx(truth, rel=0.15)


@pytest.mark.slow
def test_without_a_pre_scan_it_is_missed(store):
    run(store, CAMPAIGN.model_copy(update={"prescan": None}))
    read, _ = top(store)
    assert read == pytest.approx(EMBOSSED.reflectance / np.pi, rel=0.05)
    assert read_raw(store, store.scans()[1].id).sweeps == ()


def test_the_readings_cover_the_range_and_are_the_averages_of_the_brdf(undisturbed):
    raw = read_raw(undisturbed, undisturbed.scans()[1].id)
    ends = [(s.shot.geometry.theta_out, s.theta_out_end) for s in raw.sweeps]
    assert ends[0][0] == pytest.approx(-40 if ends[0][0] < 0 else 80, abs=0.2)
    assert abs(ends[-1][1] - ends[0][0]) == pytest.approx(120, abs=0.4)
    assert all(abs(a[1] - b[0]) < 0.02 for a, b in pairwise(ends))
    assert max(abs(b - a) for a, b in ends) == pytest.approx(2, abs=0.05)
    reference = undisturbed.reference_scan(raw.scan_id)
    known = response(read_raw(undisturbed, reference.id), certificate_of(undisturbed, 1))
    found = swept(raw, known, SPEC)
    assert 52 <= len(found) <= 56, "60 intervals but those of the blocked sector"
    assert not any(s.start < -25 and s.stop > -35 for s in found)
    grid = np.arange(-40, 80, 0.01)
    there = np.full(grid.size, INCIDENT)
    truth = np.cos(np.radians(INCIDENT)) * true_brdf(EMBOSSED, there, grid, np.array([600.0]))[:, 0]
    for reading in found[1:-1]:  # at the ends of its way the arm does not move evenly
        inside = truth[(grid > reading.start) & (grid < reading.stop)]
        # positions are read to 0.01 degrees, and a lobe may stand on the edge of an interval
        edge = 0.02 * np.abs(np.ptp(inside)) + 0.003
        assert reading.values == pytest.approx(inside.mean(), abs=edge + 5 * reading.noise.max())
        assert reading.theta_in == INCIDENT
        assert not reading.saturated


@pytest.mark.slow
def test_a_run_whose_sweep_was_stopped_or_spoilt_ends_like_one_that_was_left_alone(undisturbed, store):
    async def stopped(enough, change=lambda _: None):
        async with bench(CAMPAIGN.seed) as (instrument, mount, laboratory):
            change(instrument)
            running = run_campaign(store, CAMPAIGN, instrument, mount, lambda _: None, lambda _: None)
            task = asyncio.create_task(running)
            while not enough(laboratory):  # noqa: ASYNC110 - what happens in simulators wakes nobody here
                await asyncio.sleep(0)
            task.cancel()
            with pytest.raises(asyncio.CancelledError):
                await task
            assert not laboratory.usb_backend.shutter_open

    def sweeps(laboratory):
        arm = laboratory.bench._axes[1]
        return arm.velocity < 5 and arm.moving() and 30 < arm.position() < 80

    def has_begun(_):
        return sum(p.status == "done" for p in store.points(store.scans()[1].id)) >= 2

    def spoil(instrument):
        honest, spoilt = instrument.sweep, []

        async def sweep(*arguments):
            if not spoilt:
                spoilt.append(arguments)
                raise ProtocolError("QE Pro: a spectrum of the buffer got lost on USB")
            return await honest(*arguments)

        instrument.sweep = sweep

    asyncio.run(stopped(sweeps))
    assert read_raw(store, store.scans()[1].id).sweeps == (), "all of a sweep or nothing"
    asyncio.run(stopped(has_begun, spoil))
    assert len(read_raw(store, store.scans()[1].id).sweeps) > 50
    run(store)
    assert content(store) == content(undisturbed)


def test_the_way_ends_where_the_arm_is_wanted_next():
    assert way(SPEC, Geometry(INCIDENT, 70.0)) == (-40, 80)
    assert way(SPEC, Geometry(INCIDENT, -20.0)) == (80, -40)
    # an arm with backlash reads right only on its way up
    loose = replace(SPEC, motion=Motion(detector=StageMotion(backlash=1.0)))
    assert way(loose, Geometry(INCIDENT, -20.0)) == (-40, 80)
    # the blocked sector is no part of the range's end
    assert way(replace(SPEC, lowest=-32.0), Geometry(INCIDENT, 80.0)) == pytest.approx((-25, 80), abs=1e-6)


def test_a_pre_scan_costs_its_own_way_at_its_own_speed():
    motion = Motion(detector=StageMotion(velocity=30, acceleration=60))
    path = [Geometry(INCIDENT, -40.0), Geometry(INCIDENT, 80.0), Geometry(INCIDENT, 0.0)]
    added = cost(path, SPEC, Prescan(step=2, integration=0.5), motion)
    # down from 80 to -40 at 4 degrees/s before the first point, which is there
    assert added.seconds == pytest.approx(120 / 4 + 4 / 60, abs=1.1)
    assert (added.sample, added.sample_moves) == (0, 0)
    assert added.detector == pytest.approx(120)
    back = cost([Geometry(INCIDENT, 0.0), *path], SPEC, Prescan(), motion)
    assert back.detector == pytest.approx(120 + 40)


@pytest.mark.parametrize(
    ("prescan", "words"),
    [
        (Prescan(integration=0.005), r"0\.008 s and more.*prescan\.integration"),
        (Prescan(integration=2000), "less than 1600 s"),
        (Prescan(step=2, integration=0.05), r"30 deg/s; make prescan\.integration 0\.067 s or more"),
    ],
)
def test_a_pre_scan_that_the_devices_cannot_do_is_refused_before_anything_moves(prescan, words):
    with pytest.raises(CampaignError, match=words):
        check_prescan(prescan, (0.008, 1600.0), Motion(detector=StageMotion(velocity=30.0)))
