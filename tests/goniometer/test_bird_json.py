"""The universal BRDF format of the BiRD project, in and out.

The schemas of the project are not part of this repository; where they are at hand, files are validated against them.
"""

import json
from typing import Any

import numpy as np
import pytest

from goniometer.datasets.dataset import Dataset, Flag
from goniometer.errors import DataFileError
from goniometer.files.bird_json import bird_json, read_bird_json
from goniometer.files.measured_table import MeasuredTable
from tests.bird_schemas import SCHEMAS
from tests.drawn_dataset import drawn_dataset

OWN_DATA = {"theta_i", "phi_i", "theta_r", "phi_r", "wavelength_i", "BRDF", "uBRDF"}


def dataset() -> Dataset:
    at = np.array([0.0, 0.0, 30.0, 30.0, 30.0, 30.0]), np.array([-20.0, 20.0, -60.0, 30.0, 30.0, 84.0])
    drawn = drawn_dataset("sample-3", seed=2, at=at)
    drawn.brdf[1, 3], drawn.brdf[4, 2] = np.nan, -1e-4
    drawn.flags[5] = Flag.CLIPPED
    return drawn


def read(content: dict[str, Any]) -> MeasuredTable:
    return read_bird_json("a.brdf", content)[0]


def example(**data: Any) -> dict[str, Any]:
    """Two directions at normal incidence, as the format's own documentation has it, and what `data` changes."""
    one: dict[str, Any] = {
        "wavelength_i": {"unit": "nm", "values": [550, 650, 550, 650]},
        "theta_i": {"unit": "°", "values": [0, 0, 30, 30]},
        "phi_i": {"unit": "°", "values": [0, 0, 350, 350]},
        "theta_r": {"unit": "°", "values": [10, 10, 20, 20]},
        "phi_r": {"unit": "°", "values": [60, 60, 170, 170]},
        "BRDF": {"unit": "sr^-1", "values": [0.25, 0.26, 0.31, 0.32]},
    }
    return {"metadata": {"sample": {"name": "SRT1"}}, "data": {k: v for k, v in (one | data).items() if v is not None}}


def test_numbers_of_an_exported_file_stand_in_spherical_coordinates() -> None:
    measured = dataset()
    text, notes = bird_json(measured, {})
    data = json.loads(text)["data"]
    assert set(data) == OWN_DATA
    assert notes == ["26 of 144 values are not in the file, which knows no flags and nothing below zero."]
    assert {len(part["values"]) for part in data.values()} == {118}
    assert [data[name]["unit"] for name in ("theta_i", "BRDF", "wavelength_i")] == ["deg", "sr^-1", "nm"]
    directions = list(zip(*(data[name]["values"] for name in ("theta_i", "phi_i", "theta_r", "phi_r")), strict=True))
    assert list(dict.fromkeys(directions)) == [
        *((0, 0, 20, 0), (0, 0, 20, 180)),
        *((30, 0, 60, 0), (30, 0, 30, 180)),
    ]
    assert data["BRDF"]["values"][:24] == measured.brdf[0].tolist()
    assert data["uBRDF"]["values"][:24] == measured.u[0].tolist()


def test_an_exported_file_comes_back_with_its_repeats_and_its_uncertainties() -> None:
    measured = dataset()
    table = read(json.loads(bird_json(measured, {})[0]))
    # of two repeats of one direction, the value that one lacks is that of the other, for the file does not number them
    assert np.array_equal(table.theta_in, [0, 0, 30, 30, 30])
    assert np.array_equal(table.theta_out, [-20, 20, -60, 30, 30])
    assert np.array_equal(table.brdf[:3], measured.brdf[:3], equal_nan=True)
    assert table.u is not None
    assert np.array_equal(table.u[:3], measured.u[:3], equal_nan=True)


def test_directions_of_others_get_the_sign_of_their_side_whatever_their_azimuth_and_unit() -> None:
    table = read(example())
    assert np.array_equal(np.stack([table.theta_in, table.theta_out]), [[0, 30], [-10, 20]])
    assert np.array_equal(table.brdf, [[0.25, 0.26], [0.31, 0.32]])
    turned = {
        "theta_i": {"unit": "rad", "values": [0, 0, np.pi / 6, np.pi / 6]},
        "wavelength_i": None,
        "wavelength_r": {"unit": "μm", "values": [0.55, 0.65, 0.55, 0.65]},
    }
    same = read(example(**turned))
    assert np.allclose(same.theta_in, [0, 30])
    assert np.allclose(same.wavelengths, [550, 650])


