"""A measured dataset leaves the house in every format, and comes back; read by others' readers."""

import csv
import hashlib
import io
import json
import os
import shutil
import subprocess
import zipfile
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pandas
import pytest
import yaml
from typer.testing import CliRunner, Result

from analysis.fits.fit_json import analysis_from_json
from api.choices import WRITTEN
from api.commands.main import app
from api.exports.formats import FORMATS, Options, export_dataset
from api.exports.texts import Published
from api.written import write_text
from goniometer.errors import InputError
from goniometer.storage.store import Store
from tests.bird_schemas import validator
from tests.drawn_dataset import drawn_dataset

ABOUT = Path(__file__).parents[2] / "docs" / "lab.yaml"
TERMS = Options(license="CC-BY-4.0", creators=("Doe, Jane", "Test laboratory"))


def invoke(*arguments: object) -> Result:
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


@pytest.fixture(scope="module")
def folder(finished: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a copy of the database of the small campaign."""
    folder = tmp_path_factory.mktemp("export")
    shutil.copy(finished / "goniometer.db", folder / "measured.db")
    return folder


@pytest.fixture(scope="module")
def store(folder: Path) -> Store:
    return Store.open(folder / "measured.db")


@pytest.mark.parametrize("to", ["hdf5", "csv", "parquet"])
def test_a_measurement_is_itself_again_in_the_database_of_another_laboratory(
    folder: Path, store: Store, to: str, tmp_path: Path
) -> None:
    file, other = tmp_path / "it", tmp_path / "other.db"
    invoke("export", 1, "--to", to, "-o", file, "-d", folder / "measured.db")
    told = invoke("import", file, "-d", other).stdout
    assert "Imported it as dataset 1, Sample 1: " in told
    mine, theirs = store.dataset(1), Store.open(other).dataset(1)
    assert theirs.content_hash == mine.content_hash
    assert (theirs.kind, theirs.checks) == ("measured", mine.checks)
    assert {name: value for name, value in theirs.lineage.items() if name != "reloaded"} == mine.lineage
    assert "measured elsewhere: Sample 1: it, dataset 1" in invoke("status", "-d", other).stdout
    with pytest.raises(InputError, match="raw data are in another database"):
        invoke("calibrate", 1, "-d", other)
    with pytest.raises(InputError, match="export it without --raw"):
        invoke("export", 1, "--to", "hdf5", "--raw", "-d", other)
    with pytest.raises(InputError, match="leave out --sample, --aperture"):
        invoke("import", file, "--sample", "mine", "--aperture", 1, "-d", other)


def test_an_export_replaces_what_it_wrote_before_and_nothing_else(
    folder: Path, store: Store, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    first = export_dataset(store, 1, "csv", None)
    assert export_dataset(store, 1, "csv", None) == first
    fits = export_dataset(store, 1, "json", None)
    kept = fits.path.read_bytes()
    with pytest.raises(InputError, match="is there already, and is not the paper that was written there of dataset 1"):
        export_dataset(store, 1, "paper", None)
    assert fits.path.read_bytes() == kept
    with first.path.open("a") as somebody:
        somebody.write("# read again on Monday\n")
    with pytest.raises(InputError, match="move it away"):
        export_dataset(store, 1, "csv", None)
    assert first.path.read_text().endswith("on Monday\n")
    Path("campaign.yaml").write_text("name: Mine\n")
    with pytest.raises(InputError, match="is not the report"):
        invoke("report", 1, "-o", "campaign.yaml", "-d", folder / "measured.db")


def test_nothing_is_written_over_a_database_a_device_or_a_pipe(folder: Path, tmp_path: Path) -> None:
    shutil.copy(folder / "measured.db", tmp_path / "mine.db")
    before = (tmp_path / "mine.db").read_bytes()
    with pytest.raises(InputError, match=r"mine\.db is a database, which nothing replaces"):
        write_text("csv", tmp_path / "mine.db", "")
    assert (tmp_path / "mine.db").read_bytes() == before
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", Path(os.devnull)):
        with pytest.raises(InputError, match="is no file"):
            write_text("csv", path, "")
        assert not path.is_file()


def test_raw_exposures_in_hdf5_are_those_of_the_database(store: Store, tmp_path: Path) -> None:
    export_dataset(store, 1, "hdf5", tmp_path / "a.h5", Options(raw=True))
    with h5py.File(tmp_path / "a.h5") as file:
        raw = file["entry/raw"]
        assert set(raw) == {"sample", "reference"}
        exposures = store.exposures(2)
        counts = raw["sample/counts"]
        assert counts.attrs["units"] == "counts"
        assert np.array_equal(counts, [exposure.counts for exposure in exposures])
        assert raw["sample/integration_time"][5] == exposures[5].integration_time
        assert [kind.decode() for kind in raw["sample/kind"]] == [exposure.kind for exposure in exposures]
        assert np.array_equal(raw["sample/wavelength"], store.constants(2).wavelengths)
        assert set(raw["sample/id"]) >= set(json.loads(file["entry/lineage"][()])["exposures"])


def test_a_fit_file_holds_every_model_that_was_ever_fitted_and_they_reload(
    folder: Path, store: Store, tmp_path: Path
) -> None:
    invoke("fit", 1, "--model", "dielectric", "-d", folder / "measured.db")
    export_dataset(store, 1, "json", tmp_path / "fits.json")
    fits = analysis_from_json((tmp_path / "fits.json").read_text())
    assert {fit.model for fit in fits} >= {"global", "cook-torrance", "cook-torrance-shift", "dielectric"}
    assert {fit.dataset_hash for fit in fits} == {store.dataset(1).content_hash}


def test_the_papers_json_comes_back_with_the_same_values(folder: Path, store: Store, tmp_path: Path) -> None:
    file = tmp_path / "points.json"
    told = invoke("export", 1, "--to", "paper", "-o", file, "-d", folder / "measured.db").stdout
    assert "neither uncertainties nor flags" in told
    first, *points = json.loads(file.read_text())
    dataset = store.dataset(1)
    assert first == {"wavelengths": dataset.wavelengths.tolist()}
    assert {point["phiOut"] for point in points} <= {0, 180}
    stated = ("--relative-uncertainty", 0.01, "--aperture", 1, "--angle-uncertainty", 0.01)
    invoke("import", file, *stated, "-d", tmp_path / "other.db")
    back = Store.open(tmp_path / "other.db").dataset(1)
    order = np.lexsort((dataset.theta_out, dataset.theta_in))
    assert np.allclose(back.theta_out, dataset.theta_out[order], atol=1e-9)
    assert np.array_equal(back.brdf, dataset.brdf[order], equal_nan=True)


@pytest.mark.parametrize(("dataset_id", "said"), [(2, None), (1, ABOUT)])
def test_a_universal_brdf_file_is_valid_under_the_schemas_of_its_project(
    store: Store, tmp_path: Path, dataset_id: int, said: Path | None
) -> None:
    written = export_dataset(store, dataset_id, "bird", tmp_path / "a.brdf", Options(about=said))
    content = json.loads((tmp_path / "a.brdf").read_text())
    metadata = content["metadata"]
    assert metadata["method"] == "measurement"
    assert metadata["sample"]["dimensions"] == {"diameter": {"value": 50.0, "unit": "mm"}}
    assert ("Not stated" in " ".join(written.notes)) == (said is None)
    assert metadata["environment"] == "NA" or metadata["environment"]["temperature"] == {"value": 23.0, "unit": "°C"}
    errors = [error.message for error in validator().iter_errors(content)]
    assert errors == []


def test_what_a_person_says_beside_the_point_is_refused_before_it_is_in_a_file(store: Store, tmp_path: Path) -> None:
    for text, wanted in [
        ("- a", "must be a mapping"),
        ("id: mine", '"id" is not asked for'),
        ("a: [", "not valid YAML"),
        ("instrumentation: {illumination_system: {}}", "needs illumination_system.source.type"),
    ]:
        (tmp_path / "lab.yaml").write_text(text)
        with pytest.raises(InputError, match=wanted):
            export_dataset(store, 1, "bird", tmp_path / "a.brdf", Options(about=tmp_path / "lab.yaml"))
    assert not (tmp_path / "a.brdf").exists()


@pytest.fixture(scope="module")
def package(store: Store, folder: Path) -> Path:
    """The unpacked zip of a package with one attached file."""
    (folder / "photo.tif").write_bytes(b"a picture")
    options = Options(license=TERMS.license, creators=TERMS.creators, attached=(folder / "photo.tif",))
    written = export_dataset(store, 1, "package", folder / "one.zip", options)
    assert written.notes[0].startswith("data/brdf.brdf: Not stated")
    with zipfile.ZipFile(folder / "one.zip") as archive:
        archive.extractall(folder / "unpacked")
    return folder / "unpacked" / "one"


def test_a_package_holds_all_there_is_and_sha256sum_finds_it_whole(package: Path) -> None:
    files = {str(path.relative_to(package)) for path in package.rglob("*") if path.is_file()}
    fits = {name for name in files if name.startswith("fits/")}
    assert fits >= {"fits/analysis.json", "fits/sample-1.bsdf"}
    assert files - fits == {
        *("README.md", "LICENSE.txt", "CITATION.cff", "datapackage.json", "SHA256SUMS", "report.html"),
        *("data/brdf.h5", "data/brdf.csv", "data/brdf.brdf", "data/campaign.json", "data/certificate.csv"),
        "attached/photo.tif",
    }
    done = subprocess.run(
        ["sha256sum", "--strict", "-c", "SHA256SUMS"], cwd=package, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count(": OK") == len(files) - 1
    with h5py.File(package / "data/brdf.h5") as file:
        assert set(file["entry/raw"]) == {"sample", "reference"}


def test_a_machine_finds_in_a_package_what_each_file_is_and_who_made_it(package: Path) -> None:
    told = json.loads((package / "datapackage.json").read_text())
    # what the Data Package standard demands: names in lower case, one of path and data, and hashes with their kind
    assert told["licenses"] == [
        {
            "name": "CC-BY-4.0",
            "title": "Creative Commons Attribution 4.0",
            "path": "https://creativecommons.org/licenses/by/4.0/",
        }
    ]
    for resource in told["resources"]:
        content = (package / resource["path"]).read_bytes()
        assert set(resource["name"]) <= set("abcdefghijklmnopqrstuvwxyz0123456789./_-")
        assert (resource["bytes"], resource["hash"]) == (
            len(content),
            f"sha256:{hashlib.sha256(content).hexdigest()}",
        )
    (table,) = (resource for resource in told["resources"] if resource["path"] == "data/brdf.csv")
    frame = pandas.read_csv(package / "data/brdf.csv", comment=table["dialect"]["commentChar"])
    assert [field["name"] for field in table["schema"]["fields"]] == list(frame.columns)
    lines = (package / "data/brdf.csv").read_text().split("\n")
    header = next(csv.reader(io.StringIO(next(line for line in lines if not line.startswith("#")))))
    assert header == list(frame.columns)


def test_a_package_says_how_to_cite_it(package: Path) -> None:
    cited = yaml.safe_load((package / "CITATION.cff").read_text())
    assert (cited["cff-version"], cited["type"], cited["license"]) == ("1.2.0", "dataset", "CC-BY-4.0")
    assert cited["authors"] == [{"family-names": "Doe", "given-names": "Jane"}, {"name": "Test laboratory"}]
    # the standard wants a text, not what YAML makes of a bare date
    assert isinstance(cited["date-released"], str)
    assert {"message", "title", "abstract", "keywords"} <= set(cited)
    assert "SPDX-License-Identifier: CC-BY-4.0" in (package / "LICENSE.txt").read_text()


def test_the_same_dataset_gives_the_same_package_as_a_folder_too(package: Path, store: Store, tmp_path: Path) -> None:
    options = Options(license=TERMS.license, creators=TERMS.creators, attached=(package / "attached/photo.tif",))
    again = export_dataset(store, 1, "package", tmp_path / "one", options)
    paths = {path.relative_to(package) for path in package.rglob("*") if path.is_file()}
    assert paths == {path.relative_to(again.path) for path in again.path.rglob("*") if path.is_file()}
    for path in paths:
        assert (package / path).read_bytes() == (again.path / path).read_bytes(), path
    assert again.sha256 == hashlib.sha256((package / "SHA256SUMS").read_bytes()).hexdigest()
    with pytest.raises(InputError, match="is there already"):
        export_dataset(store, 1, "package", tmp_path / "one", options)


def test_a_dataset_that_cannot_be_fitted_is_published_without_fits_and_the_package_says_why(tmp_path: Path) -> None:
    store = Store.open(tmp_path / "a.db")
    three = drawn_dataset("sample-1").at_points(np.arange(20)).at_wavelengths(slice(0, 3))
    dataset_id = store.add_dataset(None, replace(three, lineage={"imported": "theirs.csv"}))
    written = export_dataset(store, dataset_id, "package", tmp_path / "it", TERMS)
    notes = " ".join(written.notes)
    assert "fits/analysis.json is not in the package: " in notes
    assert "needs at least 5" in notes
    assert "Raw exposures are not in the package" in (written.path / "README.md").read_text()
    assert not (written.path / "fits").exists()
    done = subprocess.run(["sha256sum", "-c", "SHA256SUMS"], cwd=written.path, capture_output=True, check=False)
    assert done.returncode == 0


def test_terms_that_nobody_can_mean_are_refused_before_anything_is_computed(store: Store, tmp_path: Path) -> None:
    for options, wanted in [
        (Options(creators=("Doe, Jane",)), "needs terms"),
        (Options(license="CC-BY-4.0"), "needs terms"),
        (Options(license="CC-BY", creators=("Doe, Jane",)), '"CC-BY" is no licence'),
        (Options(license="CC-BY-4.0", creators=(" , ",)), "has no name"),
        (Options(license="CC-BY-4.0", creators=("A",), attached=(tmp_path / "no",)), "cannot be read"),
        (Options(license="CC-BY-4.0", creators=("A",), raw=True), "no use for --raw"),
    ]:
        with pytest.raises(InputError, match=wanted):
            export_dataset(store, 1, "package", tmp_path / "a.zip", options)
    with pytest.raises(InputError, match="no use for --license, --creator"):
        export_dataset(store, 1, "csv", tmp_path / "a.csv", TERMS)
    with pytest.raises(InputError, match='no format "xml"; there are json, hdf5'):
        export_dataset(store, 1, "xml")
    assert not list(tmp_path.iterdir())
    assert Published("CC0-1.0", ("A",), "2026-01-01T00:00:00+00:00").license == "CC0-1.0"


def test_every_format_is_in_the_help_with_what_it_holds() -> None:
    told = " ".join(invoke("export", "--help").stdout.replace("│", " ").split())
    assert set(WRITTEN) == set(FORMATS)
    for name, about in WRITTEN.items():
        assert f"{name}: {about}" in told
