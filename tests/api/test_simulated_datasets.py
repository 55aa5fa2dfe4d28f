"""A simulated BRDF goes through every command as a measured one does, and nothing ever calls it measured."""

import html
import json
import re
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from api.cli import app
from api.simulations import store_computed
from goniometer.errors import InputError
from simulators.computed import Computed
from simulators.materials import SAMPLES, true_brdf


def invoke(*arguments: object) -> Result:
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


def computed() -> Computed:
    """A known lobe every 5 degrees, the way back to the lamp included, as a simulation with two kinds of noise."""
    random = np.random.default_rng(3)
    theta_in, theta_out = (a.ravel() for a in np.meshgrid([0.0, 40, 70], np.arange(-85.0, 86, 5), indexing="ij"))
    wavelengths = np.arange(400.0, 781, 20)
    truth = true_brdf(SAMPLES["sample-4"], theta_in, theta_out, wavelengths, aperture=0.0)
    level, colour = 0.01 * random.standard_normal((theta_in.size, 1)), 0.003 * random.standard_normal(truth.shape)
    brdf = truth * (1 + level + colour)
    lineage: dict[str, object] = {"simulated": "rays on sample-4", "rays": 100_000}
    return Computed("Traced", theta_in, theta_out, wavelengths, brdf, 0.01 * brdf, 0.003 * brdf, 0.0, lineage)


@pytest.fixture(scope="module")
def database(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("simulated") / "goniometer.db"
    assert store_computed(path, computed()) == 1
    return path


def test_the_list_of_datasets_says_which_ones_were_simulated_and_how(database: Path) -> None:
    assert "simulated: Traced: rays on sample-4, dataset 1" in invoke("status", "-d", database).stdout
    told = json.loads(invoke("status", "-d", database, "--json").stdout)
    assert told["simulated"] == [{"dataset": 1, "sample": "Traced", "how": "rays on sample-4"}]
    assert told["imported"] == []


def test_a_simulation_is_checked_and_has_a_budget(database: Path) -> None:
    told = json.loads(invoke("check", "Traced", "-d", database, "--json").stdout)
    assert told["passed"]
    assert {check["name"]: check["passed"] for check in told["checks"]} == {
        "reciprocity": True,
        "energy": True,
        "values": True,
        "noise floor": True,
    }
    page = database.with_name("budget.html")
    shown = invoke("budget", "Traced", "--theta-in", 40, "-d", database, "-o", page).stdout
    assert "simulated at θ in = 40.00°, θ out = 40.00°" in " ".join(shown.split())
    assert "measured" not in shown
    assert "blocked" not in page.read_text()
    budget = json.loads(invoke("budget", "Traced", "--theta-in", 40, "-d", database, "--json").stdout)
    assert budget["u"] / budget["brdf"] == pytest.approx(np.hypot(0.01, 0.003), rel=1e-6)


def test_a_fit_finds_what_was_simulated(database: Path) -> None:
    told = json.loads(invoke("fit", "Traced", "--model", "cook-torrance-shift", "-d", database, "--json").stdout)
    found = told["fits"]["cook-torrance-shift"]
    for parameter in found["parameters"]:
        true = getattr(SAMPLES["sample-4"], parameter["name"])
        assert abs(parameter["value"] - true) < 4 * parameter["standard_error"]


def test_exports_hold_the_way_back_to_the_lamp_which_no_detector_blocks(database: Path) -> None:
    fits, bsdf = database.with_name("fits.json"), database.with_name("model.bsdf")
    invoke("export", "Traced", "--to", "json", "-o", fits, "-d", database)
    local = json.loads(fits.read_text())["local"]
    assert len(local["theta_in_deg"]) == computed().theta_in.size
    invoke("export", "Traced", "--to", "mitsuba", "-o", bsdf, "-d", database)
    assert bsdf.stat().st_size > 0


def test_a_report_never_says_that_a_simulation_was_measured(database: Path) -> None:
    path = database.with_name("report.html")
    invoke("report", "Traced", "-o", path, "-d", database)
    page = path.read_text()
    text = html.unescape(re.sub(r"<style>.*?</style>|<[^>]*>", " ", page, flags=re.DOTALL))
    assert "Simulated: rays on sample-4" in text
    assert "What was simulated" in text
    assert "100000" in text  # its lineage
    for word in ("measure", "detector blocks", "blocked", "hatch", "stage position", "elsewhere"):
        assert word not in text.lower(), word
    # the retro direction has a cell of its own
    assert "θ in 40.0°, θ out -40.0°; f(600 nm)" in text


def test_a_simulation_is_not_calibrated_anew(database: Path) -> None:
    with pytest.raises(InputError, match="Dataset 1 was simulated and has no raw data; simulate it again instead"):
        invoke("calibrate", "Traced", "-d", database)
