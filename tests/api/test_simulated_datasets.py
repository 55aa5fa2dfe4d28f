"""A simulated BRDF goes through every command as a measured one does, and nothing ever calls it measured."""

import html
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from api.commands.main import app
from api.commands.simulations import store_computed
from goniometer.errors import CampaignError, InputError
from goniometer.storage.store import Store
from simulators.computed import Computed
from simulators.materials.materials import SAMPLES, true_brdf
from simulators.materials.tabulated_file import read_tabulated


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
    assert "θ in 40.0°, θ out -40.0°; BRDF at 600 nm" in text


def test_a_simulation_is_not_calibrated_anew(database: Path) -> None:
    with pytest.raises(InputError, match="Dataset 1 was simulated and has no raw data; simulate it again instead"):
        invoke("calibrate", "Traced", "-d", database)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A simulation as a material, and a small campaign that measures it on a bench with all its errors."""
    folder = tmp_path_factory.mktemp("loop")
    theta_in, theta_out = (a.ravel() for a in np.meshgrid([20.0, 60.0], np.arange(-85.0, 86, 2.5), indexing="ij"))
    wavelengths = np.arange(400.0, 781, 20)
    brdf = true_brdf(SAMPLES["sample-4"], theta_in, theta_out, wavelengths, aperture=0.0)
    lineage: dict[str, object] = {"simulated": "formula of sample-4"}
    made = Computed("Lobe", theta_in, theta_out, wavelengths, brdf, 0 * brdf, 0 * brdf, 0.0, lineage)
    store_computed(folder / "simulated.db", made)
    (folder / "loop.yaml").write_text(LOOP)
    told = invoke("simulate", "material", "Lobe", "-d", folder / "simulated.db", "-o", folder / "lobe.npz").stdout
    assert "none of them filled; values without aperture; 20 wavelengths from 400 to 780 nm" in told
    assert "material: file:lobe.npz" in told
    return folder


LOOP = """
name: Loop
seed: 5
samples: [{name: Copy, material: "file:lobe.npz"}]
incident: [20, 60]
resolution: {tolerance: 0.02, colour_tolerance: 1}
monitor: null
"""


@pytest.fixture(scope="module")
def measured(folder: Path) -> dict[str, Any]:
    """What became of the sample."""
    run = ("run", folder / "loop.yaml", "-d", folder / "run.db", "-o", folder / "results", "--json")
    (sample,) = json.loads(invoke(*run).stdout)["samples"]
    return dict(sample)


@pytest.mark.slow
def test_a_simulation_that_is_measured_on_the_bench_comes_back_within_its_uncertainty(
    folder: Path, measured: dict[str, Any]
) -> None:
    sample, database = measured, folder / "run.db"
    assert not any("true" in parameter for model in sample["parameters"].values() for parameter in model)
    store = Store.open(database)
    dataset, table = store.dataset(sample["dataset_id"]), read_tabulated(folder / "lobe.npz")
    assert (dataset.lineage["material"], dataset.lineage["material_sha256"]) == ("lobe.npz", table.sha256)
    assert 395 < dataset.wavelengths[0] < 400  # nothing is calibrated that the table does not know
    assert 780 < dataset.wavelengths[-1] < 785
    truth = true_brdf(table, dataset.theta_in, dataset.theta_out, dataset.wavelengths)
    z = ((dataset.brdf - truth) / dataset.u)[dataset.usable]
    print(
        f"{dataset.theta_in.size} points: {np.mean(np.abs(z) < 2):.1%} of z below 2, rms {np.sqrt(np.mean(z**2)):.2f}"
    )
    assert np.mean(np.abs(z) < 2) > 0.9
    assert np.sqrt(np.mean(z**2)) < 1.5
    for parameter in sample["parameters"]["cook-torrance-shift"]:
        name, value, u = parameter["name"], parameter["value"], parameter["standard_error"]
        print(f"{name}: {value:.4f} ± {u:.4f}, simulated with {getattr(SAMPLES['sample-4'], name)}")
        assert abs(value - getattr(SAMPLES["sample-4"], name)) < 3 * u
    store.close()


@pytest.mark.slow
def test_a_campaign_follows_a_material_that_was_moved_and_is_not_resumed_with_another_one(
    folder: Path, measured: dict[str, Any]
) -> None:
    database = folder / "run.db"
    moved = folder / "elsewhere"
    moved.mkdir()
    for name in ("lobe.npz", "loop.yaml"):
        (moved / name).write_bytes((folder / name).read_bytes())
    again = json.loads(invoke("run", moved / "loop.yaml", "-d", database, "-o", folder / "results", "--json").stdout)
    assert again["samples"][0]["material"].startswith(f"file:{moved / 'lobe.npz'}#sha256=")
    assert again["samples"][0]["dataset_id"] == measured["dataset_id"]
    with (moved / "lobe.npz").open("ab") as file:
        file.write(b"\0" * 3)
    with pytest.raises(CampaignError, match='started with another material file of the sample "Copy"; undo the change'):
        invoke("run", moved / "loop.yaml", "-d", database, "-o", folder / "results")


def test_a_campaign_that_asks_a_table_for_more_than_it_knows_is_refused_before_anything_moves(folder: Path) -> None:
    (folder / "wide.yaml").write_text(LOOP.replace("[20, 60]", "[20, 70]").replace("Loop", "Wide"))
    with pytest.raises(InputError, match="known at incident angles from 20 to 60 deg, and not at 70 deg"):
        invoke("run", folder / "wide.yaml", "-d", folder / "wide.db")
    (folder / "wrong.yaml").write_text(LOOP.replace("lobe.npz", "lob.npz"))
    with pytest.raises(InputError, match=r"lob\.npz: the material cannot be read"):
        invoke("run", folder / "wrong.yaml", "-d", folder / "wide.db")
    assert Store.open(folder / "wide.db").campaigns() == {}
    planned = invoke("plan", folder / "wrong.yaml")  # which needs no material, and says that there is none
    assert planned.exit_code == 2
    assert "theta_in" in planned.stdout
    assert "lob.npz: the material cannot be read" in planned.stderr


def test_a_material_is_written_to_a_file_that_says_what_it_is(database: Path) -> None:
    with pytest.raises(InputError, match=r"end its name in \.npz"):
        invoke("simulate", "material", "Traced", "-d", database, "-o", database.with_name("traced.txt"))
    path = database.with_name("traced.npz")
    told = json.loads(invoke("simulate", "material", "Traced", "-d", database, "-o", path, "--json").stdout)
    assert told["sha256"] == read_tabulated(path).sha256
    assert told["theta_in_deg"] == [0.0, 40.0, 70.0]
    assert told["filled_directions"] == 3 * 34  # one between each two directions
    assert told["origin"]["simulated"] == "rays on sample-4"
