"""One call gives all fits of a sample, in the promised order, with colour differences that make sense."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from analysis.analyse import analyse
from analysis.noise import noise_between_neighbours
from analysis.results import SampleAnalysis
from goniometer.dataset import Dataset


@pytest.fixture(scope="module")
def dataset(measure: Callable[..., Dataset]) -> Dataset:
    """Sample 4 of the bench with two saturated points, one of them with a gap."""
    made = measure(0.18, 1.2, 3.4)
    brdf, saturated = made.brdf.copy(), made.saturated.copy()
    saturated[[40, 41]] = True
    brdf[40, 10:30] = np.nan
    return replace(made, brdf=brdf, saturated=saturated)


@pytest.fixture(scope="module")
def analysis(dataset: Dataset) -> SampleAnalysis:
    """All fits of it."""
    return analyse(dataset)


def test_all_fits_are_there_in_order_and_trusted(analysis: SampleAnalysis) -> None:
    assert [m.model for m in analysis.models] == ["global", "cook-torrance", "cook-torrance-shift"]
    assert set(analysis.differences) == {"local", "global", "cook-torrance", "cook-torrance-shift"}
    assert all(m.verdict.trusted for m in analysis.models)
    assert all(any("2 of" in reason for reason in m.verdict.reasons) for m in analysis.models)


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


def test_noise_of_spectra_without_uncertainty_is_found_from_their_scatter(measure: Callable[..., Dataset]) -> None:
    dataset = measure(0.3, 1.5, 2.6, noise=0.01, reference=0.0, wavelength_step=4.6)
    ratio = noise_between_neighbours(dataset.brdf) / np.median(dataset.u_random, axis=1, keepdims=True)
    assert np.median(ratio) == pytest.approx(1, abs=0.05)
    gap = dataset.brdf.copy()
    gap[0] = np.nan
    noise = noise_between_neighbours(gap)
    assert np.isnan(noise[0]).all()
    assert np.isfinite(noise[1:]).all()
