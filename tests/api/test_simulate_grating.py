"""`goniometer simulate grating` repeats Fig. 7 of the paper and says on what it depends."""

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from api.commands.main import app
from goniometer.errors import InputError
from goniometer.storage.store import Store


def invoke(*arguments: object) -> Result:
    result = CliRunner().invoke(app, ["simulate", "grating", *map(str, arguments)])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


def test_only_spacings_that_are_even_in_d_give_the_slopes_of_the_paper() -> None:
    found = json.loads(invoke("--json").stdout)
    assert {name: one["as_the_paper"] for name, one in found["spreads"].items()} == {
        "spacing": True,
        "logarithm": False,
        "frequency": False,
    }
    spacing = found["spreads"]["spacing"]
    assert spacing["slope_per_um"][2:] == pytest.approx([1 / 0.6] * 8, abs=0.01)  # proportional to the wavelength
    assert min(spacing["r2"][2:]) > 0.999
    # the first bin holds no grating for waves longer than the largest spacing sends there
    waves, first = np.array(found["wavelengths"]), np.array(spacing["spectra"][0])
    assert (first[waves > 1e3 * 30 * np.sin(np.radians(1))] == 0).all()
    assert all(step["change"] < 0.01 for step in spacing["convergence"][-2:])
    assert found["dataset"] is None


def test_at_another_incident_angle_bins_are_counted_from_the_mirror_direction() -> None:
    found = json.loads(invoke("--incident", 10, "--largest-period", 60, "--json").stdout)
    # the bin from 1 to 2 degrees: spacings wavelength / (sin 10 - sin 8) to wavelength / (sin 10 - sin 9)
    ends = 0.6 / (np.sin(np.radians(10)) - np.sin(np.radians([8, 9])))
    share = found["spreads"]["spacing"]["spectra"][1][found["wavelengths"].index(600.0)]
    assert share == pytest.approx((ends[1] - ends[0]) / 59.8, abs=1e-3)


def test_the_brdf_of_gratings_is_a_dataset_that_keeps_its_energy_and_says_how_it_is_scaled(tmp_path: Path) -> None:
    database, page = tmp_path / "goniometer.db", tmp_path / "page.html"
    told = invoke("--database", database, "--page", page).stdout
    assert "as dataset 1" in " ".join(told.split())
    store = Store.open(database)
    dataset = store.dataset(1)
    assert store.lineage(1)["simulated"] == "gratings of 0.2 to 30 µm"
    assert "first orders" in str(store.lineage(1)["scale"])
    assert all(check.passed is not False for check in dataset.checks if check.name in ("reciprocity", "energy"))
    # f = density(d) wavelength / (2 pi r^3), d = wavelength / r, r the distance from the mirror direction
    point = np.flatnonzero((dataset.theta_in == 20) & (dataset.theta_out == 45))[0]
    r = np.sin(np.radians(45)) - np.sin(np.radians(20))
    assert dataset.brdf[point] == pytest.approx(1e-3 * dataset.wavelengths / (2 * np.pi * r**3) / 29.8, rel=2e-3)
    assert page.read_text().count("<svg") == 3


def test_gratings_that_cannot_be_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="give the smaller one first"):
        invoke("--smallest-period", 5, "--largest-period", 2, "--database", tmp_path / "none.db")
    assert not list(tmp_path.iterdir())
    nothing = json.loads(invoke("--smallest-period", 0.1, "--largest-period", 0.15, "--json").stdout)
    assert nothing["spreads"]["spacing"]["slope_per_um"] == [None] * 10
