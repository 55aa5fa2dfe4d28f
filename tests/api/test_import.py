"""Import of other people's data on the command line, and that everything else works on what was imported."""

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from analysis.errors import FitError
from api.commands.main import app
from api.exports.formats import export_dataset
from api.results.products import HowToFit, fit_dataset, last_way, report_dataset
from goniometer.errors import InputError
from goniometer.storage.store import Store
from simulators.materials.materials import SAMPLES, true_brdf
from tests.drawn_dataset import directions

STATED = ("--relative-uncertainty", 0.01, "--aperture", 1, "--angle-uncertainty", 0.01)


def invoke(*arguments: object) -> Result:
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """Sample 2 in the published form, with noise of 0.3 % and 1e-5 1/sr, its points in no order."""
    random = np.random.default_rng(4)
    theta_in, theta_out = directions(SAMPLES["sample-2"].alpha, incident=(0, 20, 40, 60))
    wavelengths = np.arange(390.0, 781.0, 10.0)
    truth = true_brdf(SAMPLES["sample-2"], theta_in, theta_out, wavelengths)
    drawn = truth * (1 + 0.003 * random.standard_normal(truth.shape)) + 1e-5 * random.standard_normal(truth.shape)
    points = [
        {"thetaIn": t, "phiIn": 0, "thetaOut": abs(o), "phiOut": 180 if o >= 0 else 0, "spectrum": f.tolist()}
        for t, o, f in zip(theta_in, theta_out, drawn, strict=True)
    ]
    order = random.permutation(len(points))
    path = tmp_path / "their sample.json"
    path.write_text(json.dumps([{"wavelengths": wavelengths.tolist()}, *(points[i] for i in order)]))
    return path