def test_an_uncertainty_in_per_cent_is_a_part_of_the_value() -> None:
    by_value = read(example(uBRDF={"unit": "%", "values": [1, 2, 3, 4]}))
    assert by_value.u is not None
    assert np.allclose(by_value.u, [[0.0025, 0.0052], [0.0093, 0.0128]])
    for_all = read(example(BRDF=example()["data"]["BRDF"] | {"uncertainty": {"value": 0.01, "unit": "1/sr"}}))
    assert for_all.u is not None
    assert np.allclose(for_all.u, 0.01)
    assert read(example()).u is None


def test_two_orthogonal_polarisations_are_natural_light_and_one_alone_is_not() -> None:
    twice = {name: part | {"values": part["values"][:2] * 2} for name, part in example()["data"].items()}
    both = twice | {
        "BRDF": {"unit": "1/sr", "values": [0.2, 0.3, 0.4, 0.7]},
        "polarization_i": {"notation": "sp", "values": ["s", "s", "p", "p"]},
    }
    assert np.allclose(read({"data": both}).brdf, [[0.3, 0.5]])
    stokes = {"notation": "inStokes", "values": [[1, 1, 0, 0], [1, 1, 0, 0], [1, -1, 0, 0], [1, -1, 0, 0]]}
    assert np.allclose(read({"data": both | {"polarization_i": stokes}}).brdf, [[0.3, 0.5]])
    for states in (["s"] * 4, ["s", "p", "s", "p"], ["u", "s", "p", "p"], [[1, 0, 0, 1]] * 4):
        with pytest.raises(DataFileError, match="polarization_i must be natural light"):
            read({"data": both | {"polarization_i": {"values": states}}})


def test_a_simulation_of_others_stays_a_simulation() -> None:
    metadata = {"method": "simulation", "software": {"name": "Raytracer"}, "sample": {"name": "SRT1"}}
    lineage = read_bird_json("a", {"metadata": metadata, "data": example()["data"]})[2]
    assert lineage["simulated"] == "by others: Raytracer"
    assert "simulated" not in read_bird_json("a", example())[2]


@pytest.mark.parametrize(
    ("change", "wanted"),
    [
        ({"theta_r": None}, "theta_r is missing"),
        ({"wavelength_i": None}, "no wavelength_i and no wavelength_r"),
        ({"wavelength_r": {"unit": "nm", "values": [550, 650, 550, 660]}}, "fluorescence"),
        ({"BRDF": {"unit": "%", "values": [1, 2, 3, 4]}}, "must be one of 1/sr"),
        ({"BRDF": {"unit": "1/sr", "values": [1, 2, 3]}}, "different lengths"),
        ({"BRDF": {"unit": "1/sr", "values": [1, 2, 3, "4"]}}, "nothing but numbers"),
        ({"BRDF": {"unit": "1/sr", "values": [1, 2, 3, 10**400]}}, "too large"),
        ({"BRDF": {"unit": ["1/sr"], "values": [1, 2, 3, 4]}}, "must be one of"),
        (
            {"phi_r": {"unit": "°", "values": [90, 90, 90, 90]}, "theta_i": {"unit": "°", "values": [9] * 4}},
            "no direct",
        ),
        ({"polarization_r": {"values": ["s"] * 4}}, "polarization_r is not natural light"),
        ({"adhoc_variables": {"width": {"values": [1, 1, 2, 2]}}}, "differ in width"),
        ({"adhoc_variables": [1]}, "adhoc_variables must be an object"),
    ],
)
def test_a_file_that_cannot_be_meant_is_refused_with_what_is_wrong(change: dict[str, Any], wanted: str) -> None:
    with pytest.raises(DataFileError, match=wanted):
        read(example(**change))


def test_the_projects_own_example_is_read() -> None:
    if SCHEMAS is None:
        pytest.skip("the schemas of the BiRD project are not at hand")
    table = read(json.loads((SCHEMAS / "example.brdf").read_text()))
    assert np.array_equal(table.wavelengths, [550, 650, 750, 850])
    assert np.allclose(table.brdf, [[0.2585, 0.27, 0.288, 0.2985]])


def test_a_file_that_a_simulation_of_ours_became_says_which_one() -> None:
    metadata = {"method": "simulation", "software": {"name": "goniometer", "simulation_model": {"name": "rays"}}}
    assert read_bird_json("a", {"metadata": metadata, "data": example()["data"]})[2]["simulated"] == "by others: rays"
