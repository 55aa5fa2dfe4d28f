"""Whole campaigns on the wire-level simulators: the real drivers talk to simulated devices.

Run as a program, `test_scheduler.py DATABASE POINT PLACE`, it runs the campaign and kills itself without
warning at a point, for the test that a power cut loses nothing.
"""

import asyncio
import os
import signal
import sqlite3
import subprocess
import sys
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from drivers.errors import DeviceDisconnected, DeviceTimeout
from goniometer.campaigns.campaign import Campaign, Integration, Resolution, Sample
from goniometer.constants import BenchData
from goniometer.errors import CampaignError, GeometryError, NotInStore, ReferenceIncomplete, RunAborted, StoreError
from goniometer.radiometry.calibration import calibrate_scan
from goniometer.radiometry.raw import read_raw
from goniometer.scans.scheduler import run_campaign
from goniometer.storage.records import Expected
from goniometer.storage.store import Store
from simulators.materials.materials import material, true_brdf
from tests import campaign_bench
from tests.campaign_bench import NOMINAL_PANEL, bench

CAMPAIGN = Campaign(
    name="Test",
    seed=3,
    samples=(Sample(name="Mirror", material="sample-6"),),
    incident=(30.0,),
    resolution=Resolution(tolerance=0.05, colour_tolerance=None),
    reference=NOMINAL_PANEL,
    monitor=None,  # bound to time, which an interruption changes
)


async def run(store, campaign=CAMPAIGN, **options):
    await campaign_bench.run(store, campaign, **options)


def content(store):
    """All that a campaign leaves that must not depend on interruptions."""
    return [
        [
            (p.geometry, p.read_back, p.status, shot.integration_time, shot.counts.tobytes())
            for p, shot in zip(store.points(scan.id), read_raw(store, scan.id).shots, strict=True)
        ]
        for scan in store.scans()
    ]


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """A campaign that ran without interruption, and everything that it reported."""
    store = Store.open(tmp_path_factory.mktemp("undisturbed") / "bench.db")
    reports, finished = [], []
    asyncio.run(run(store, report=reports.append, finished=finished.append))
    yield store, reports, finished
    store.close()


@pytest.fixture
def store(tmp_path):
    opened = Store.open(tmp_path / "bench.db")
    yield opened
    opened.close()


def test_the_measured_brdf_is_that_of_the_sample_within_its_uncertainty(tmp_path):
    store = Store.open(tmp_path / "bench.db")
    rough = CAMPAIGN.model_copy(update={"samples": (Sample(name="Rough", material="sample-1"),)})
    asyncio.run(run(store, rough))
    dataset = calibrate_scan(store, store.scans()[1].id)
    truth = true_brdf(material("sample-1"), dataset.theta_in, dataset.theta_out, dataset.wavelengths)
    score = (dataset.brdf - truth) / dataset.u_counts  # the bench is ideal but for its noise
    assert score.std() == pytest.approx(1, abs=0.1)
    assert score.mean() == pytest.approx(0, abs=0.2)
    assert np.median(dataset.u_counts / truth) < 0.01
    store.close()


def test_a_campaign_ends_with_every_point_done_and_the_fit_job_started(undisturbed):
    store, _, finished = undisturbed
    assert {(s.phase, s.outcome) for s in store.scans()} == {("finished", "completed")}
    assert {p.status for s in store.scans() for p in store.points(s.id)} == {"done"}
    assert [scan.sample for scan in finished] == ["Mirror"]


def test_the_mirror_peak_is_measured_without_saturation(undisturbed):
    store, _, _ = undisturbed
    raw = read_raw(store, store.scans()[1].id)
    assert max(shot.counts.max() for shot in raw.shots) < raw.constants.saturation
    assert min(shot.integration_time for shot in raw.shots) < 0.1
    assert max(shot.integration_time for shot in raw.shots) == 30.0


