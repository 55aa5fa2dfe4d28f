"""What the pages tell of the bench over time is what was read from it."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from api.bench.queue import add_entry, begun
from api.views.history import history
from drivers.arrays import FloatArray
from goniometer.storage.catalogue import Wanted
from goniometer.storage.store import Store

Small = tuple[Path, dict[str, Any]]

AGAIN = """
name: Again
seed: 8
samples:
  - {name: Sample 1, material: sample-1}
incident: [20, 60]
outgoing: {start: -30, stop: 60}
resolution: {mode: uniform, step: 30}
stray_light: false
"""


def _rates(store: Store, scan_id: int) -> dict[tuple[int, int], FloatArray]:
    """Counts per second without the dark ones, by direction as planned, of a scan; plainly."""
    exposures = store.exposures(scan_id)
    points = {p.id: p for p in store.points(scan_id)}
    found: dict[tuple[int, int], list[FloatArray]] = {}
    for each in exposures:
        if each.kind == "light" and each.point_id is not None:
            same = [e.counts for e in exposures if e.kind == "dark" and e.integration_time == each.integration_time]
            place = points[each.point_id].geometry
            rate = (each.counts - np.mean(same, axis=0)) / each.integration_time
            found.setdefault((round(place.theta_in), round(place.theta_out)), []).append(rate)
    return {place: np.mean(rates, axis=0) for place, rates in found.items()}


@pytest.mark.slow
def test_the_response_to_the_panel_is_the_ratio_of_what_two_scans_of_it_have_read(cli: Any, small: Small) -> None:
    folder, _ = small
    (folder / "again.yaml").write_text(AGAIN)
    done = cli("run", "again.yaml", "--json", cwd=folder)
    assert done.returncode == 0, done.stderr
    store = Store.open(folder / "goniometer.db")
    found = history(store, 60)
    assert not found.more
    assert [scan.started for scan in found.scans] == sorted(scan.started for scan in found.scans)
    first, second = (scan for scan in found.scans if scan.kind == "reference")
    assert [band.ratio for band in first.response] == pytest.approx([1, 1, 1])
    before, after = _rates(store, first.scan), _rates(store, second.scan)
    wavelengths = store.constants(first.scan).wavelengths
    for band in second.response:
        pixels = np.abs(wavelengths - band.wavelength_nm) <= 5
        ratios = [after[place][pixels].mean() / before[place][pixels].mean() for place in before.keys() & after.keys()]
        # the detector's non-linearity, which is not corrected here, is of the order of a per cent
        assert band.ratio == pytest.approx(np.mean(ratios), rel=0.01)
        assert band.u is not None
        assert band.u < 0.05
    temperatures = [each.detector_temperature for each in store.exposures(second.scan)]
    assert (second.temperature_low, second.temperature_high) == (min(temperatures), max(temperatures))
    assert second.temperature == pytest.approx(np.mean(temperatures))
    assert second.lamp_change is not None, "its campaign looks at the lamp"
    assert first.lamp_change is None, "that of the other one does not"
    assert len(history(store, 2).scans) == 2
    assert history(store, 2).more
    assert history(Store.open(folder / "goniometer.db", "another"), 60).scans == [], "that bench has measured nothing"


def test_datasets_are_found_by_who_queued_their_campaign_and_by_their_checks(small: Small) -> None:
    folder, _ = small
    store = Store.open(folder / "goniometer.db")
    number = store.scans()[0].campaign_id
    everything = store.entries(Wanted(), 100)
    assert {entry.operator for entry in everything} == {None}, "it was run at the command line"
    entry = add_entry(store, store.campaign(number), "anna")
    begun(store, entry.id, number)
    assert store.entries(Wanted(operator="anna"), 100) == store.entries(Wanted(campaign_id=number), 100)
    assert store.entry(everything[0].id).operator == "anna"
    assert store.entries(Wanted(operator="otto"), 100) == []
    good, bad = (store.entries(Wanted(passed=passed), 100) for passed in (True, False))
    assert {e.id for e in good} | {e.id for e in bad} == {e.id for e in everything}
    assert all(e.checks_failed == 0 for e in good)
    assert all(e.checks_failed > 0 for e in bad)