@pytest.mark.slow
def test_imported_data_are_fitted_checked_and_reported_like_measured_ones(file: Path, tmp_path: Path) -> None:
    database = tmp_path / "goniometer.db"
    told = invoke("import", file, *STATED, "--database", database).stdout
    assert "as dataset 1, their sample: " in told
    assert "at 4 incident angles, 40 wavelengths from 390 to 780 nm" in told
    store = Store.open(database)
    assert "imported: their sample: their sample.json, dataset 1" in invoke("status", "-d", database).stdout
    lineage = store.lineage(1)
    assert lineage["imported"] == "their sample.json"
    assert lineage["imported_sha256"] == hashlib.sha256(file.read_bytes()).hexdigest()
    fitted = fit_dataset(store, 1, None)["fits"]
    (alpha,) = (p for p in fitted["cook-torrance-shift"]["parameters"] if p["name"] == "alpha")
    assert alpha["value"] == pytest.approx(SAMPLES["sample-2"].alpha, rel=0.02)
    report_dataset(store, 1, tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text()
    assert "their sample.json" in page
    assert "bench time" not in page
    assert invoke("check", "their sample", "--database", database).exit_code == 0
    assert [source.name for source in store.dataset(1).sources][1] == "reference: as stated with the file"
    with pytest.raises(InputError, match="import its file again"):
        invoke("calibrate", "their sample", "--database", database)


def test_what_a_file_does_not_say_is_asked_for_by_the_option_that_says_it(file: Path, tmp_path: Path) -> None:
    database = tmp_path / "goniometer.db"
    table = tmp_path / "a.csv"
    table.write_text("theta_in,theta_out,400\n10,20,0.3\n")
    raw = tmp_path / "a.txt"
    raw.write_text("10 20 5\n1500 1501 1502 1503\n400,0 410,0 420,0 430,0\n--\n")
    for arguments, wanted in [
        ((file,), "state --aperture, --angle-uncertainty as well"),
        ((file, "--aperture", 1, "--angle-uncertainty", 0), "--relative-uncertainty"),
        ((file, *STATED, "--quantity", "brdf"), "no use for --quantity"),
        ((table, *STATED), "state --quantity, --angles, --wavelengths as well"),
        ((raw, *STATED, "--dark-subtracted"), "state --reference, --certificate, --saturation as well"),
        ((raw, *STATED), "--darks"),
    ]:
        with pytest.raises(InputError, match=wanted):
            invoke("import", *arguments, "--database", database)
    assert not database.exists()


def test_a_file_of_zeros_is_imported_with_checks_that_do_not_know_and_is_refused_by_the_fits(tmp_path: Path) -> None:
    database, table = tmp_path / "goniometer.db", tmp_path / "black.csv"
    table.write_text(
        "theta_in,theta_out,400,500,600,700,800\n" + "".join(f"30,{o},0,0,0,0,0\n" for o in range(5, 80, 5))
    )
    units = ("--quantity", "brdf", "--angles", "deg", "--wavelengths", "nm", "--relative-noise", 0.01)
    told = invoke("import", table, *STATED, *units, "--database", database).stdout
    assert "no value differs from zero" in told
    assert "? energy: Not known" in told
    with pytest.raises(FitError, match="No spectrum of black"):
        report_dataset(Store.open(database), 1, tmp_path / "report.html")


def test_an_export_does_not_write_over_the_file_that_was_imported(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    mine = file.rename(tmp_path / "mine.json")
    before = mine.read_bytes()
    invoke("import", mine, *STATED)
    with pytest.raises(InputError, match="has the name of the file that was imported"):
        export_dataset(Store.open(tmp_path / "goniometer.db"), 1, "json", None)
    assert mine.read_bytes() == before


def test_an_import_leaves_out_wavelengths_and_prints_its_lineage_as_json(file: Path, tmp_path: Path) -> None:
    database = tmp_path / "goniometer.db"
    found = json.loads(
        invoke("import", file, *STATED, "--lowest", 500, "--sample", "Theirs", "-d", database, "--json").stdout
    )
    assert (found["dataset"], found["sample"], found["points"] > 50) == (1, "Theirs", True)
    assert found["lineage"]["notes"] == ["11 of 40 wavelengths were left out, as asked for."]
    assert {check["name"] for check in found["checks"]} == {"reciprocity", "energy", "values", "noise floor"}


def test_a_report_and_an_export_are_of_the_metal_and_distribution_that_were_fitted(file: Path, tmp_path: Path) -> None:
    database = tmp_path / "goniometer.db"
    invoke("import", file, *STATED, "--database", database)
    store = Store.open(database)
    gold = HowToFit("fast", "beckmann", "sine", "main/Au/Johnson")
    fit_dataset(store, 1, "cook-torrance", gold)
    assert last_way(store, 1) == gold
    fit_dataset(store, 1, "dielectric", HowToFit(distribution="beckmann"))  # has no metal to choose
    assert last_way(store, 1) == HowToFit("fast", "beckmann", "none", "main/Au/Johnson")
    written = json.loads(export_dataset(store, 1, "json", tmp_path / "fits.json").path.read_text())
    assert written["conductor"]["name"] == "main/Au/Johnson"
    assert {part["distribution"] for part in written["models"] if "distribution" in part} == {"beckmann"}


def test_spectra_that_do_not_cover_all_colours_are_fitted_without_a_colour_difference(
    file: Path, tmp_path: Path
) -> None:
    database = tmp_path / "goniometer.db"
    invoke("import", file, *STATED, "--lowest", 450, "--highest", 700, "--database", database)
    told = invoke("fit", "their sample", "--model", "cook-torrance-shift", "--database", database).stdout
    assert "absolute / chromatic not known / not known" in told
    found = json.loads(Store.open(database).fits(1)[-1].text)["parameters"][0]
    assert found["value"] == pytest.approx(SAMPLES["sample-2"].alpha, rel=0.02)


def test_data_of_three_colours_say_that_they_are_no_spectra(file: Path, tmp_path: Path) -> None:
    database = tmp_path / "goniometer.db"
    known = ("--lowest", 450, "--highest", 470, "--relative-noise", 0.01)
    invoke("import", file, *STATED, *known, "--database", database)
    with pytest.raises(FitError, match="was measured at 3 wavelengths; a model of spectra needs at least 5"):
        invoke("fit", "their sample", "--database", database)
