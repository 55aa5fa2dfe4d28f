"""`goniometer simulate waves` as a user runs it: energy, fits of its dataset, what it tells, and what it refuses."""

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from analysis.errors import AnalysisError
from analysis.reflectance.fresnel import fresnel_conductor, load_conductor
from api.commands.main import app
from api.results.products import fit_dataset
from goniometer.errors import InputError
from goniometer.storage.store import Store

ROUGH = ("gaussian:0.4:3", "--size", 128, "--patches", 4, "--aperture", 3)
GRIDS = ("--incident", "20:60:20", "--outgoing", "-80:80:5", "--wavelengths", "400:800:50")


def invoke(*arguments: object) -> Result:
    result = CliRunner().invoke(app, ["simulate", "waves", *(str(argument) for argument in arguments)])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


@pytest.mark.slow
def test_a_mirror_reflects_what_fresnel_says_and_nothing_else(tmp_path: Path) -> None:
    database = tmp_path / "goniometer.db"
    told = invoke(
        "gaussian:0.00001:5", "--size", 64, "--patches", 4, "--aperture", 2, "--incident", "30:30:1",
        "--outgoing", "24:36:0.25", "--wavelengths", "400:800:100", "--database", database, "--json",
    )  # fmt: skip
    found = json.loads(told.stdout)
    assert found["sampling"]["sufficient"]
    dataset = Store.open(database).dataset(found["dataset"])
    assert dataset.sample == "gaussian:0.00001:5 (waves)"
    assert dataset.lineage["simulated"] == "waves on gaussian:0.00001:5"
    in_plane = (dataset.brdf * np.cos(np.radians(dataset.theta_out))[:, None]).sum(axis=0) * np.radians(0.25)
    # the lobe of the window is exp(-(k s beta)^2) across the plane, k s the same at all wavelengths
    across = np.sqrt(np.pi) / (2 * np.pi / 0.6 * found["lineage"]["coherence_um_at_600_nm"])
    n, k = load_conductor().index(dataset.wavelengths)
    wanted = fresnel_conductor(np.cos(np.radians(30)) * np.ones(1), n, k)
    assert in_plane * across == pytest.approx(wanted, rel=2e-3)


@pytest.mark.slow
def test_a_simulation_is_fitted_and_shown_like_a_measurement(tmp_path: Path) -> None:
    database, page = tmp_path / "goniometer.db", tmp_path / "waves.html"
    told = invoke(*ROUGH, *GRIDS, "--seed", 3, "--database", database, "--page", page, "--json")
    found = json.loads(told.stdout)
    assert found["multiple"] is None
    assert {figure["what"] for figure in found["convergence"]["figures"]} == {"f", "m"}
    assert found["convergence"]["median"]["half the step"] < 0.01
    store = Store.open(database)
    fits = fit_dataset(store, 1, None)["fits"]
    dataset = store.dataset(1)
    assert sum(fits["local"]["reliable"]) > 0.5 * dataset.theta_in.size
    assert set(fits) == {"local", "global", "cook-torrance", "cook-torrance-shift"}
    (alpha,) = (p["value"] for p in fits["cook-torrance"]["parameters"] if p["name"] == "alpha")
    # Beckmann's alpha is sqrt(2) times the slope of one direction, here 2 rms / length; GGX's is a little less
    assert alpha == pytest.approx(2 * 0.4 / 3, rel=0.3)
    text = page.read_text()
    assert "What is left out" in text
    assert text.count("<svg") == 2 + 2 + 3
    again = json.loads(invoke(*ROUGH, *GRIDS, "--seed", 3, "--database", database, "--json").stdout)
    assert store.dataset(again["dataset"]).content_hash == dataset.content_hash


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--incident", "0:80"), "--incident 0:80 should read FIRST:LAST:STEP"),
        (("--wavelengths", "400:700:100"), "at least 5"),
        (("--wavelengths", "400:1200:50"), "leads beyond"),
        (("--outgoing", "-90:90:5"), "between -85 and 85"),
        (("--aperture", "1", "--coherence", "10"), "give one of them"),
        (("--aperture", "-1"), "sees nothing"),
        (("--multiple-shift", "0.5"), "give --with-multiple"),
        (("--conductor", "aluminium"), "shelf/book/page"),
        (("--micro", "--pitch", "0.5"), "needs 0.1 um or less"),
    ],
)
def test_what_cannot_be_simulated_is_refused_with_a_sentence(arguments: tuple[str, ...], said: str) -> None:
    with pytest.raises((InputError, AnalysisError), match=said) as refused:
        invoke("gaussian:0.5:5", *arguments)
    assert isinstance(refused.value, InputError | AnalysisError)
    assert refused.value.exit_code == 2
