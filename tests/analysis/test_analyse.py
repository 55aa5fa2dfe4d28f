"""One call gives all fits of a sample, in the promised order, with colour differences that make sense."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from analysis.fits.analyse import analyse
from analysis.fits.noise import at_wavelength
from analysis.results import SampleAnalysis
from goniometer.datasets.dataset import Dataset, Flag


@pytest.fixture(scope="module")
def dataset(measure: Callable[..., Dataset]) -> Dataset:
    """Sample 4 of the bench with two saturated points, one of them with a gap."""
    made = measure(0.18, 1.2, 3.4)
    brdf, flags = made.brdf.copy(), made.flags.copy()
    flags[[40, 41]] = Flag.SATURATED
    brdf[40, 10:30] = np.nan
    return replace(made, brdf=brdf, flags=flags)


@pytest.fixture(scope="module")
def analysis(dataset: Dataset) -> SampleAnalysis:
    """All fits of it."""
    return analyse(dataset)


def test_all_fits_are_there_in_order_and_trusted(analysis: SampleAnalysis) -> None:
    assert [m.model for m in analysis.models] == ["global", "cook-torrance", "cook-torrance-shift"]
    assert set(analysis.differences) == {"local", "global", "cook-torrance", "cook-torrance-shift"}
    assert all(m.verdict.trusted for m in analysis.models)
    points = analysis.dataset.flags.size
    said = f"2 of {points} points are left out of all fits: saturated at the shortest integration time."
    assert all(said in m.verdict.reasons for m in analysis.models)


def test_the_shift_explains_the_colour_that_cook_torrance_cannot(analysis: SampleAnalysis) -> None:
    chromatic = {name: d.statistics("chromatic") for name, d in analysis.differences.items()}
    absolute = {name: d.statistics() for name, d in analysis.differences.items()}
    # the paper's local fit stays below the just noticeable difference of 1, and slopes of 1/um give more than 5
    assert chromatic["local"]["p95"] < 1
    assert chromatic["cook-torrance-shift"]["p95"] < 1
    assert chromatic["global"]["mean"] < 1
    assert chromatic["cook-torrance"]["mean"] > 3
    assert absolute["cook-torrance"]["mean"] > 10 * absolute["cook-torrance-shift"]["mean"]


def test_a_gap_leaves_a_point_without_colour_only_where_the_gap_is(analysis: SampleAnalysis) -> None:
    for differences in analysis.differences.values():
        assert np.flatnonzero(np.isnan(differences.absolute)).tolist() == [40]


def test_the_same_data_give_the_same_numbers(dataset: Dataset, analysis: SampleAnalysis) -> None:
    again = analyse(dataset)
    assert [m.parameters for m in again.models] == [m.parameters for m in analysis.models]


def test_a_spectrum_that_drowns_in_noise_has_no_hue_to_compare(measure: Callable[..., Dataset]) -> None:
    dataset = measure(0.113, 0.9, 4.5, floor=2e-3, wavelength_step=9.2)
    f, u = at_wavelength(dataset, 600.0)  # all its errors are those of counts
    assert 5 < np.count_nonzero(f <= 20 * u) < f.size - 50
    for differences in analyse(dataset).differences.values():
        np.testing.assert_array_equal(np.isnan(differences.chromatic), f <= 20 * u)
        assert np.isfinite(differences.absolute).all()
