"""`goniometer simulate surface` says how rough a surface is, on the screen, as JSON and on a page."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from api.commands.main import app
from goniometer.errors import InputError


def invoke(*arguments: object) -> Result:
    result = CliRunner().invoke(app, ["simulate", "surface", *map(str, arguments)])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


def test_a_sample_has_the_papers_roughness_beside_its_own_and_is_read_back_from_its_file(tmp_path: Path) -> None:
    file = tmp_path / "new" / "mine.npz"
    (made,) = json.loads(invoke("sample-4", "--size", 256, "-o", file, "--json").stdout)["surfaces"]
    assert made["parameters"]["sq_um"]["value"] == pytest.approx(0.98, rel=1e-3)
    assert made["parameters"]["sq_um"]["paper"] == 0.98
    assert made["parameters"]["sdr"]["paper"] == pytest.approx(0.0327)
    assert made["surface"]["dents"] > 10
    (read,) = json.loads(invoke(file, "--json").stdout)["surfaces"]
    for name, parameter in made["parameters"].items():
        assert read["parameters"][name]["value"] == pytest.approx(parameter["value"])
    assert read["parameters"]["sq_um"]["paper"] is None
    assert read["area_ratio"] == pytest.approx(1 + made["parameters"]["sdr"]["value"])
    told = invoke(file).stdout
    assert "Read from mine.npz: mean removed." in told
    assert "128 x 128 µm" in told


def test_a_grid_that_is_too_coarse_is_told_and_a_fine_one_is_not(tmp_path: Path) -> None:
    # a Gaussian autocorrelation of length L: leaving out every second point lowers Sdq by about (pitch / L)^2
    coarse = json.loads(invoke("gaussian:1:5", "--size", 128, "--pitch", 1, "--json").stdout)["surfaces"][0]
    change = coarse["parameters"]["sdq"]["at_twice_the_pitch"]
    slope = [np.sqrt(2 * (1 - np.exp(-((p / 5) ** 2)))) / p for p in (1.0, 2.0)]  # of a chord of the pitch p
    assert change == pytest.approx(slope[1] / slope[0] - 1, abs=0.02)
    told = " ".join(invoke("gaussian:1:5", "--size", 128, "--pitch", 1).stdout.split())
    assert re.search(r"Depends on the pitch: at twice the pitch .*Sdq −\d", told)
    fine = " ".join(invoke("gaussian:1:30", "--size", 256, "--pitch", 0.5).stdout.split())
    assert "At twice the pitch no parameter is more than 1 % different." in fine


def test_the_error_of_a_patch_is_that_between_patches() -> None:
    def sq(seed: int) -> dict[str, float]:
        found = json.loads(invoke("gaussian:1:8", "--size", 64, "--pitch", 2, "--seed", seed, "--json").stdout)
        return dict(found["surfaces"][0]["parameters"]["sq_um"])

    patches = [sq(seed) for seed in range(12)]
    between = np.std([p["value"] for p in patches], ddof=1)
    assert np.mean([p["relative_error"] for p in patches]) == pytest.approx(between, rel=0.5)


def test_one_surface_has_a_page_of_its_own_and_several_stand_side_by_side(tmp_path: Path) -> None:
    one, many = tmp_path / "one.html", tmp_path / "many.html"
    invoke("sample-1", "--size", 256, "--pitch", 1, "--page", one)
    assert one.read_text().count("<svg") == 5
    assert "Topography of sample-1" in one.read_text()
    names = ("sample-1", "sample-5", "sample-8", "brushed:0.2:3:20")
    invoke(*names, "--size", 256, "--pitch", 1, "--page", many)
    page = many.read_text()
    assert page.count("<svg") == 8
    assert all(f">{name}</td>" in page for name in names)
    assert not re.search(r'(src|href)="https?:', page)


def test_what_a_file_cannot_hold_is_refused_before_anything_is_written(tmp_path: Path) -> None:
    for arguments, told in (
        (("sample-1", "sample-2", "-o", tmp_path / "two.npz"), "name one surface"),
        (("sample-1", "-o", tmp_path / "one.txt"), "ends in .npz"),
        (("sample-1", tmp_path / "none.sur"), "no surface and no file"),
    ):
        with pytest.raises(InputError, match=told):
            invoke(*arguments, "--size", 64, "--pitch", 4)
    assert not list(tmp_path.iterdir())
