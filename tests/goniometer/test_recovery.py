"""Campaigns on a bench that misbehaves at night: what comes back is used again, what does not ends the scan."""

import asyncio
import logging
from contextlib import asynccontextmanager

import pytest

from drivers.errors import DeviceTimeout, DriverError
from drivers.oriental_az import OrientalAZ
from drivers.qepro import QEPro, QEProLight
from drivers.smc100 import SMC100
from goniometer.bench.instrument import RECOVERY_PAUSES, Instrument
from goniometer.campaigns.campaign import Campaign, Resolution, Sample
from goniometer.errors import RunAborted
from goniometer.scans.scheduler import run_campaign
from goniometer.storage.store import Store
from simulators.bench.laboratory import simulated_laboratory
from simulators.devices.clock import SimulatedClock
from simulators.devices.faults import FaultScript
from tests.stage_bench import PATIENCE, give_time

CAMPAIGN = Campaign(
    name="Night",
    seed=3,
    samples=(Sample(name="Rough", material="sample-1"),),
    incident=(30.0,),
    resolution=Resolution(mode="uniform", step=40.0),
)
TIMEOUT = 0.1
"""Real seconds that a driver waits for a reply."""


class PatientClock(SimulatedClock):
    """Simulated time whose pauses of a recovery also take a little real time, as unplugging does."""

    async def sleep(self, seconds):
        if seconds in RECOVERY_PAUSES:
            await asyncio.sleep(seconds / 50)
        await super().sleep(seconds)


@pytest.fixture(autouse=True)
def patience(monkeypatch):
    monkeypatch.setattr("simulators.bench.laboratory.SimulatedClock", PatientClock)


@pytest.fixture
def store(tmp_path):
    opened = Store.open(tmp_path / "bench.db")
    yield opened
    opened.close()


@asynccontextmanager
async def bench():
    """A laboratory and the instrument in it, open."""
    with simulated_laboratory(CAMPAIGN.seed) as laboratory:
        clock = laboratory.clock
        spectrometer = QEPro("QE Pro", clock, usb_backend=laboratory.usb_backend, timeout=TIMEOUT)
        instrument = Instrument(
            SMC100("sample stage", laboratory.sample_stage_url, clock, timeout=TIMEOUT),
            OrientalAZ("detector stage", laboratory.detector_stage_url, clock, timeout=TIMEOUT),
            spectrometer,
            QEProLight(spectrometer),
            clock,
            data=laboratory.data,
        )
        give_time(PATIENCE, *instrument.arm.stages)  # nothing befalls what is being opened
        await instrument.open()
        give_time(TIMEOUT, *instrument.arm.stages)
        try:
            yield laboratory, instrument
        finally:
            await instrument.close()


def run(store, disturb=lambda laboratory, instrument, progress: None, prepare=lambda laboratory, instrument: None):
    """Run the campaign; `disturb` is called with every progress, `prepare` before."""

    async def work():
        async with bench() as (laboratory, instrument):
            prepare(laboratory, instrument)

            async def mount(scan):
                laboratory.bench.mount(scan.material)

            def report(progress):
                disturb(laboratory, instrument, progress)

            with store.exclusive():
                await run_campaign(store, CAMPAIGN, instrument, mount, report, lambda _: None)

    asyncio.run(work())


def once_at(done, blow):
    """A disturbance that strikes once, when so many points of the sample are done and the next one begins."""
    struck = []

    def disturb(laboratory, instrument, progress):
        if progress.kind == "sample" and progress.done == done and progress.phase == "running" and not struck:
            struck.append(True)
            blow(laboratory, instrument)

    return disturb


def check_whole(store):
    """Every point was measured where it was planned."""
    for scan in store.scans():
        assert (scan.phase, scan.outcome) == ("finished", "completed")
        points = store.points(scan.id)
        assert len(points) >= 4
        for point in points:
            assert point.status == "done"
            assert point.read_back.theta_in == pytest.approx(point.geometry.theta_in, abs=0.1)
            assert point.read_back.theta_out == pytest.approx(point.geometry.theta_out, abs=0.1)


def attempts(store):
    """Attempts of all points."""
    return [p.attempts for s in store.scans() for p in store.points(s.id)]


def unplug_for_a_moment(device, seconds=0.05):
    """A blow: the cable of this device of the laboratory is out for `seconds` of real time."""

    def blow(laboratory, _):
        getattr(laboratory, device).script = FaultScript.parse(f"at 3 unplug {seconds} s")

    return blow


BLOWS = {
    "sample stage unplugged": unplug_for_a_moment("sample_stage"),
    "detector stage unplugged": unplug_for_a_moment("detector_stage"),
    "spectrometer unplugged": unplug_for_a_moment("spectrometer"),
    "sample stage restarted": lambda laboratory, _: laboratory.sample_stage.restart(),
    "detector stage restarted": lambda laboratory, _: laboratory.detector_stage.restart(),
    "spectrometer restarted": lambda laboratory, _: laboratory.spectrometer.restart(),
    "sample stage jammed": lambda laboratory, _: laboratory.sample_stage.jam(),
    "detector stage jammed": lambda laboratory, _: laboratory.detector_stage.jam(),
}