def test_progress_counts_up_to_what_was_expected(undisturbed):
    _, reports, _ = undisturbed
    for kind in ("reference", "sample"):
        mine = [r for r in reports if r.kind == kind]
        assert mine[-1].phase == "finished"
        assert mine[-1].done == mine[-1].expected
        assert mine[-1].fraction == 1
        assert mine[-1].bench_remaining == Expected(0.0, 0.0, 0.0)
        assert all(a.done <= b.done for a, b in pairwise(mine))
        if kind == "reference":  # how many points a sample will have is a guess until its coarse pass is done
            halfway = mine[len(mine) // 2]
            left = mine[-1].bench_elapsed - halfway.bench_elapsed
            assert halfway.bench_remaining.seconds == pytest.approx(left, rel=0.1)
            assert halfway.bench_remaining.low <= 1.1 * left
            assert halfway.bench_remaining.high >= 0.9 * left
            assert 0 < halfway.dead_time < 1.0
        else:
            assert mine[0].expected == pytest.approx(mine[-1].done, rel=0.3)


def test_a_completed_campaign_is_not_repeated(undisturbed, tmp_path):
    store, _, _ = undisturbed
    before = content(store)
    reports = []
    asyncio.run(run(store, report=reports.append))
    assert reports == []
    assert content(store) == before


@pytest.mark.parametrize("interruptions", [1, 4])
def test_an_emergency_stop_makes_the_bench_safe_and_the_run_goes_on_where_it_stood(undisturbed, store, interruptions):
    total = sum(len(points) for points in content(undisturbed[0]))

    async def stopped_after(count):
        async with bench(CAMPAIGN.seed) as (instrument, mount, laboratory):
            seen = []

            def report(progress):
                seen.append(progress)
                if len(seen) == count:
                    task.cancel()

            task = asyncio.create_task(run_campaign(store, CAMPAIGN, instrument, mount, report, lambda _: None))
            with pytest.raises(asyncio.CancelledError):
                await task
            assert not laboratory.usb_backend.shutter_open

    for i in range(interruptions):
        asyncio.run(stopped_after(3 + 7 * i))
        ended = [scan for scan in store.scans() if scan.outcome == "aborted"]
        assert len(ended) == 1
        assert "stopped" in ended[0].reason
        assert not any(p.status == "running" for p in store.points(ended[0].id))
    assert sum(len(store.points(s.id)) for s in store.scans()) < total
    asyncio.run(run(store))
    assert content(store) == content(undisturbed[0])


@pytest.mark.slow
def test_a_power_cut_at_any_moment_loses_nothing_and_changes_nothing(undisturbed, database):
    for point, place in ((4, "expose"), (9, "commit"), (20, "dark"), (31, "plan")):
        killed = subprocess.run(
            [sys.executable, __file__, str(database), str(point), place], capture_output=True, check=False
        )
        assert killed.returncode == -signal.SIGKILL, killed.stderr.decode()
    store = Store.open(database)
    asyncio.run(run(store))
    assert content(store) == content(undisturbed[0])
    dataset, expected = (calibrate_scan(s, s.scans()[1].id) for s in (store, undisturbed[0]))
    assert dataset.content_hash == expected.content_hash
    if not isinstance(database, str):
        with sqlite3.connect(database) as check:
            assert check.execute("PRAGMA integrity_check").fetchone() == ("ok",)
        check.close()
    store.close()


def test_pause_resume_and_abort_work_from_another_process(either, database):
    other = Store.open(database)
    phases = []

    def report(progress):
        phases.append(progress.phase)
        if progress.done == 3 and "paused" not in phases and other.command(progress.scan_id) is None:
            other.request(progress.scan_id, "pause")
            assert other.scan(progress.scan_id).phase == "pausing"
        elif progress.phase == "paused":
            assert other.scan(progress.scan_id).phase == "paused"
            other.request(progress.scan_id, "resume")
        elif progress.done == 8 and progress.phase == "running":
            other.request(progress.scan_id, "abort")

    with pytest.raises(RunAborted):
        asyncio.run(run(either, report=report))
    assert "paused" in phases
    scan = either.scans()[0]
    assert (scan.phase, scan.outcome, scan.command) == ("finished", "aborted", None)
    assert 8 <= sum(p.status == "done" for p in either.points(scan.id)) <= 9
    other.close()


def test_a_pause_asked_for_during_the_last_point_is_obeyed(either, database):
    other = Store.open(database)
    phases, outcomes = [], []

    def report(progress):
        phases.append(progress.phase)
        outcomes.append(progress.outcome)
        if progress.phase == "running" and progress.done == progress.expected:
            other.request(progress.scan_id, "pause")
        elif progress.phase == "paused":
            other.request(progress.scan_id, "abort")

    with pytest.raises(RunAborted):
        asyncio.run(run(either, report=report))
    assert phases[-2:] == ["paused", "finished"]
    assert [outcome for outcome in outcomes if outcome] == ["aborted"]
    reference, sample = either.scans()
    assert {p.status for p in either.points(reference.id)} == {"done"}
    assert sample.phase == "idle"
    other.close()


@pytest.mark.parametrize("second", ["pause", "resume"])
def test_nothing_takes_back_an_abort_that_was_not_taken_up_yet(store, second):
    scan = store.scans(store.add_campaign(CAMPAIGN))[0].id
    store.set_phase(scan, "running")
    with store.exclusive():
        store.request(scan, "pause")
        store.request(scan, "abort")
        with pytest.raises(NotInStore, match="is being aborted"):
            store.request(scan, second)
        store.clear_command(scan, "pause")  # the scheduler had read this one before the abort came
    assert (store.scan(scan).phase, store.command(scan)) == ("aborting", "abort")


def test_a_run_ends_what_a_killed_run_of_another_campaign_left_running(store):
    other = store.add_campaign(CAMPAIGN.model_copy(update={"name": "Killed"}))
    stale = store.scans(other)[0].id
    store.set_phase(stale, "running")
    with pytest.raises(DeviceDisconnected):
        asyncio.run(run(store, change=failing(DeviceDisconnected("gone"), set(range(10**4)))))
    assert (store.scan(stale).phase, store.scan(stale).outcome) == ("finished", "aborted")


def test_a_changed_campaign_does_not_go_on_under_the_old_name(undisturbed):
    changed = CAMPAIGN.model_copy(update={"resolution": Resolution(tolerance=0.5)})
    with pytest.raises(CampaignError, match="other content"):
        asyncio.run(run(undisturbed[0], changed))


def test_times_that_the_device_cannot_take_are_refused_before_anything_is_mounted_or_written(store):
    hasty = CAMPAIGN.model_copy(update={"integration": Integration(minimum=0.001)})
    with pytest.raises(CampaignError, match=r"integration\.minimum"):
        asyncio.run(run(store, hasty))
    assert store.campaigns() == {}


def failing(error, calls):
    """A change of the instrument: these calls of its `expose` raise `error`."""

    def change(instrument):
        expose, count = instrument.expose, iter(range(10**6))

        async def flaky(integration_time):
            if next(count) in calls:
                raise error
            return await expose(integration_time)

        instrument.expose = flaky

    return change


def test_a_passing_fault_costs_an_attempt_and_nothing_else(undisturbed, store):
    asyncio.run(run(store, change=failing(DeviceTimeout("QE Pro: no answer within 1 s."), {5, 6, 40})))
    for scan, expected in zip(store.scans(), undisturbed[0].scans(), strict=True):
        assert [p.geometry for p in store.points(scan.id)] == [p.geometry for p in undisturbed[0].points(expected.id)]
        assert {p.status for p in store.points(scan.id)} == {"done"}
    attempts = [p.attempts for s in store.scans() for p in store.points(s.id)]
    assert sum(a > 1 for a in attempts) >= 2


def jammed_at(theta_out, message="detector stage: it did not arrive within 20 s."):
    """A change of the instrument: it cannot go to this reflected angle."""

    def change(instrument):
        goto = instrument.arm.goto

        async def jammed(geometry):
            if geometry.theta_out == theta_out:
                raise DeviceTimeout(message)
            return await goto(geometry)

        instrument.arm.goto = jammed

    return change


def test_a_point_that_always_fails_is_given_up_with_its_reason_and_the_rest_is_measured(store):
    asyncio.run(run(store, change=jammed_at(30.0)))
    scan = store.scans()[1]
    failed = [p for p in store.points(scan.id) if p.status == "failed"]
    assert [(p.geometry.theta_out, p.attempts) for p in failed] == [(30.0, 3)]
    assert "did not arrive" in failed[0].reason
    assert scan.outcome == "completed"
    assert len(store.points(scan.id)) > 10


def test_a_fault_of_making_safe_does_not_cost_the_other_attempts_nor_hide_why_the_point_failed(store):
    def change(instrument):
        jammed_at(30.0)(instrument)

        async def unsafe():
            raise DeviceTimeout("QE Pro: the shutter did not answer.")

        goto, safe = instrument.arm.goto, instrument.safe

        async def jammed(geometry):
            instrument.safe = unsafe if geometry.theta_out == 30.0 else safe
            return await goto(geometry)

        instrument.arm.goto = jammed

    asyncio.run(run(store, change=change))
    (failed,) = [p for p in store.points(store.scans()[1].id) if p.status == "failed"]
    assert (failed.attempts, "did not arrive" in failed.reason) == (3, True)


def test_a_reference_with_a_hole_is_not_used_but_completed_by_the_next_run(undisturbed, store):
    with pytest.raises(ReferenceIncomplete, match=r"1 of the \d+ points .* theta_out = 35 deg .*did not arrive"):
        asyncio.run(run(store, change=jammed_at(35.0)))
    reference, sample = store.scans()
    assert (reference.outcome, sample.phase) == ("failed", "idle")
    assert reference.reason.startswith("1 of the ")
    assert [(p.geometry.theta_out, p.attempts) for p in store.points(reference.id) if p.status == "failed"] == [
        (35.0, 3)
    ]
    asyncio.run(run(store))
    assert [s.outcome for s in store.scans()] == ["completed", "completed"]
    again = [p for p in store.points(reference.id) if p.geometry.theta_out == 35.0]
    assert [(p.status, p.attempts, p.reason) for p in again] == [("done", 4, "")]
    planned = [p.geometry for p in store.points(reference.id)]
    assert planned == [p.geometry for p in undisturbed[0].points(undisturbed[0].scans()[0].id)]


def test_a_silent_device_does_not_eat_up_the_whole_plan(store):
    silent = DeviceTimeout("QE Pro: no answer within 1 s.")
    with pytest.raises(DeviceTimeout):
        asyncio.run(run(store, change=failing(silent, set(range(12, 10**4)))))
    points = store.points(store.scans()[0].id)
    assert sum(p.status == "failed" for p in points) == 3
    assert any(p.status == "pending" for p in points)


def test_a_plan_that_the_stages_cannot_take_is_refused_before_anything_moves_or_is_written(store):
    def change(instrument):
        instrument.arm.stages[1].limits = (-90.0, 70.0)
        instrument.arm.goto = None

    with pytest.raises(GeometryError, match=r"theta_out = 40 to 85 deg .* outside -90 to 70 deg.* is 0?-25 to 40 deg"):
        asyncio.run(run(store, change=change))
    assert store.campaigns() == {}


def test_other_devices_halfway_through_a_scan_are_refused(store):
    def small_gain(instrument):
        constants = instrument.constants

        async def other():
            return replace(await constants(), bench=BenchData(gain=1.0))

        instrument.constants = other

    with pytest.raises(DeviceDisconnected):
        asyncio.run(run(store, change=failing(DeviceDisconnected("gone"), set(range(8, 10**4)))))
    with pytest.raises(StoreError, match="another bench"):
        asyncio.run(run(store, change=small_gain))


def _run_and_die(database, point, place):
    """Run the campaign and kill this process at the `point`-th point measured, at one of several places."""
    store, done = Store.open(database), iter(range(1, 10**6))

    def die():
        os.kill(os.getpid(), signal.SIGKILL)

    def change(instrument):
        name = {"expose": "expose", "dark": "dark", "commit": None, "plan": None}[place]
        if name is None:
            return
        original, count = getattr(instrument, name), iter(range(1, 10**6))

        async def deadly(integration_time):
            spectrum = await original(integration_time)
            if next(count) >= (point if name == "expose" else 6):
                die()
            return spectrum

        setattr(instrument, name, deadly)

    if place == "commit":
        finish = store.finish_point

        def finish_and_die(*arguments):
            finish(*arguments)
            if next(done) >= point:
                die()

        store.finish_point = finish_and_die
    if place == "plan":
        add = store.add_points

        def add_and_die(scan_id, geometries):
            add(scan_id, geometries)
            die()

        store.add_points = add_and_die
    asyncio.run(run(store, change=change))


if __name__ == "__main__":
    _run_and_die(sys.argv[1], int(sys.argv[2]), sys.argv[3])
