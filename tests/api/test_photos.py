"""Photographs on the command line: simulated, read again, shown, and refused in one line."""

import json
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

Cli = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture(scope="module")
def taken(cli: Cli, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """Folder and JSON of a small simulated series."""
    folder = tmp_path_factory.mktemp("photos")
    surface = ("gaussian:0.2:4", "--size", 768, "--pitch", 0.2, "--led", 0)
    done = cli("simulate", "photos", *surface, "--output", "out", "--json", cwd=folder)
    assert done.returncode == 0, done.stderr
    return folder, json.loads(done.stdout)


@pytest.mark.slow
def test_simulated_photographs_are_read_with_the_colours_that_the_waves_have(
    cli: Cli, taken: tuple[Path, dict[str, Any]]
) -> None:
    folder, simulated = taken
    done = cli("photos", "out/series.toml", "--inset", "1", "--page", "page.html", "--json", cwd=folder)
    assert done.returncode == 0, done.stderr
    series = json.loads(done.stdout)["series"][0]
    assert [photo["angle"] for photo in series["photos"]] == list(range(-70, 71, 5))
    assert simulated["convergence"]["reached"]
    for photo, frame in zip(series["photos"], simulated["frames"], strict=True):
        if abs(photo["angle"] - 45) > 20:
            continue  # elsewhere so smooth a surface is dark
        # the inset is a square of the photograph and holds other speckles than the whole
        error = photo["u_red_over_blue"]
        assert photo["red_over_blue"] == pytest.approx(frame["red_over_blue"], abs=4 * error)
    page = (folder / "page.html").read_text()
    assert page.count("<svg") == 3
    assert "http://" not in page.replace("http://www.w3.org", "")


@pytest.mark.slow
def test_a_series_is_shown_as_a_table(cli: Cli, taken: tuple[Path, dict[str, Any]]) -> None:
    done = cli("photos", "out/series.toml", "--inset", "1", cwd=taken[0])
    assert done.returncode == 0, done.stderr
    assert "gaussian:0.2:4, camera at 45°" in done.stdout
    assert len(taken[1]["frames"]) == 29
    assert np.isfinite([frame["rgb"] for frame in taken[1]["frames"]]).all()


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("photos", "none.toml"), "none.toml: the series cannot be read"),
        (("photos", "none.toml", "--inset", "nan"), "between 0 and 1"),
        (("simulate", "photos", "sample-9", "-o", "x"), "no file 'sample-9'"),
        (("simulate", "photos", "gaussian:1:5", "--led", "50", "-o", "x"), "0 to 10 degrees"),
        (("simulate", "photos", "gaussian:6:5", "-o", "x"), "points wide at this pitch"),
    ],
)
def test_bad_input_gets_one_line(cli: Cli, tmp_path: Path, arguments: tuple[str, ...], told: str) -> None:
    done = cli(*arguments, cwd=tmp_path)
    assert done.returncode == 2
    assert told in done.stderr
    assert "Traceback" not in done.stderr
