"""`goniometer simulate rays`: what it leaves behind can be read, listed and fitted, and wrong input is told apart."""

import json
from pathlib import Path
from typing import Any

import pytest

SMALL = [
    *("simulate", "rays", "gaussian:2.4:9", "--size", 128, "--pitch", 1, "--rays", 20_000, "--patches", 2),
    *("--incident", "0,60", "--outgoing", "-80:80:8", "--aperture", 8),
]


def test_a_scan_is_stored_drawn_and_fitted_like_a_measurement(cli: Any, tmp_path: Path) -> None:
    done = cli(*SMALL, "--page", "rays.html", "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    for energy in told["decomposition"]["energy"]:
        shares = [*energy["escaped_by_reflections"], energy["absorbed"], energy["lost"], energy["stopped"]]
        assert sum(shares) == pytest.approx(1, abs=1e-12)
        rays = energy["rays"]
        assert rays["escaped"] + rays["lost"] + rays["stopped"] == rays["traced"] >= 20_000
    assert any("no better than" in warning for warning in told["warnings"])
    assert {row["theta_in"] for row in told["convergence"]} == {0, 60}
    text = (tmp_path / "rays.html").read_text()
    assert text.count("<svg") == 3
    assert "http" not in text.replace("http://www.w3.org", "")
    listed = json.loads(cli("status", "--json", cwd=tmp_path).stdout)
    assert listed["simulated"] == [
        {"dataset": 1, "sample": "gaussian:2.4:9 (rays)", "how": "rays on gaussian:2.4:9"},
    ]
    fitted = cli("fit", "gaussian:2.4:9 (rays)", "--model", "cook-torrance", "--json", cwd=tmp_path)
    assert fitted.returncode == 0, fitted.stderr
    parameters = json.loads(fitted.stdout)["fits"]["cook-torrance"]["parameters"]
    alpha = {each["name"]: each["value"] for each in parameters}["alpha"]
    assert alpha == pytest.approx(2 * 2.4 / 9, rel=0.35)  # Beckmann's roughness is sqrt(2) times the rms slope


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--incident", "0:80:0"], ["--incident", "FIRST:LAST:STEP"]),
        (["--incident", "90"], ["incident angles", "85"]),
        (["--size", "129"], ["even"]),
    ],
)
def test_what_cannot_be_scanned_is_told_in_one_line(
    cli: Any, tmp_path: Path, arguments: list[str], words: list[str]
) -> None:
    done = cli(*SMALL, *arguments, cwd=tmp_path)
    assert done.returncode == 2
    assert done.stdout == ""
    assert len(done.stderr.strip().splitlines()) == 1, done.stderr
    assert all(word in done.stderr for word in words)
