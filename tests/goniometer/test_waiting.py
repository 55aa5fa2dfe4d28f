"""What a scan waits for before it measures, on the wire-level simulators; time is that of the bench."""

import asyncio
from itertools import pairwise

import numpy as np
import pytest

from drivers.clock import WallClock
from goniometer.campaigns.campaign import Campaign, Integration, Monitor, Reference, Resolution, Sample
from goniometer.campaigns.conditions import Conditions
from goniometer.errors import ConditionsUnmet, RunAborted
from goniometer.radiometry.drift import lamp_drift
from goniometer.radiometry.raw import read_raw
from goniometer.scans.scheduler import run_campaign
from goniometer.storage.store import Store
from simulators.bench.imperfections import DRIFT_PERIOD, IDEAL, WARM_UP_TIME, Imperfections
from tests.campaign_bench import NOMINAL_PANEL, bench

CAMPAIGN = Campaign(
    name="Test",
    seed=3,
    samples=(Sample(name="Rough", material="sample-1"),),
    incident=(30.0,),
    resolution=Resolution(mode="uniform", step=45.0),
    integration=Integration(maximum=8.0),
    reference=Reference(override=NOMINAL_PANEL.override, step=45.0),
    stray_light=False,
    monitor=None,
)
COLD = 0.05
"""Part of its output that a lamp lacks when it is switched on."""


@pytest.fixture
def store(tmp_path):
    opened = Store.open(tmp_path / "bench.db")
    yield opened
    opened.close()


def changed(**changes):
    return CAMPAIGN.model_copy(update=changes)


def waiting_sample(wait):
    return changed(samples=(Sample(name="Rough", material="sample-1", wait=wait),))


def run(store, campaign, report=lambda _: None, prepare=lambda *_: None, imperfections=IDEAL):
    """Run a campaign and return the time that it took on the bench, seconds; `prepare` may tamper with the bench."""

    async def work():
        async with bench(campaign.seed, imperfections) as (instrument, mount, laboratory):
            prepare(instrument, laboratory)
            began = laboratory.clock.now()
            try:
                with store.exclusive():
                    await run_campaign(store, campaign, instrument, mount, report, lambda _: None)
            finally:
                times.append(laboratory.clock.now() - began)

    times = []
    asyncio.run(work())
    return times[0]


def test_a_sample_rests_for_the_time_it_asks_for_and_nothing_else_waits(store, tmp_path):
    reports, plain_reports = [], []
    waited = run(store, waiting_sample("20 min"), reports.append)
    plain = Store.open(tmp_path / "plain.db")
    at_once = run(plain, CAMPAIGN, plain_reports.append)
    plain.close()
    assert not any(r.waiting for r in plain_reports)
    assert waited - at_once == pytest.approx(1200.0, abs=1.0)
    waits = [r for r in reports if r.waiting]
    assert {(r.kind, r.waiting.what) for r in waits} == {("sample", "as the campaign asks")}
    assert waits[0].waiting.left == pytest.approx(1200.0)
    assert all(a.waiting.left > b.waiting.left for a, b in pairwise(waits))


def test_a_scan_that_had_begun_does_not_wait_again(store):
    campaign = waiting_sample("20 min")
    reports = []

    def stop(report):
        reports.append(report)
        if report.kind == "sample" and report.done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(store, campaign, stop)
    assert any(r.waiting for r in reports)
    reports.clear()
    run(store, campaign, reports.append)
    assert not any(r.waiting for r in reports)
    assert [s.outcome for s in store.scans()] == ["completed", "completed"]


def test_an_abort_ends_a_wait_at_once_and_status_tells_meanwhile_what_is_waited_for(store, tmp_path):
    other = Store.open(tmp_path / "bench.db")
    told = []

    def abort(report):
        if report.waiting and not told:
            told.append(other.scans()[1].reason)
            other.request(report.scan_id, "abort")

    def real_time(instrument, _):
        instrument.clock = WallClock()  # on which a test could not wait for an hour

    with pytest.raises(RunAborted):
        run(store, waiting_sample("1 h"), abort, real_time)
    assert told == ["It waits: as the campaign asks."]
    assert (store.scans()[1].outcome, store.points(store.scans()[1].id)) == ("aborted", [])
    other.close()


