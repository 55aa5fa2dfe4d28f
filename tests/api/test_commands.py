"""A small campaign through the command line: what it leaves behind, and what can be done with it afterwards."""

import hashlib
import json
import os
import sqlite3
import subprocess
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from analysis.fits.fit_json import fit_from_json
from api.preflight import preflight
from goniometer.campaigns.campaign_file import load_campaign
from goniometer.storage.store import Store
from tests.api.conftest import COMMAND

Small = tuple[Path, dict[str, Any]]


def test_a_run_leaves_fits_a_rendering_file_and_a_report_for_every_sample(small: Small) -> None:
    folder, result = small
    assert [s["sample"] for s in result["samples"]] == ["Sample 1", "Mirror"]
    for sample in result["samples"]:
        names = {Path(path).name for path in sample["files"]}
        assert {"analysis.json", "cook-torrance-shift.json", "report.html"} <= names
        assert any(name.endswith(".bsdf") for name in names)
        assert all((folder / path).stat().st_size > 1000 for path in sample["files"])
        assert sample["points"] < sample["uniform_1_degree_points"]
    with closing(sqlite3.connect(folder / "goniometer.db")) as database, database:
        for path, digest in database.execute("SELECT path, sha256 FROM exports"):
            assert hashlib.sha256((folder / path).read_bytes()).hexdigest() == digest


def test_the_mirror_is_not_trusted_and_says_why_and_the_rough_sample_is(small: Small) -> None:
    rough, mirror = small[1]["samples"]
    assert rough["trusted"]["cook-torrance-shift"]
    assert not mirror["trusted"]["cook-torrance-shift"]
    assert "aperture" in " ".join(mirror["reasons"]["cook-torrance-shift"])


def test_blocked_directions_are_absent_from_every_export(small: Small) -> None:
    folder, result = small
    for sample in result["samples"]:
        (path,) = [p for p in sample["files"] if p.endswith("analysis.json")]
        local = json.loads((folder / path).read_text())["local"]
        detector = np.add(local["theta_in_deg"], local["theta_out_deg"])
        assert detector.size == sample["points"]
        assert np.abs(detector).min() >= 5 - 1e-9


def test_raw_counts_are_kept_and_cannot_be_changed(small: Small) -> None:
    with closing(sqlite3.connect(small[0] / "goniometer.db")) as database, database:
        (lights,) = database.execute("SELECT count(*) FROM exposures WHERE kind = 'light'").fetchone()
        assert lights >= sum(s["points"] for s in small[1]["samples"])
        with pytest.raises(sqlite3.DatabaseError, match="only ever added"):
            database.execute("UPDATE exposures SET counts = x'00'")


def test_a_finished_campaign_is_shown_again_and_not_measured_again(cli: Any, finished: Path, small: Small) -> None:
    again = cli("run", "small.yaml", "--json", cwd=finished)
    assert json.loads(again.stdout) == small[1]


def test_a_changed_campaign_does_not_resume_under_the_old_name(cli: Any, small: Small) -> None:
    folder, _ = small
    (folder / "changed.yaml").write_text((folder / "small.yaml").read_text().replace("[20, 60]", "[20, 50]"))
    done = cli("run", "changed.yaml", cwd=folder)
    assert done.returncode == 2
    assert "started with other content" in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    store = Store.open(folder / "goniometer.db")
    assert preflight(store, load_campaign(folder / "small.yaml"), None) == []
    (found,) = preflight(store, load_campaign(folder / "changed.yaml"), None)
    assert "started with other content" in found


def test_status_tells_what_is_in_the_database(cli: Any, small: Small) -> None:
    told = json.loads(cli("status", "--json", cwd=small[0]).stdout)
    assert [(s["sample"], s["outcome"]) for s in told["scans"]] == [
        ("reference", "completed"),
        ("Sample 1", "completed"),
        ("Mirror", "completed"),
    ]
    shown = cli("status", cwd=small[0]).stdout
    assert "Small: Sample 1: completed" in shown


