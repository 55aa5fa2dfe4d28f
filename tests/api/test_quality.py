"""Budget, checks and a new calibration on the command line, from raw data that were measured on the simulated bench."""

import hashlib
import json
import shutil
import sqlite3
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
import typer
from typer.testing import CliRunner, Result

from api.commands.quality import register
from api.results.quality import settings_of
from drivers.interfaces import Spectrum
from goniometer.campaigns.campaign import Campaign, Integration, Sample
from goniometer.datasets.dataset import Check, Flag
from goniometer.errors import CertificateError, GeometryError, InputError, NotInStore, OptionError
from goniometer.geometry import Geometry
from goniometer.radiometry.response import CORRECTIONS
from goniometer.storage.lineage import own_datasets
from goniometer.storage.store import Store
from tests.drawn_dataset import drawn_dataset

CERTIFICATE = """# serial_number: {name}
# calibrated: {calibrated}
# valid_until: {valid_until}
wavelength_nm,reflectance,standard_uncertainty
300,{reflectance},0.002
1100,{reflectance},0.002
"""

Small = tuple[Path, dict[str, Any]]


def invoke(*arguments: object) -> Result:
    """Run a command; what it raises is for the command line to tell."""
    app = typer.Typer()
    register(app)
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


def write_certificate(path: Path, reflectance: float, valid_until: str = "2199-12-31") -> Path:
    """A certificate of one reflectance at all wavelengths."""
    text = CERTIFICATE.format(
        name=f"PANEL-{path.stem}", calibrated="2001-01-01", valid_until=valid_until, reflectance=reflectance
    )
    path.write_text(text)
    return path


@pytest.fixture
def database(tmp_path: Path) -> Path:
    """A database with one dataset and no raw data."""
    path = tmp_path / "goniometer.db"
    store = Store.open(path)
    campaign_id = store.add_campaign(Campaign(name="One", samples=(Sample(name="Sample 4", material="sample-4"),)))
    checks = Check("drift", True, "It did not."), Check("homogeneity", None, "Not measured.")
    dataset = drawn_dataset("sample-4")
    flags = dataset.flags.copy()
    flags[:3] = np.uint16(Flag.CLIPPED | Flag.BELOW_NOISE)
    store.add_dataset(store.scans(campaign_id)[1].id, replace(dataset, sample="Sample 4", checks=checks, flags=flags))
    store.close()
    return path


@pytest.fixture
def measured(small: Small, tmp_path: Path) -> Path:
    """A database of its own with the raw data of a small campaign."""
    return Path(shutil.copy(small[0] / "goniometer.db", tmp_path / "measured.db"))


def test_a_budget_is_printed_and_drawn_at_the_usual_place_with_its_coverage_factor(
    database: Path, tmp_path: Path
) -> None:
    plot, page = tmp_path / "budget.svg", tmp_path / "budget.html"
    result = invoke("budget", "sample 4", "--database", database, "--output", plot)
    assert "θ in = 40.00°, θ out = 40.00°" in result.stdout
    assert "combined (k = 1)" in result.stdout
    assert "expanded (k = 2)" in result.stdout
    ElementTree.parse(plot)
    invoke("budget", 1, "--database", database, "--output", page, "--theta-in", 60, "--wavelength", 450)
    assert "expanded, k = 2" in page.read_text()


def test_a_budget_as_json_has_the_numbers_of_the_dataset(database: Path) -> None:
    found = json.loads(invoke("budget", 1, "--database", database, "--json", "--theta-in", 20).stdout)
    dataset = Store.open(database).dataset(1)
    point = int(np.argmin(np.hypot(dataset.theta_in - 20, dataset.theta_out - 20)))
    column = int(np.argmin(np.abs(dataset.wavelengths - 600)))
    assert found["brdf"] == dataset.brdf[point, column]
    assert found["u"] == dataset.u[point, column]
    assert (found["coverage_factor"], found["expanded_uncertainty"]) == (2, 2 * found["u"])
    assert [part["name"] for part in found["parts"]] == ["random", "reference", "angle"]


