"""What a lab with many measurements relies on: lists in pages, and nothing that is computed while somebody waits."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from api.commands.main import app
from api.datasets import find_datasets
from goniometer.campaigns.campaign import Campaign, Sample
from goniometer.errors import NotInStore
from goniometer.storage.store import Store
from tests.drawn_dataset import drawn_dataset
from tests.served import served, wait_for


def invoke(*arguments: object) -> Result:
    """What a command says that does what it shall."""
    result = CliRunner().invoke(app, [str(argument) for argument in arguments], catch_exceptions=False)
    assert result.exit_code == 0
    return result


def test_samples_come_in_pages_and_what_is_new_is_filled_before_anybody_opens_it(tmp_path: Path) -> None:
    with served(tmp_path) as service:
        drawn = drawn_dataset("sample-4").at_points(np.arange(20))
        numbers = [service.live.store.add_dataset(None, replace(drawn, sample=name)) for name in ("b", "a", "c", "a")]
        first = service.client.get("/api/samples?limit=2").json()
        told = [(row["name"], row["datasets"], row["newest"]["id"]) for row in first["items"]]
        assert told == [("a", 2, numbers[3]), ("b", 1, numbers[0])]
        rest = service.client.get(f"/api/samples?limit=2&after={first['next']}").json()
        assert ([row["name"] for row in rest["items"]], rest["next"]) == (["c"], None)
        assert service.client.get("/api/samples/A").json()["datasets"] == 2
        hashes = {service.live.store.entry(number).content_hash[:32] for number in numbers}
        cache = service.live.output / "cache"
        wait_for(lambda: {file.name[7:39] for file in cache.glob("filled-*.npz")} == hashes)


def test_status_shows_the_newest_campaigns_and_says_how_many_it_leaves_out(tmp_path: Path) -> None:
    store = Store.open(tmp_path / "bench.db")
    for i in range(22):
        store.add_campaign(Campaign(name=f"C{i:02d}", samples=(Sample(name="S", material="sample-1"),)))
    store.set_phase(store.scans(1)[0].id, "running")
    told = invoke("status", "-d", tmp_path / "bench.db").stdout
    assert told.startswith("Older campaigns, shown with --last: 1\n")
    assert "C00: reference panel: interrupted" in told
    assert "C01" not in told
    everything = json.loads(invoke("status", "-d", tmp_path / "bench.db", "--last", 22, "--json").stdout)
    assert (len(everything["campaigns"]), len(everything["scans"])) == (22, 44)
    assert everything["left_out"] == {"campaigns": 0, "datasets": 0}


def test_a_name_that_no_dataset_has_is_answered_with_the_newest_only(tmp_path: Path) -> None:
    store = Store.open(tmp_path / "bench.db")
    drawn = drawn_dataset("sample-1").at_points(np.arange(3))
    for i in range(52):
        store.add_dataset(None, replace(drawn, sample=f"S{i}"))
    with pytest.raises(NotInStore, match=r'older ones, 3 \("S2"\), .* 52 \("S51"\)'):
        find_datasets(store, "nothing")
    assert find_datasets(store, "s51") == find_datasets(store, "52") == [52]


def test_raw_counts_are_archived_and_brought_back_by_commands(
    small: tuple[Path, dict[str, Any]], tmp_path: Path
) -> None:
    file, folder = small[0] / "goniometer.db", tmp_path / "archive"
    folder.mkdir()
    store = Store.open(file)
    scans = [scan.id for scan in store.scans()]
    before = {scan: [exposure.counts.tolist() for exposure in store.exposures(scan)] for scan in scans}
    dataset = max(store.datasets())
    told = json.loads(invoke("db", "archive", "--before", "2100-01-01", "--to", folder, "-d", file, "--json").stdout)
    assert told["freed"] == sum(4 * len(counts) for those in before.values() for counts in those)
    assert len(list(folder.iterdir())) == len(scans)
    assert {scan: [exposure.counts.tolist() for exposure in store.exposures(scan)] for scan in scans} == before
    again = json.loads(invoke("calibrate", dataset, "-d", file, "--json").stdout)
    assert store.dataset(again["dataset"]).brdf.tobytes() == store.dataset(dataset).brdf.tobytes()
    assert "is whole" in invoke("db", "check", file).stdout
    assert "in the database again" in invoke("db", "unarchive", "--scan", 1, "-d", file).stdout