def test_fitting_again_gives_the_same_numbers(cli: Any, small: Small) -> None:
    folder, result = small
    done = cli("fit", "Sample 1", "--model", "cook-torrance-shift", "--json", cwd=folder)
    fitted = json.loads(done.stdout)["fits"]["cook-torrance-shift"]
    first = {p["name"]: p["value"] for p in result["samples"][0]["parameters"]["cook-torrance-shift"]}
    assert {p["name"]: p["value"] for p in fitted["parameters"]} == first
    assert "k = 1" in cli("fit", "Mirror", cwd=folder).stdout


def test_any_model_can_be_fitted_in_any_way_and_then_stands_in_the_report(
    cli: Any, small: Small, tmp_path: Path
) -> None:
    folder, result = small
    ways = ("--model", "two-component", "--distribution", "beckmann", "--weight", "sine")
    done = cli("fit", "Sample 1", *ways, "--json", cwd=folder)
    assert done.returncode == 0, done.stderr
    fitted = json.loads(done.stdout)["fits"]["two-component"]
    assert fitted["distribution"] == "beckmann"
    together = "minimised with the chi-square of the local slopes"
    assert fitted["metrics"]["cost"]["name"] == f"loew, terms weighted by sin(theta_in), {together}"
    assert fitted["comparison"]["simpler_model"] == "cook-torrance-shift"
    with closing(sqlite3.connect(folder / "goniometer.db")) as database, database:
        ((text,),) = database.execute("SELECT json FROM fits WHERE model = 'two-component'")
    stored = fit_from_json(text)
    assert {p.name: p.value for p in stored.parameters} == {p["name"]: p["value"] for p in fitted["parameters"]}
    page = tmp_path / "page.html"
    assert cli("report", "Sample 1", "--output", page, cwd=folder).returncode == 0
    assert "Cook-Torrance, two components" in page.read_text(encoding="utf-8")
    # what a campaign came to is still what was fitted when its scan ended
    assert (
        json.loads(cli("run", "small.yaml", "--json", cwd=folder).stdout)["samples"][0]["parameters"]
        == (result["samples"][0]["parameters"])
    )
    refused = cli("fit", "Sample 1", "--conductor", "gold", cwd=folder)
    assert refused.returncode == 2
    assert "shelf/book/page" in refused.stderr


def test_exports_and_reports_can_be_written_at_any_time(cli: Any, small: Small, tmp_path: Path) -> None:
    folder, _ = small
    for arguments, start in (
        (["export", "sample 1", "--to", "json"], b'{\n "schema"'),
        (["export", "sample 1", "--to", "mitsuba"], b"tensor_file\0"),
        (["report", "sample 1"], b"<!doctype html>"),
    ):
        target = tmp_path / "-".join(arguments)
        done = cli(*arguments, "--output", target, "--json", cwd=folder)
        assert done.returncode == 0, done.stderr
        assert target.read_bytes().startswith(start)
        assert json.loads(done.stdout)["sha256"] == hashlib.sha256(target.read_bytes()).hexdigest()


def test_a_material_of_a_fit_that_is_not_to_be_trusted_says_so(cli: Any, small: Small, tmp_path: Path) -> None:
    for to in ("mitsuba", "mitsuba-plugin"):
        for sample, trusted in (("Sample 1", True), ("Mirror", False)):
            export = "export", sample, "--to", to, "-o", tmp_path / f"{sample} {to}.xml"
            assert ("is not to be trusted: The lobe is" in cli(*export, cwd=small[0]).stdout) is not trusted
            assert json.loads(cli(*export, "--json", cwd=small[0]).stdout)["trusted"] is trusted


def test_what_a_terminal_cannot_show_is_escaped_and_a_closed_one_is_no_fault(small: Small) -> None:
    def run(*command: str) -> subprocess.CompletedProcess[bytes]:
        latin = os.environ | {"PYTHONIOENCODING": "latin-1"}
        return subprocess.run(command, cwd=small[0], env=latin, capture_output=True, check=True)

    assert b"\\u03b8 in" in run(COMMAND, "budget", "1").stdout
    told = json.loads(run(COMMAND, "plan", "small.yaml", "--json").stdout)
    assert told["blocked"] == {"20.0": [-25.0, -15.0], "60.0": [-65.0, -55.0]}
    assert run("sh", "-c", f"{COMMAND} status >&-").stderr == b""


