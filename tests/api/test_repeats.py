"""A sample that is measured again: what an operator does, gets and sees."""

import asyncio
import io
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from api.datasets import campaign_datasets, find_datasets
from api.display import progress_display
from api.preview import preview
from api.results.outcome import outcomes
from api.service import QUIET, open_bench, run
from api.written import make_folder, slug, write_text
from goniometer.campaigns.campaign import Campaign, Integration, OutgoingRange, Reference, Resolution, Sample
from goniometer.campaigns.conditions import Conditions
from goniometer.certificates.certificate_file import certificate_csv
from goniometer.errors import CampaignError
from goniometer.scans.estimate import NOTHING
from goniometer.scans.progress import Progress, Waiting
from goniometer.scans.scheduler import Report, run_campaign
from goniometer.storage.records import Scan
from goniometer.storage.store import Store
from simulators.materials.materials import PANEL_CERTIFICATE

CAMPAIGN = Campaign(
    name="Repeats",
    seed=3,
    samples=(Sample(name="Rough", material="sample-1", repeats=3), Sample(name="Other", material="sample-4")),
    incident=(20.0, 60.0),
    outgoing=OutgoingRange(start=0.0, stop=80.0),
    resolution=Resolution(mode="uniform", step=20.0),
    integration=Integration(maximum=8.0),
    reference=Reference(step=40.0),
    stray_light=False,
    monitor=None,
)


def light(store: Store) -> dict[str, list[bytes]]:
    """Spectra of every scan, in which nothing may differ after an interruption."""
    return {s.name: [e.counts.tobytes() for e in store.exposures(s.id) if e.kind == "light"] for s in store.scans()}


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """The campaign, run from end to end."""
    folder = tmp_path_factory.mktemp("repeats")
    store = Store.open(folder / "bench.db")
    result = asyncio.run(run(store, CAMPAIGN, folder))
    assert result.failures == ()
    yield store, folder
    store.close()


def test_each_repeat_has_its_own_dataset_fits_and_report(measured: tuple[Store, Path]) -> None:
    store, folder = measured
    names = ["Rough #1", "Rough #2", "Rough #3", "Other"]
    datasets = campaign_datasets(store, 1)
    assert list(datasets) == names
    assert [dataset.sample for dataset in datasets.values()] == names
    assert [outcome.sample for outcome in outcomes(store, 1, truth=True)] == names
    assert sorted(report.parent.name for report in folder.glob("*/report.html")) == [
        "other",
        "rough-1",
        "rough-2",
        "rough-3",
    ]


def test_repeats_differ_as_much_as_random_errors_make_them(measured: tuple[Store, Path]) -> None:
    store, _ = measured
    rough = [dataset for name, dataset in campaign_datasets(store, 1).items() if name.startswith("Rough")]
    spread = np.std([dataset.brdf for dataset in rough], axis=0, ddof=1)
    # the noise of the reference is common to all three, and angles are not exactly the same again
    ratio = np.sqrt(np.mean((spread / rough[0].u_counts) ** 2))
    print(f"spread of three repeats over the noise that is stated of one: {ratio:.2f}")
    assert 0.5 < ratio < 2.0


def test_a_repeat_is_addressed_by_its_number_and_its_sample_means_all(measured: tuple[Store, Path]) -> None:
    store, _ = measured
    assert find_datasets(store, "rough #2") == [2]
    assert find_datasets(store, "Rough") == [1, 2, 3]
    assert find_datasets(store, "Other") == [4]


def test_a_run_that_is_stopped_in_the_middle_of_a_repeat_ends_with_the_same_spectra(
    measured: tuple[Store, Path], tmp_path: Path
) -> None:
    store = Store.open(tmp_path / "bench.db")

    def stop(progress: Progress) -> None:
        if (progress.sample, progress.done) == ("Rough #2", 4):
            raise KeyboardInterrupt

    async def measure(report: Report) -> None:
        async with open_bench(None, CAMPAIGN.seed, QUIET.mount) as (instrument, mount):
            text = certificate_csv(PANEL_CERTIFICATE)
            await run_campaign(store, CAMPAIGN, instrument, mount, report, lambda _: None, text)

    with pytest.raises(KeyboardInterrupt):
        asyncio.run(measure(stop))
    assert [s.outcome for s in store.scans()] == ["completed", "completed", "aborted", None, None]
    asyncio.run(measure(QUIET.report))
    assert light(store) == light(measured[0])
    store.close()