def test_a_budget_where_nothing_was_measured_or_in_an_unknown_file_is_refused(database: Path) -> None:
    with pytest.raises(GeometryError, match="no value within 2°"):
        invoke("budget", 1, "--database", database, "--theta-in", 45)
    with pytest.raises(InputError, match=r"\.svg or \.html"):
        invoke("budget", 1, "--database", database, "--output", "budget.png")
    with pytest.raises(NotInStore):
        invoke("budget", 7, "--database", database)


def test_checks_are_shown_with_their_answers_and_flags_with_what_the_fits_do(database: Path) -> None:
    result = invoke("check", 1, "--database", database)
    assert result.exit_code == 0
    assert "✓ drift: It did not." in result.stdout
    assert "? homogeneity: Not measured." in result.stdout
    points = Store.open(database).dataset(1).theta_in.size
    assert f"3 of {points} points: footprint leaves the sample (left out of all fits)" in result.stdout
    assert f"3 of {points} points: below the noise (kept in fits of all points, without a slope of their own)" in (
        result.stdout
    )


def test_of_several_datasets_of_a_sample_the_newest_is_taken_and_said(database: Path) -> None:
    assert "has datasets" not in invoke("check", "sample 4", "--database", database).stderr
    store = Store.open(database)
    store.add_dataset(store.datasets()[1], store.dataset(1))
    result = invoke("check", "sample 4", "--database", database)
    assert "Dataset 2, Sample 4" in result.stdout
    assert result.stderr.splitlines() == ["Sample 4 has datasets 1 and 2; taking 2, name a number for another."]


def test_points_that_are_noisier_than_was_wanted_are_counted_and_the_worst_is_named(tmp_path: Path) -> None:
    store = Store.open(tmp_path / "noisy.db")
    integration = Integration(signal_to_noise=50.0)
    campaign = Campaign(name="One", samples=(Sample(name="Sample 4", material="sample-4"),), integration=integration)
    scan_id = store.scans(store.add_campaign(campaign))[1].id
    store.add_points(scan_id, [Geometry(10.0, out) for out in (-80.0, 10.0, 40.0)])
    spectra = [Spectrum(np.zeros(1044, dtype=np.uint32), 0.1, 1, -10.0)]
    for point, (ratio, reason) in zip(
        store.points(scan_id), ((3.21, "too dark"), (60.0, ""), (20.0, "too dark")), strict=True
    ):
        store.start_point(point.id)
        store.finish_point(point, point.geometry, spectra, "one", 0.0, 1.0, ratio, reason)
    store.add_dataset(scan_id, drawn_dataset("sample-4"))
    store.close()
    told = (
        "2 points stayed below the wanted signal-to-noise ratio, the worst at theta_in = 10 deg, theta_out = -80 deg: "
        "reached 3.21 of 50."
    )
    assert told in invoke("check", 1, "--database", tmp_path / "noisy.db").stdout.splitlines()


def test_a_measured_sample_without_a_dataset_is_calibrated_by_its_name(measured: Path, tmp_path: Path) -> None:
    old = Store.open(measured).dataset(1)
    with sqlite3.connect(measured) as database:  # as if the certificate had not served when it was measured
        for table in ("fits", "exports", "datasets"):
            database.execute(f"DROP TRIGGER {table}_no_delete")
            database.execute(f"DELETE FROM {table}")
    database.close()
    path = write_certificate(tmp_path / "new.csv", 0.97)
    told = invoke("calibrate", "sample 1", "--certificate", path, "--database", measured).stdout
    store = Store.open(measured)
    (made,) = store.datasets()
    assert f"Made dataset {made} from the raw data of scan 2, with the certificate PANEL-new." in told
    assert store.dataset(made).lineage["exposures"] == old.lineage["exposures"]
    assert store.dataset_certificate(made) == path.read_text()
    assert list(own_datasets(store, 2)) == [made]
    # what was given stays with it when it is made anew
    again = json.loads(invoke("calibrate", "sample 1", "--database", measured, "--json").stdout)
    assert (again["recalibrated_from"], again["certificate"]) == (made, "PANEL-new")


def test_a_failed_check_is_an_exit_code(database: Path) -> None:
    store = Store.open(database)
    failed = replace(store.dataset(1), checks=(Check("energy", False, "More than all."),))
    store.add_dataset(store.datasets()[1], failed)
    result = invoke("check", "Sample 4", "--database", database, "--json")
    assert result.exit_code == 1
    found = json.loads(result.stdout)
    assert (found["dataset"], found["passed"], found["checks"][0]["passed"]) == (2, False, False)