def test_a_name_that_keeps_nothing_is_no_database(cli: Any, tmp_path: Path) -> None:
    for name in ("", ":memory:", "sqlite://"):
        done = cli("token", "create", "lost", "--database", name, cwd=tmp_path)
        assert (done.returncode, done.stdout) == (1, "")
        assert "is not the name of a database; give a file" in done.stderr


def test_an_unknown_dataset_is_refused_with_the_known_ones(cli: Any, small: Small) -> None:
    done = cli("fit", "Sample 77", cwd=small[0])
    assert done.returncode == 2
    assert '"Sample 1"' in done.stderr


def test_the_preview_names_points_travel_and_blocked_range(cli: Any, small: Small) -> None:
    told = json.loads(cli("plan", "small.yaml", "--json", cwd=small[0]).stdout)
    assert told["blocked"] == {"20.0": [-25.0, -15.0], "60.0": [-65.0, -55.0]}
    assert told["uniform_1_degree_points"] == 2 * (171 - 9)
    assert "theta_in 20°: theta_out -25° to -15°" in cli("plan", "small.yaml", cwd=small[0]).stdout
    for leg in told["legs"]:  # every point may take from 8 ms to 30 s, or twice that of the reference
        time, scans = leg["time"], 2 if leg["name"] == "reference panel" else 1
        assert time["low"] < time["seconds"] < time["high"]
        assert time["high"] > scans * 30.0 * leg["points"]


def test_a_plan_is_drawn_into_nothing_that_is_called_another_kind_of_picture(cli: Any, small: Small) -> None:
    done = cli("plan", "small.yaml", "-o", "plan.png", cwd=small[0])
    assert done.returncode == 2
    assert "end its name in .svg" in done.stderr
    assert not (small[0] / "plan.png").exists()


def test_the_preview_tells_the_time_of_the_bench_that_the_file_states(cli: Any, small: Small, tmp_path: Path) -> None:
    def legs(options: str) -> list[dict[str, Any]]:
        (tmp_path / "bench.toml").write_text(
            f'[stages.sample]\ndriver = "smc100"\nurl = "COM1"\n'
            f'[stages.detector]\ndriver = "smc100"\nurl = "COM2"\n{options}'
        )
        told = cli("plan", "small.yaml", "--json", "--instrument", tmp_path / "bench.toml", cwd=small[0])
        return list(json.loads(told.stdout)["legs"])

    slow = legs("settling = 4.0\n[spectrometer]\ndead_time = 2.5\n")
    for before, after in zip(legs(""), slow, strict=True):
        # each point 2.5 s instead of 0.5 s, each move 4 s more; two incident angles have stray light besides
        moves = after["points"] - 1 + 2 * 2
        gained = after["time"]["low"] - before["time"]["low"]
        assert gained == pytest.approx(2.0 * after["points"] + 4.0 * moves)


def test_a_sample_that_cannot_be_fitted_does_not_cost_the_others_their_fits(cli: Any, tmp_path: Path) -> None:
    # an empty holder reflects nothing that could be fitted
    (tmp_path / "narrow.yaml").write_text(
        "name: Narrow\n"
        "samples: [{name: Empty, material: nothing}, {name: Mirror, material: mirror}]\n"
        "incident: [20]\n"
        "outgoing: {start: 10, stop: 30}\n"
    )
    for _ in range(2):
        done = cli("run", "narrow.yaml", "--json", cwd=tmp_path)
        assert done.returncode == 1
        assert done.stderr.strip().splitlines()[-1].startswith("goniometer: Empty: ")
        empty, mirror = json.loads(done.stdout)["samples"]
        assert empty["files"] == []
        assert empty["points"] >= 5
        assert "cook-torrance-shift" in mirror["parameters"]
    with closing(sqlite3.connect(tmp_path / "goniometer.db")) as database, database:
        assert database.execute("SELECT count(*) FROM fits WHERE model = 'analysis'").fetchone() == (1,)
