"""A dataset that lies on the bench as a table is what it was, also between its directions, and says where it ends."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from analysis.reflectance.directions import round_aperture
from drivers.arrays import FloatArray
from goniometer.datasets.dataset import Dataset, Flag
from simulators.computed import Computed, computed_dataset
from simulators.errors import UnfitTable, UnknownMaterial
from simulators.materials.materials import SAMPLES, material, true_brdf
from simulators.materials.tabulated import Tabulated, check_reach, tabulated_brdf
from simulators.materials.tabulated_file import read_tabulated, write_tabulated
from tests.drawn_dataset import drawn_dataset

NM = np.arange(400.0, 801, 50)
ROUGH = SAMPLES["sample-4"]


def simulated(incident: FloatArray, theta_out: FloatArray, aperture: float = 1.0, name: str = "sample-4") -> Dataset:
    """A known material as a simulation without noise."""
    at = [a.ravel() for a in np.meshgrid(incident, theta_out, indexing="ij")]
    brdf = true_brdf(SAMPLES[name], at[0], at[1], NM, aperture)
    nothing = np.zeros_like(brdf)
    lineage: dict[str, object] = {"simulated": f"formula of {name}"}
    return computed_dataset(Computed("Formula", at[0], at[1], NM, brdf, nothing, nothing, aperture, lineage))


def tabulated(path: Path, dataset: Dataset) -> Tabulated:
    write_tabulated(path, dataset)
    return read_tabulated(path)


@pytest.fixture(scope="module")
def every_five(tmp_path_factory: pytest.TempPathFactory) -> Tabulated:
    """Sample 4 every 5 degrees of theta_in and 2.5 of theta_out, through the aperture."""
    path = tmp_path_factory.mktemp("table") / "formula.npz"
    return tabulated(path, simulated(np.arange(0.0, 81, 5), np.arange(-85.0, 85.1, 2.5)))


def directions(count: int = 300) -> tuple[FloatArray, FloatArray]:
    random = np.random.default_rng(1)
    return random.uniform(0, 80, count), random.uniform(-80, 80, count)


def test_what_was_simulated_lies_on_the_bench_in_its_own_directions(every_five: Tabulated) -> None:
    theta_in, theta_out = np.array([0.0, 35, 35, 80]), np.array([-2.5, 35, -85, 82.5])
    np.testing.assert_allclose(
        true_brdf(every_five, theta_in, theta_out, NM), true_brdf(ROUGH, theta_in, theta_out, NM)
    )
    assert every_five.filled == 0
    assert every_five.name == "Formula"


def test_between_its_directions_a_table_is_the_material_to_half_a_per_cent(every_five: Tabulated) -> None:
    theta_in, theta_out = directions()
    wavelengths = np.array([425.0, 610.0, 775.0])
    off = (
        true_brdf(every_five, theta_in, theta_out, wavelengths) / true_brdf(ROUGH, theta_in, theta_out, wavelengths) - 1
    )
    assert np.sqrt(np.mean(off**2)) < 0.005
    assert np.quantile(np.abs(off), 0.95) < 0.005


def test_a_lobe_between_two_incident_angles_stands_in_the_mirror_direction_and_is_as_high(
    every_five: Tabulated,
) -> None:
    theta_out = np.arange(30.0, 46, 0.25)
    seen = true_brdf(every_five, np.full(theta_out.size, 37.5), theta_out, np.array([600.0]))[:, 0]
    true = true_brdf(ROUGH, np.full(theta_out.size, 37.5), theta_out, np.array([600.0]))[:, 0]
    np.testing.assert_allclose(seen, true, rtol=0.007)
    assert theta_out[seen.argmax()] == pytest.approx(theta_out[true.argmax()], abs=1.25)  # half a step of the table


def test_a_stage_that_stands_a_little_below_zero_sees_the_plane_turned_by_half_a_turn(every_five: Tabulated) -> None:
    theta_in, theta_out = np.array([5.0, 0.01]), np.array([30.0, -20.0])
    there = tabulated_brdf(every_five, theta_in, theta_out, NM)
    np.testing.assert_allclose(tabulated_brdf(every_five, -theta_in, -theta_out, NM), there, rtol=1e-6)
    # and nothing jumps where the sign changes
    below, above = (tabulated_brdf(every_five, np.array([t]), np.array([25.0]), NM) for t in (-1e-4, 1e-4))
    np.testing.assert_allclose(below, above, rtol=1e-4)


@pytest.mark.parametrize("name", ["sample-1", "sample-8"])
def test_a_table_without_aperture_is_seen_through_that_of_the_detector(name: str, tmp_path: Path) -> None:
    table = tabulated(tmp_path / "point.npz", simulated(np.array([0.0, 30, 60]), np.arange(-85.0, 86), 0.0, name))
    theta_in, theta_out = np.array([0.0, 30, 30, 60, 60]), np.array([0.0, 30.0, 34.5, 60, -20])
    for aperture in (1.0, 4.0):
        seen = true_brdf(table, theta_in, theta_out, NM, aperture)
        np.testing.assert_allclose(seen, true_brdf(SAMPLES[name], theta_in, theta_out, NM, aperture), rtol=0.01)
    # one that is an average already is not averaged again
    average = replace(table, aperture=1.0)
    once = tabulated_brdf(average, theta_in, theta_out, NM)
    np.testing.assert_array_equal(tabulated_brdf(average, theta_in, theta_out, NM, round_aperture(4.0)), once)


def test_beyond_its_ends_a_table_is_held_and_below_the_horizon_it_is_dark(every_five: Tabulated) -> None:
    at = np.array([20.0, 20, 20, 20]), np.array([85.0, 89, 91, -95])
    seen = true_brdf(every_five, *at, np.array([300.0, 400, 800, 1040]))
    np.testing.assert_array_equal(seen[2:], 0)
    np.testing.assert_allclose(seen[1], seen[0])
    np.testing.assert_allclose(seen[0, [0, 3]], seen[0, [1, 2]])


def test_a_scan_lies_on_the_bench_with_its_blocked_sector_filled_and_counted(tmp_path: Path) -> None:
    scan = drawn_dataset("sample-4", zeros=(0.0, 0.0), reference_error=0.0)
    table = tabulated(tmp_path / "scan.npz", scan)
    assert table.filled > 300
    assert max(np.diff(row.theta_out).max() for row in table.rows) < 3.01
    theta_in = np.repeat([20.0, 40, 60], 5)
    theta_out = np.array([-4.0, -2, 0, 2, 4] * 3) - theta_in
    off = true_brdf(table, theta_in, theta_out, scan.wavelengths) / true_brdf(
        ROUGH, theta_in, theta_out, scan.wavelengths
    )
    assert np.sqrt(np.mean((off - 1) ** 2)) < 0.01


def test_flagged_points_stay_out_and_missing_wavelengths_are_filled(tmp_path: Path) -> None:
    scan = drawn_dataset("sample-4", zeros=(0.0, 0.0), reference_error=0.0)
    spoilt = np.flatnonzero((scan.theta_in == 40) & (np.abs(scan.theta_out - 50) < 12))
    brdf, flags = scan.brdf.copy(), scan.flags.copy()
    brdf[spoilt[0]], flags[spoilt[0]] = 99.0, int(Flag.SATURATED)
    brdf[spoilt[1], 3] = np.nan
    table = tabulated(tmp_path / "spoilt.npz", replace(scan, brdf=brdf, flags=flags))
    at = scan.theta_in[spoilt[:2]], scan.theta_out[spoilt[:2]]
    seen, true = (true_brdf(each, *at, scan.wavelengths) for each in (table, ROUGH))
    np.testing.assert_allclose(seen, true, rtol=0.03)


def test_the_same_dataset_is_the_same_file_and_says_which_it_was(tmp_path: Path) -> None:
    dataset = simulated(np.array([0.0, 40]), np.arange(-80.0, 81, 2))
    for name in ("one.npz", "two.npz"):
        write_tabulated(tmp_path / name, dataset)
    assert (tmp_path / "one.npz").read_bytes() == (tmp_path / "two.npz").read_bytes()
    origin = read_tabulated(tmp_path / "one.npz").origin
    assert origin == {"dataset_sha256": dataset.content_hash, "simulated": "formula of sample-4"}


def test_a_dataset_of_single_directions_is_refused(tmp_path: Path) -> None:
    dataset = simulated(np.array([0.0, 40]), np.arange(-80.0, 81, 2))
    few = replace(dataset, flags=np.where((dataset.theta_in == 40) & (dataset.theta_out != 40), 1, 0).astype(np.uint16))
    with pytest.raises(UnfitTable, match=r"one usable direction at theta_in = 40\.0 deg; a material needs two"):
        write_tabulated(tmp_path / "few.npz", few)


def test_another_file_in_the_place_of_a_material_is_noticed_and_a_wrong_one_named(tmp_path: Path) -> None:
    path = tmp_path / "disc.npz"
    table = tabulated(path, simulated(np.array([0.0, 40]), np.arange(-80.0, 81, 2)))
    assert material(f"file:{path}#sha256={table.sha256};nm=400.0-800.0").name == "Formula"
    with pytest.raises(UnknownMaterial, match=r"disc\.npz: the material is not the one that the campaign began with"):
        material(f"file:{path}#sha256={'0' * 64};nm=400.0-800.0")
    with pytest.raises(UnfitTable, match=r"none\.npz: the material cannot be read"):
        material(f"file:{tmp_path / 'none.npz'}")
    with np.load(path) as stored:
        arrays = dict(stored)
    spoilt: dict[str, bytes | dict[str, Any]] = {
        "no .npz file": b"theta_in,theta_out\n",
        "cut off": path.read_bytes()[:900],
        "its format is": {"format": "goniometer material 2"},
        "do not go together": {"brdf": arrays["brdf"][:-1]},
        "those of no BRDF": {"brdf": -arrays["brdf"]},
        "do not ascend": {"theta_out": arrays["theta_out"][::-1]},
        "its origin": {"origin": json.dumps([1])},
    }
    for words, change in spoilt.items():
        if isinstance(change, bytes):
            path.write_bytes(change)
        else:
            np.savez(path, **{**arrays, **change})
        with pytest.raises(UnfitTable, match=r"disc\.npz: holds no material") as refused:
            read_tabulated(path)
        assert "\n" not in str(refused.value)
        if words != "cut off":
            assert words in str(refused.value)


def test_a_campaign_may_not_ask_for_directions_that_would_be_invented(every_five: Tabulated) -> None:
    check_reach(every_five, (0.0, 45.0, 80.0), (-85.0, 85.0))
    with pytest.raises(UnfitTable, match="from 0 to 80 deg, and not at 82 deg"):
        check_reach(every_five, (82.0,), (-85.0, 85.0))
    narrow = replace(every_five, rows=tuple(replace(r, theta_out=r.theta_out * 0.8) for r in every_five.rows))
    with pytest.raises(UnfitTable, match="from -68 to 68 deg, and not up to -85 and 85 deg; set outgoing"):
        check_reach(narrow, (0.0,), (-85.0, 85.0))