@pytest.mark.parametrize(
    ("conditions", "most", "waited_for"),
    [
        (Conditions(), None, set()),
        (Conditions(lamp_warm="20 min"), COLD * np.exp(-1200 / WARM_UP_TIME), {"warming the lamp"}),
        # of what is missing, exp(-60 / 300) is left after a minute: 0.9 % is left when that is a change of 0.2 %
        (Conditions(lamp_change="0.2 %"), 0.002 / (np.exp(60 / WARM_UP_TIME) - 1), {"watching the lamp"}),
    ],
)
def test_a_lamp_that_is_waited_for_drifts_less_in_the_data(store, conditions, most, waited_for):
    reports = []
    campaign = changed(monitor=Monitor(every=30.0), conditions=conditions, incident=(10.0, 30.0))
    run(store, campaign, reports.append, imperfections=Imperfections(lamp_warm_up=COLD))
    drift = lamp_drift(read_raw(store, store.scans()[0].id))
    print(f"the lamp changed by {drift.largest:.2%} in the reference scan; waited for {waited_for or 'nothing'}")
    assert {r.waiting.what.split(",")[0] for r in reports if r.waiting and r.kind == "reference"} == waited_for
    if most is None:
        assert drift.largest > 0.01
    else:
        assert drift.largest < most


def test_a_lamp_that_never_gets_steady_fails_the_scan_in_time_and_says_so(store):
    restless = Imperfections(lamp_drift=0.2, lamp_phase=-45.0)  # a sine, steepest after an eighth of its period
    steepest = 0.2 * 2 * np.pi / DRIFT_PERIOD
    campaign = changed(conditions=Conditions(lamp_change="0.5 %", patience="6 min"))
    times = []

    def prepare(instrument, laboratory):
        times.append(laboratory.clock)

    with pytest.raises(ConditionsUnmet, match=r"patience of 360 s: the signal of the lamp, which changed by") as caught:
        run(store, campaign, prepare=prepare, imperfections=restless)
    assert "\n" not in str(caught.value)
    change = float(str(caught.value).split("changed by ")[1].split(" %")[0])
    assert change == pytest.approx(100 * 60 * steepest, rel=0.2)
    assert times[0].now() < 360.0 + 300.0  # with homing, mounting, and the first look with its darks
    reference = store.scans()[0]
    assert (reference.outcome, reference.reason) == ("failed", str(caught.value))
    assert store.points(reference.id) == []


def test_a_detector_that_does_not_get_cold_fails_the_scan_and_says_how_warm_it_is(store):
    def warm(_, laboratory):
        laboratory.spectrometer.drift()

    with pytest.raises(ConditionsUnmet, match=r"patience of 600 s: .*the detector is at -9\.0 °C"):
        run(store, changed(conditions=Conditions(patience="10 min")), prepare=warm)


def test_more_patience_is_not_another_campaign(store):
    impatient = changed(conditions=Conditions(lamp_warm="20 min", patience="20 min"))
    run(store, impatient)
    patient = impatient.model_copy(update={"conditions": Conditions(patience="2 h")})
    assert store.add_campaign(patient) == 1
    assert store.campaign(1).conditions.patience == 7200.0


def test_conditions_are_looked_at_again_after_a_pause(store, tmp_path):
    other = Store.open(tmp_path / "bench.db")
    spoilt = []

    def prepare(_, laboratory):
        spoilt.append(laboratory)

    def disturb(report):
        if report.done == 2 and report.phase == "running" and len(spoilt) == 1:
            spoilt.append("asked")
            other.request(report.scan_id, "pause")
        if report.phase == "paused":
            spoilt[0].spectrometer.drift()
            spoilt[0].clock.advance_to(spoilt[0].clock.now() + 100.0)
            other.request(report.scan_id, "resume")

    with pytest.raises(ConditionsUnmet, match="the detector is at"):
        run(store, changed(conditions=Conditions(patience="1 min")), disturb, prepare)
    assert sum(p.status == "done" for p in store.points(store.scans()[0].id)) == 2
    other.close()


def test_a_lamp_is_believed_to_be_cold_unless_it_was_switched_on_here_or_an_operator_says_otherwise():
    async def work():
        async with bench(1) as (instrument, _, laboratory):
            assert instrument.lamp_on_for < 120.0  # while the stages were homed
            laboratory.clock.advance_to(laboratory.clock.now() + 1000.0)
            assert 1000.0 <= instrument.lamp_on_for < 1120.0
            await instrument.recover()  # did it burn meanwhile?
            assert instrument.lamp_on_for < 10.0
            instrument.trust_lamp()
            assert instrument.lamp_on_for == np.inf

    asyncio.run(work())
