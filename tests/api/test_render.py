"""Renderings of a dataset from the command line."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

Small = tuple[Path, dict[str, Any]]


@pytest.mark.slow
def test_a_dataset_is_rendered_without_and_with_shift(cli: Any, small: Small, tmp_path: Path) -> None:
    pytest.importorskip("mitsuba")
    wanted = ("--through", "plugin", "--pixels", 20, "--samples", 2, "--output", tmp_path / "seen")
    page = tmp_path / "page.html"
    done = cli("render", "Sample 1", *wanted, "--page", page, "--json", cwd=small[0])
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["models"] == ["cook-torrance", "cook-torrance-shift"]
    assert found["dE00"]["mean"] > 1
    assert found["through"] == "plugin"
    assert all(len(seconds) == 2 for seconds in found["seconds"].values())
    names = {"cook-torrance.png", "cook-torrance-shift.png", "difference.png"}
    assert {path.name for path in (tmp_path / "seen").iterdir()} == names
    assert page.read_text(encoding="utf-8").count("<img") == 3


@pytest.mark.slow
def test_an_exported_scene_renders_with_the_plugin_beside_it(cli: Any, small: Small, tmp_path: Path) -> None:
    pytest.importorskip("mitsuba")
    scene = tmp_path / "scene.xml"
    done = cli("export", "Sample 1", "--to", "mitsuba-plugin", "--output", scene, cwd=small[0])
    assert done.returncode == 0, done.stderr
    assert "ggx_shift.py" in done.stdout
    root = ElementTree.parse(scene).getroot()
    bsdf = next(each for each in root.iter("bsdf") if each.get("id") == "sample")
    assert {each.get("name") for each in bsdf} == {"alpha", "eta", "k", "h", "w"}
    text = scene.read_text(encoding="utf-8").replace('value="512"', 'value="8"').replace('value="256"', 'value="2"')
    scene.write_text(text, encoding="utf-8")
    command = [sys.executable, "-I", "ggx_shift.py", "scene.xml", "image.exr"]
    subprocess.run(command, cwd=tmp_path, check=True)
    assert (tmp_path / "image.exr").stat().st_size > 0
    again = "export", "Sample 1", "--to", "mitsuba-plugin", "--output", tmp_path / "other.xml"
    assert cli(*again, cwd=small[0]).returncode == 0
    (tmp_path / "ggx_shift.py").write_text("# mine\n", encoding="utf-8")
    refused = cli(*again, cwd=small[0])
    assert refused.returncode == 2
    assert "ggx_shift.py is there already" in refused.stderr
    assert (tmp_path / "ggx_shift.py").read_text(encoding="utf-8") == "# mine\n"