@pytest.mark.parametrize("what", BLOWS)
def test_a_device_that_fails_in_the_night_and_comes_back_costs_attempts_and_no_point(store, what, caplog):
    with caplog.at_level(logging.WARNING):
        run(store, once_at(4, BLOWS[what]))
    check_whole(store)
    if max(attempts(store)) > 1:  # an absolute encoder forgets nothing when it is restarted
        told = [r.getMessage() for r in caplog.records if r.name == "goniometer.scans.scheduler"]
        assert any("theta_in = 30, theta_out = " in text and "attempt 1 of 3: " in text for text in told)
    else:
        assert what == "detector stage restarted"


@pytest.mark.parametrize(
    ("device", "blow"),
    [
        ("sample_stage", "unplug"),
        ("detector_stage", "unplug"),
        ("spectrometer", "unplug"),
        ("spectrometer", "jam"),  # it says "hardware exception" until a person switches it off and on
    ],
)
def test_a_device_that_does_not_come_back_ends_the_scan_in_its_own_words_and_the_next_run_goes_on(store, device, blow):
    with pytest.raises(DriverError) as raised:
        run(store, once_at(4, lambda laboratory, _: getattr(getattr(laboratory, device), blow)()))
    scan = store.scans()[1]
    assert (scan.phase, scan.outcome, scan.reason) == ("finished", "failed", str(raised.value))
    assert scan.reason.startswith({"spectrometer": "QE Pro"}.get(device, device.replace("_", " ")))
    points = store.points(scan.id)
    assert sum(p.status == "done" for p in points) == 4
    assert not any(p.status in {"running", "failed"} for p in points)
    run(store)
    check_whole(store)


def test_a_bad_line_costs_no_point_and_no_stage_is_believed_to_be_where_it_is_not(store):
    def prepare(laboratory, _):
        laboratory.sample_stage.script = FaultScript.parse(
            "every 41 lose-reply\nfrom 7 every 53 duplicate\nfrom 11 every 47 foreign\nfrom 5 every 13 split", seed=1
        )
        laboratory.detector_stage.script = FaultScript.parse("every 61 lose-reply\nfrom 9 every 59 duplicate", seed=2)

    run(store, prepare=prepare)
    check_whole(store)


def test_after_every_fault_the_bench_is_made_safe_before_anything_else(store):
    calls = []

    def prepare(_, instrument):
        def noted(name, method):
            async def call(*arguments):
                calls.append(name)
                return await method(*arguments)

            return call

        expose, count = instrument.expose, iter(range(10**6))

        async def flaky(integration_time):
            if next(count) == 5:
                calls.append("fault")
                raise DeviceTimeout("QE Pro: no answer within 1 s.")
            return await expose(integration_time)

        instrument.expose = flaky
        for owner, name in ((instrument, "safe"), (instrument, "recover"), (instrument.arm, "goto")):
            setattr(owner, name, noted(name, getattr(owner, name)))

    run(store, prepare=prepare)
    at = calls.index("fault")
    assert calls[at : at + 4] == ["fault", "safe", "recover", "goto"]
    check_whole(store)


def test_an_abort_is_obeyed_while_the_bench_is_being_recovered(store, tmp_path):
    other = Store.open(tmp_path / "bench.db")
    waiting = []

    def prepare(laboratory, instrument):
        async def endless():
            other.request(store.scans()[1].id, "abort")
            waiting.append(True)
            await asyncio.sleep(3600.0)

        instrument.recover = endless

    with pytest.raises(RunAborted):
        run(store, once_at(2, lambda laboratory, _: laboratory.sample_stage.restart()), prepare)
    assert waiting == [True]
    assert store.scans()[1].outcome == "aborted"
    other.close()


def test_an_abort_stops_the_bench_before_it_waits_for_a_device_that_is_slow_to_let_go(store, tmp_path):
    other = Store.open(tmp_path / "bench.db")
    order = []

    def prepare(_, instrument):
        safe = instrument.safe

        async def noted():
            order.append("safe")
            await safe()

        async def stubborn(_):
            other.request(store.scans()[0].id, "abort")
            try:
                await asyncio.sleep(3600.0)
            finally:
                await asyncio.sleep(0.3)
                order.append("let go")

        instrument.safe, instrument.expose = noted, stubborn

    with pytest.raises(RunAborted):
        run(store, prepare=prepare)
    assert order[:2] == ["safe", "let go"]
    other.close()


def test_a_fault_while_pausing_does_not_end_the_scan(store, tmp_path, caplog):
    other = Store.open(tmp_path / "bench.db")
    phases = []

    def disturb(laboratory, _, progress):
        phases.append(progress.phase)
        if progress.kind == "sample" and progress.phase == "running" and progress.done == 3 and "paused" not in phases:
            other.request(progress.scan_id, "pause")
            laboratory.sample_stage.unplug()
            laboratory.sample_stage.start()
        elif progress.phase == "paused":
            other.request(progress.scan_id, "resume")

    run(store, disturb)
    assert "paused" in phases
    assert "reopening it" in caplog.text
    check_whole(store)
    other.close()
