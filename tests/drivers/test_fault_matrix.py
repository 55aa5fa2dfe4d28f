"""Every fault on every device, alone and in the middle of a campaign: survived or told, never taken for data."""

from pathlib import Path

import pytest

from goniometer.campaigns.campaign import Campaign, Integration, OutgoingRange, Reference, Resolution, Sample
from goniometer.scans.progress import Progress
from goniometer.storage.store import Store
from simulators.bench.laboratory import Laboratory
from simulators.devices.faults import LASTING, Fault, FaultScript, Kind
from tests.benchmarks.fault_matrix import BLIND, moments, requests_of, strike
from tests.benchmarks.nights import LASTS, RTU, chance, run
from tests.benchmarks.rigs import DEVICES
from tests.benchmarks.truth import Truth, lost, wrong

STRIKES = 2
"""Strikes at each cell: one on a single request, one on several in a row."""
SLOW_POINTS = 4
"""Points after which a stage that has become slow is greased: each of them waits in vain for it."""
CAMPAIGN = Campaign(
    name="Night",
    seed=3,
    samples=(Sample(name="Rough", material="sample-1"),),
    incident=(10.0, 40.0),
    outgoing=OutgoingRange(start=-60.0, stop=60.0),
    resolution=Resolution(mode="uniform", step=15.0),
    reference=Reference(step=45.0, scans=1),
    integration=Integration(scans=2),
    monitor=None,
)
BENCHES = {
    "SMC100": (("smc100", "oriental-az"), "sample_stage"),
    "OWIS PS": (("owis", "oriental-az"), "sample_stage"),
    "K10CR1": (("smc100", "k10cr1"), "detector_stage"),
    "AZ on TCP": (("smc100", "oriental-az"), "detector_stage"),
    "AZ on RTU": (("smc100", RTU), "detector_stage"),
    "QE Pro": (("smc100", "oriental-az"), "spectrometer"),
}
"""The families of the sample and the detector stage, and which device of theirs is struck."""

pytestmark = pytest.mark.skipif(not Path("/proc/self/fd").exists(), reason="counts descriptors as Linux shows them")


@pytest.fixture(scope="module")
def requests() -> dict[str, int]:
    return {device: requests_of(device) for device in DEVICES}


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("kind", Kind)
def test_no_fault_is_taken_for_data_hangs_or_leaks_and_the_device_works_again(
    device: str, kind: Kind, requests: dict[str, int]
) -> None:
    happened = 0
    for at, times in moments(device, kind, STRIKES, requests[device]):
        struck = strike(device, kind, at, times=times, seed=at)
        if not struck.happened:  # a busy machine ended the day before
            assert struck.breaches == []
            struck = strike(device, kind, at, times=times, seed=at)
        assert struck.breaches == [], f"{kind} at request {at}, {times} times"
        happened += struck.happened
    assert happened > 1


def test_only_a_stage_without_encoder_may_not_know_that_it_has_lost_steps() -> None:
    assert {("K10CR1", Kind.DRIFT)} == BLIND


@pytest.mark.slow
@pytest.mark.parametrize("device", BENCHES)
@pytest.mark.parametrize("kind", Kind)
def test_every_point_of_a_disturbed_campaign_is_where_and_what_it_should_be(
    device: str, kind: Kind, tmp_path: Path
) -> None:
    stages, role = BENCHES[device]
    draw = chance(device, kind)
    after, at, times = draw.randint(1, 6), draw.randint(1, 15), draw.choice((1, 2, 5))
    if (device, kind) in BLIND:
        at, times = 1, 1  # at rest, where the bench remembers what the stage read; nobody can see it in a motion
    fault = Fault(kind, at, times, seconds=LASTS if kind in LASTING else 0.0)
    script = FaultScript([fault], seed=at)

    def disturb(laboratory: Laboratory, progress: Progress) -> None:
        if progress.kind == "sample" and progress.done == after and not script.requests:
            getattr(laboratory, role).script = script
        if kind is Kind.SLOW and role != "spectrometer" and progress.done >= after + SLOW_POINTS:
            getattr(laboratory, role)._slowness = 1.0

    store = Store.open(tmp_path / "night.db")
    try:
        ended = run(store, CAMPAIGN, stages, disturb)
        assert script.happened
        assert len(ended) <= 1
        truth = Truth(CAMPAIGN.seed)
        for scan in store.scans():
            assert scan.outcome == "completed"
            assert wrong(store, scan, truth) == [], f"{fault} after {after} points"
            # a stage that has become slow is too slow for its longest moves only
            assert kind is Kind.SLOW or lost(store, scan) == []
    finally:
        store.close()