def test_nobody_is_asked_to_mount_what_lies_on_the_bench(
    monkeypatch: pytest.MonkeyPatch, measured: tuple[Store, Path]
) -> None:
    asked: list[str] = []

    async def ask(scan: Scan) -> None:
        asked.append(scan.name)

    @asynccontextmanager
    async def real(*_: object) -> Any:
        yield None, None  # an instrument of which nothing is asked, and no laboratory

    monkeypatch.setattr("api.service.open_instrument", real)

    async def work() -> None:
        async with open_bench(None, 1, ask) as (_, mount):
            for scan in measured[0].scans():
                await mount(scan)

    asyncio.run(work())
    assert asked == ["reference", "Rough #1", "Other"]


def test_two_scans_do_not_share_a_folder(tmp_path: Path) -> None:
    samples = (*CAMPAIGN.samples, Sample(name="rough-2", material="sample-1"))
    store = Store.open(tmp_path / "bench.db")
    with pytest.raises(CampaignError, match='"Rough #2" and "rough-2" would both'):
        asyncio.run(run(store, CAMPAIGN.model_copy(update={"samples": samples}), tmp_path))
    store.close()


def test_a_long_name_makes_a_folder_and_two_that_begin_alike_do_not_share_it(tmp_path: Path) -> None:
    long = "Ж" * 196
    names = [f"{long} #1", f"{long} #2", "ab " * 66, "名" * 200, f"{'a' * 79}-б"]
    for name in names:
        make_folder(tmp_path / slug(name))
        write_text("report", tmp_path / slug(name) / f"{slug(name)}.html", "text")
        assert len(slug(name).encode()) <= 80
        assert not slug(name).endswith("-")
    assert len(list(tmp_path.iterdir())) == len(names)
    assert slug("Ж" * 40) == "ж" * 40
    assert slug("Ж" * 41) == "ж" * 40
    samples = tuple(Sample(name=long + end, material="sample-1") for end in ("a", "b"))
    store = Store.open(tmp_path / "bench.db")
    with pytest.raises(CampaignError, match="would both be kept"):
        asyncio.run(run(store, CAMPAIGN.model_copy(update={"samples": samples}), tmp_path))
    store.close()


def test_the_preview_counts_repeats_waits_and_conditions() -> None:
    plain = preview(CAMPAIGN)
    waiting = (CAMPAIGN.samples[0].model_copy(update={"wait": 600.0}), CAMPAIGN.samples[1])
    conditions = Conditions(lamp_warm=1200.0, lamp_change=0.002, lamp_change_within=60.0)
    careful = preview(CAMPAIGN.model_copy(update={"samples": waiting, "conditions": conditions}))
    assert [leg.name for leg in careful.legs] == ["reference panel", "Rough #1", "Rough #2", "Rough #3", "Other"]
    assert [leg.waiting for leg in careful.legs] == [1260.0, 660.0, 660.0, 660.0, 60.0]
    for leg, before in zip(careful.legs, plain.legs, strict=True):
        assert leg.time.seconds == pytest.approx(before.time.seconds + leg.waiting)
    told = "\n".join(careful.lines())
    assert "11 min 00 s of it waiting" in told
    assert "the lamp has been on for 20 min 00 s" in told
    assert "by less than 0.2 % in 1 min 00 s" in told


def test_the_preview_of_an_even_grid_says_what_budgets_cut_off_and_speaks_of_no_refinement() -> None:
    narrow = {"name": "Narrow", "samples": [{"name": "A", "material": "mirror"}], "incident": [30, 50]}
    resolution = {"mode": "uniform", "step": 10, "points": 7, "time": "5 min"}
    wanted = Campaign.model_validate(narrow | {"outgoing": {"start": -40, "stop": 40}, "resolution": resolution})
    told = "\n".join(preview(wanted).lines())
    assert "A sample gets the first 7 of the 17 points of the grid" in told
    assert "A sample ends after 5 min 00 s" in told
    assert "refined" not in told
    forward = Campaign.model_validate(narrow | {"outgoing": {"start": 10, "stop": 40}})
    told = "\n".join(preview(forward).lines())
    assert "refined" in told
    assert "Left out" not in told


def test_an_operator_sees_what_a_run_waits_for() -> None:
    lines = io.StringIO()
    console = Console(file=lines, width=200)
    with progress_display(console) as (show, _):
        for left in (600.0, 590.0):
            waiting = Waiting("as the campaign asks", left)
            show(Progress(2, "Rough #1", "sample", "running", None, 0, 0, 20, 0.0, NOTHING, 0.0, None, None, waiting))
    assert lines.getvalue() == (
        "Rough #1: 0 of about 20 points, 0 %, waiting: as the campaign asks, 10 min 00 s left on the bench\n"
    )


def test_status_names_each_repeat(cli: Any, measured: tuple[Store, Path]) -> None:
    told = cli("status", "--database", "bench.db", cwd=measured[1]).stdout
    assert [line.split(":")[1].strip() for line in told.splitlines() if line.startswith("Repeats")] == [
        *("reference panel", "Rough #1", "Rough #2", "Rough #3", "Other")
    ]
