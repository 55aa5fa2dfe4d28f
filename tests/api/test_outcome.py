"""What a person is told of a finished campaign."""

from dataclasses import replace
from pathlib import Path
from typing import Any

from api.results.outcome import SampleOutcome, outcomes, remarks
from goniometer.campaigns.campaign import Campaign, Sample
from goniometer.storage.lineage import lacks_dataset, own_datasets
from goniometer.storage.store import Store
from tests.drawn_dataset import drawn_dataset

GOOD = SampleOutcome(
    sample="Disc",
    material="sample-1",
    phase="finished",
    outcome="completed",
    reason="",
    points=100,
    failed_points=0,
    uniform_1_degree_points=400,
    bench_seconds=600.0,
    dataset_id=1,
    checks=[{"name": "energy", "passed": True, "message": "Less comes out than falls in."}],
    flagged_points={},
    left_out_points=0,
    too_noisy="",
    certificate_override="",
    dE00={},
    parameters={},
    trusted={"cook-torrance-shift": True},
    reasons={"cook-torrance-shift": []},
    files=[],
)


def test_a_sound_sample_needs_no_remark_but_what_its_uncertainties_are() -> None:
    assert remarks([GOOD]) == ["Uncertainties in brackets are standard uncertainties, k = 1."]


def test_a_failed_check_an_override_and_points_left_out_are_never_kept_from_the_user() -> None:
    bad = SampleOutcome(
        **vars(GOOD)
        | {
            "checks": [
                {"name": "homogeneity", "passed": False, "message": "Another spot differs by 30 %."},
                {"name": "drift", "passed": None, "message": "Nobody watched the lamp."},
            ],
            "left_out_points": 7,
            "too_noisy": "3 points stayed below the wanted signal-to-noise ratio.",
            "certificate_override": "M. Curie overrode the certificate: the new one is on its way.",
        }
    )
    assert remarks([bad])[1:] == [
        "Disc: M. Curie overrode the certificate: the new one is on its way.",
        "Disc: the check of homogeneity failed. Another spot differs by 30 %.",
        "Disc: 7 flagged points take no part in the fits.",
        "Disc: 3 points stayed below the wanted signal-to-noise ratio.",
    ]


def test_only_files_that_lie_in_the_named_folder_are_listed_there() -> None:
    files = ["/results/disc/report.html", "/results/disc/analysis.json", "/elsewhere/x.json"]
    assert remarks([replace(GOOD, files=files)])[1:] == ["Disc: /results/disc (analysis.json, report.html)"]


def test_what_somebody_tries_afterwards_does_not_take_the_place_of_a_campaigns_result(tmp_path: Path) -> None:
    store = Store.open(tmp_path / "one.db")
    campaign_id = store.add_campaign(Campaign(name="One", samples=(Sample(name="Disc", material="sample-4"),)))
    scan = store.scans(campaign_id)[1]
    store.finish_scan(scan.id, "completed")
    assert lacks_dataset(store, store.scan(scan.id))
    first = store.add_dataset(scan.id, drawn_dataset("sample-4"))
    trial = replace(drawn_dataset("sample-4", seed=1), lineage={"recalibrated_from": first})
    store.add_dataset(scan.id, trial)
    assert list(own_datasets(store, scan.id)) == [first]
    assert not lacks_dataset(store, store.scan(scan.id))
    assert [outcome.dataset_id for outcome in outcomes(store, campaign_id, truth=False)] == [first]
    store.close()


def test_every_sample_of_a_campaign_carries_its_checks_and_flags(small: tuple[Path, dict[str, Any]]) -> None:
    for sample in small[1]["samples"]:
        assert {check["name"] for check in sample["checks"]} >= {"reciprocity", "energy", "drift", "saturation"}
        assert all(check["message"].endswith(".") for check in sample["checks"])
        assert sum(sample["flagged_points"].values()) >= sample["left_out_points"]
        for parameter in sample["parameters"]["cook-torrance-shift"]:
            error, parts = parameter["standard_error"], parameter["standard_error_by_part"]
            if parts:
                assert abs(sum(part**2 for part in parts.values()) / error**2 - 1) < 1e-9