def test_calibrating_again_gives_the_same_numbers_in_a_new_dataset(measured: Path) -> None:
    before = Store.open(measured).datasets()
    found = json.loads(invoke("calibrate", 1, "--database", measured, "--json").stdout)
    store = Store.open(measured)
    assert set(store.datasets()) == {*before, found["dataset"]}
    old, new = store.dataset(1), store.dataset(found["dataset"])
    assert new.content_hash == old.content_hash
    assert new.lineage["recalibrated_from"] == 1
    certificate = store.certificate(1)
    assert certificate is not None
    digest = hashlib.sha256(certificate.encode()).hexdigest()
    assert old.lineage["certificate_sha256"] == new.lineage["certificate_sha256"] == digest
    assert new.lineage["exposures"] == old.lineage["exposures"]


def test_a_new_certificate_scales_the_brdf_by_its_reflectance(measured: Path, tmp_path: Path) -> None:
    numbers = []
    for name, reflectance in (("a", 0.96), ("b", 0.98)):
        path = write_certificate(tmp_path / f"{name}.csv", reflectance)
        found = json.loads(invoke("calibrate", 1, "--certificate", path, "--database", measured, "--json").stdout)
        assert found["certificate"] == f"PANEL-{name}"
        numbers.append(found["dataset"])
    store = Store.open(measured)
    first, second = (store.dataset(number) for number in numbers)
    valued = np.isfinite(first.brdf)
    assert second.brdf[valued] / first.brdf[valued] == pytest.approx(0.98 / 0.96, rel=1e-9)
    assert first.lineage["certificate_sha256"] != second.lineage["certificate_sha256"]


def test_an_expired_certificate_needs_a_name_and_a_reason_which_stay(measured: Path, tmp_path: Path) -> None:
    arguments = (
        "calibrate", 1, "--database", measured,
        "--certificate", write_certificate(tmp_path / "old.csv", 0.97, "2002-01-01"),
    )  # fmt: skip
    with pytest.raises(CertificateError):
        invoke(*arguments)
    with pytest.raises(InputError, match="both --override-name and --override-reason"):
        invoke(*arguments, "--override-name", "N. N.")
    with pytest.raises(InputError):
        invoke(*arguments, "--override-name", "N. N.", "--override-reason", "")
    found = json.loads(
        invoke(*arguments, "--override-name", "N. N.", "--override-reason", "panel is new", "--json").stdout
    )
    shown = invoke("check", found["dataset"], "--database", measured).stdout
    assert "N. N." in shown
    assert "panel is new" in shown


def test_an_override_of_a_certificate_that_was_valid_is_refused_and_makes_no_dataset(measured: Path) -> None:
    before = Store.open(measured).datasets()
    told = r"--override-name and --override-reason have no use for scan 2: the certificate .* was valid on the day"
    with pytest.raises(OptionError, match=told):
        invoke("calibrate", 1, "--override-name", "N. N.", "--override-reason", "no need", "--database", measured)
    assert Store.open(measured).datasets() == before


def test_a_correction_that_is_left_out_changes_the_numbers_and_is_recorded(measured: Path) -> None:
    arguments = "calibrate", 1, "--without", "non-linearity", "--with", "aperture", "--database", measured
    told = invoke(*arguments).stdout
    assert "non-linearity not made" in told
    assert "aperture made" in told
    store = Store.open(measured)
    old, new = store.dataset(1), store.dataset(max(store.datasets()))
    assert new.aperture == 0
    assert not np.allclose(old.brdf, new.brdf, rtol=1e-5, equal_nan=True)


def test_corrections_that_do_not_exist_or_contradict_are_refused() -> None:
    with pytest.raises(InputError, match='no correction "darks"; there are dark, non-linearity'):
        settings_of(["darks"], [])
    with pytest.raises(InputError, match="both with and without"):
        settings_of(["aperture"], ["aperture"])
    assert settings_of([], ["aperture"]).corrections == set(CORRECTIONS)
