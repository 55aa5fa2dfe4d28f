"""The model that a scene needs, from the command line: answer, page, weights, and refusals in one line."""

import json
from pathlib import Path
from typing import Any

import pytest

from analysis.bsdf.measured_bsdf import read_bsdf

SUN = """
camera: {position: [0, -4, 1], pixels: [16, 16], field_of_view: 32}
material: [{sphere: 1}]
lights: [{sun: [1, -1, 1]}]
"""

Small = tuple[Path, dict[str, Any]]


@pytest.mark.slow
def test_a_scene_gets_its_model_a_page_and_a_campaign_of_its_own(cli: Any, small: Small, tmp_path: Path) -> None:
    folder, _ = small
    (tmp_path / "sun.yaml").write_text(SUN)
    page, weights, bsdf = tmp_path / "page.html", tmp_path / "weights.json", tmp_path / "sun.bsdf"
    wanted = ("--scene", tmp_path / "sun.yaml", "--no-render", "--tolerance", 2, "--json")
    done = cli("choose", "Sample 1", *wanted, "--page", page, "--weights", weights, "--bsdf", bsdf, cwd=folder)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    models = [rung["model"] for rung in found["rungs"]]
    assert models == ["lambert", "tinted", "cook-torrance", "cook-torrance-shift", "two-component", "table"]
    assert found["rungs"][0]["state"] == "fails"
    assert found["chosen"]["model"] in models
    assert found["chosen"]["dE00"]["expected"] < 2
    assert found["rendered"] is None
    assert found["bsdf"]["bytes"] == bsdf.stat().st_size
    assert f"Model {found['chosen']['model']} of sample Sample 1" in read_bsdf(bsdf.read_bytes()).description
    assert "sun.bsdf" in bsdf.with_name("sun.scene.xml").read_text(encoding="utf-8")
    text = page.read_text(encoding="utf-8")
    assert text.count("<img") == 3
    assert "Cook-Torrance with shift" in text
    campaign = tmp_path / "campaign.yaml"
    campaign.write_text(
        "name: Sun\nsamples: [{name: Sample 1, material: sample-1}]\n"
        "resolution: {scene: weights.json, colour_tolerance: 1}\n"
    )
    planned = cli("plan", campaign, cwd=tmp_path)
    assert planned.returncode == 0, planned.stderr
    assert "in the scene sun.yaml" in " ".join(planned.stdout.split())


def test_a_scene_that_is_none_ends_with_code_2_and_one_line(cli: Any, small: Small, tmp_path: Path) -> None:
    path = tmp_path / "scene.yaml"
    path.write_text(SUN.replace("sphere: 1", "sphere: -1"))
    done = cli("choose", "Sample 1", "--scene", path, cwd=small[0])
    assert done.returncode == 2
    assert len(done.stderr.strip().splitlines()) == 1
    assert "sphere" in done.stderr
