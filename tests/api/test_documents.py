"""What the documents show is what the program takes."""

import re
import sqlite3
import subprocess
import sys
from pathlib import Path

import pytest

from api.settings import load_instrument
from goniometer.campaign import Campaign, Sample
from goniometer.campaign_file import load_campaign
from goniometer.tables import BENCH

ROOT = Path(__file__).parents[2]


def test_the_campaign_in_the_documents_shows_the_defaults() -> None:
    shown = load_campaign(ROOT / "docs" / "campaign.yaml")
    default = Campaign(name=shown.name, samples=(Sample(name="Sample 1", material="sample-1"),))
    assert shown.model_dump(exclude={"samples"}) == default.model_dump(exclude={"samples"})
    assert shown.samples[0].material == "sample-1"


def test_the_instrument_in_the_documents_is_accepted() -> None:
    shown = load_instrument(ROOT / "docs" / "instrument.toml")
    assert shown.bench == BENCH
    assert (shown.stages.sample.driver, shown.stages.detector.driver) == ("smc100", "oriental-az")
    assert (shown.geometry.u_angle, shown.geometry.aperture, shown.spectrometer.gain) == (0.005, 1.0, 5.0)


def test_the_script_in_the_documents_breaks_a_stage_and_the_driver_survives() -> None:
    code, _, _ = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "simulated-laboratory.md").read_text(), re.DOTALL)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    *moves, happened = done.stdout.splitlines()
    assert [line.split() for line in moves] == [[str(angle), f"{angle}.0"] for angle in range(0, 90, 10)]
    assert "LOSE_REPLY" in happened
    assert "CORRUPT" in happened
    assert "asking again" in done.stderr


def test_a_script_of_ones_own_runs_on_the_bench_of_the_documents_though_its_devices_fail(
    capsys: pytest.CaptureFixture[str],
) -> None:
    _, code, _ = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "simulated-laboratory.md").read_text(), re.DOTALL)
    exec(code, {})
    here, *rest = capsys.readouterr().out.splitlines()
    assert here == "Geometry(theta_in=20.0, theta_out=40.0)"
    assert rest == ["(1044,)", "['lose-reply']", "['duplicate']"]


@pytest.mark.slow
def test_the_campaign_script_in_the_documents_measures_again_where_the_budget_says_so(tmp_path: Path) -> None:
    command = [sys.executable, "-W", "error::RuntimeWarning", str(ROOT / "docs" / "scripted_campaign.py")]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=300, check=True)
    lines = done.stdout.splitlines()
    scans = [line.rsplit(":", 1)[0] for line in lines if not line.startswith(" ")]
    assert scans == ["Sheet, Sheet #1", "Sheet, Sheet #2", "Sheet, finer, Sheet"]
    worst = [float(re.findall(r"up to ([\d.]+)%", line)[0]) for line in lines if line.startswith(" ")]
    assert max(worst[-2:]) < 0.5 * min(worst[:2])
    assert len(list(tmp_path.glob("results/*/*/report.html"))) == 3
    with sqlite3.connect(tmp_path / "scripted.db") as database:  # the bench was opened once
        assert database.execute("SELECT count(DISTINCT session) FROM exposures").fetchone() == (1,)
    database.close()
