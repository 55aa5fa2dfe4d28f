"""What the documents show is what the program takes."""

import re
import subprocess
import sys
from pathlib import Path

from api.settings import load_instrument
from goniometer.campaign import Campaign, Sample, load_campaign

ROOT = Path(__file__).parents[2]


def test_the_campaign_in_the_documents_shows_the_defaults() -> None:
    shown = load_campaign(ROOT / "docs" / "campaign.yaml")
    default = Campaign(name=shown.name, samples=(Sample(name="Sample 1", material="sample-1"),))
    assert shown.model_dump(exclude={"samples"}) == default.model_dump(exclude={"samples"})
    assert shown.samples[0].material == "sample-1"


def test_the_instrument_in_the_documents_is_accepted() -> None:
    shown = load_instrument(ROOT / "docs" / "instrument.toml")
    assert (shown.stages.sample.driver, shown.stages.detector.driver) == ("smc100", "oriental-az")
    assert (shown.geometry.u_angle, shown.geometry.aperture, shown.spectrometer.gain) == (0.005, 1.0, 5.0)


def test_the_script_in_the_documents_breaks_a_stage_and_the_driver_survives() -> None:
    code, _ = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "simulated-laboratory.md").read_text(), re.DOTALL)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    *moves, happened = done.stdout.splitlines()
    assert [line.split() for line in moves] == [[str(angle), f"{angle}.0"] for angle in range(0, 90, 10)]
    assert "LOSE_REPLY" in happened
    assert "CORRUPT" in happened
    assert "asking again" in done.stderr
