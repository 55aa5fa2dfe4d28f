"""What is shown of a point while its scan goes on is judged by what the complete scan makes of it."""

import asyncio

import numpy as np
import pytest

from goniometer.campaigns.campaign import Campaign, Monitor, OutgoingRange, Resolution, Sample
from goniometer.errors import CalibrationError
from goniometer.radiometry.calibration import calibrate_scan
from goniometer.radiometry.provisional import newest_brdf
from goniometer.storage.store import Store
from simulators.bench.imperfections import Imperfections
from tests.campaign_bench import NOMINAL_PANEL, run

CAMPAIGN = Campaign(
    name="Test",
    seed=3,
    samples=(Sample(name="First", material="sample-2"), Sample(name="Second", material="sample-1")),
    incident=(30.0,),
    outgoing=OutgoingRange(start=-20, stop=70),
    resolution=Resolution(mode="uniform", step=15),
    reference=NOMINAL_PANEL.model_copy(update={"step": 30.0}),
    monitor=Monitor(every=120.0),
)


@pytest.fixture(scope="module")
def watched(tmp_path_factory):
    """A campaign with a drifting lamp, and what was shown of the second sample, by the points' ids."""
    store = Store.open(tmp_path_factory.mktemp("watched") / "bench.db")
    shown, told = {}, []

    def look(progress):
        if progress.done and progress.kind == "sample" and progress.phase == "running" and progress.sample == "Second":
            seen = newest_brdf(store, progress.scan_id)
            shown[seen.point.id] = seen
        elif progress.kind == "reference":
            told.append(progress.scan_id)

    asyncio.run(run(store, CAMPAIGN, report=look, imperfections=Imperfections(lamp_drift=0.01)))
    yield store, shown, told[0]
    store.close()


def test_the_newest_point_is_shown_as_the_complete_scan_will_have_it_within_what_its_band_says(watched):
    store, shown, _ = watched
    scan = next(scan for scan in store.scans() if scan.sample == "Second")
    final = calibrate_scan(store, scan.id)
    done = [point.id for point in store.points(scan.id) if point.status == "done"]
    assert len(shown) > 0.9 * len(done)
    away = []
    for point_id, seen in shown.items():
        there = done.index(point_id)
        assert seen.dataset.theta_out[0] == final.theta_out[there]
        np.testing.assert_allclose(seen.dataset.wavelengths, final.wavelengths, atol=0.01)
        away.append((seen.dataset.brdf[0] - final.brdf[there]) / seen.dataset.u[0])
    print(f"largest change of a value by what came after it: {np.abs(away).max():.2f} of its standard uncertainty")
    assert np.abs(away).max() < 2
    # the lamp is looked at after them, so that those before the last look changed at all
    assert np.abs(away).max() > 0


def test_of_a_complete_scan_the_last_point_is_what_the_dataset_has_with_every_part_of_its_uncertainty(watched):
    store, _, _ = watched
    scan = next(scan for scan in store.scans() if scan.sample == "Second")
    final, seen = calibrate_scan(store, scan.id), newest_brdf(store, scan.id)
    assert (seen.dataset.theta_in[0], seen.dataset.theta_out[0]) == (final.theta_in[-1], final.theta_out[-1])
    np.testing.assert_allclose(seen.dataset.brdf[0], final.brdf[-1], rtol=1e-12)
    np.testing.assert_allclose(seen.dataset.u[0], final.u[-1], rtol=1e-4)
    assert {s.part for s in seen.dataset.sources} == {s.part for s in final.sources}


def test_where_there_is_no_brdf_yet_the_reason_is_told(watched, tmp_path):
    store, _, reference = watched
    with pytest.raises(CalibrationError, match="reference panel"):
        newest_brdf(store, reference)
    fresh = Store.open(tmp_path / "fresh.db")
    campaign = CAMPAIGN.model_copy(update={"name": "Fresh"})
    scans = fresh.scans(fresh.add_campaign(campaign))
    with pytest.raises(CalibrationError, match="no measured point yet"):
        newest_brdf(fresh, scans[1].id)
    fresh.close()
