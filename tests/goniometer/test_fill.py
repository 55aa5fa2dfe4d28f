"""What is filled holds the truth within its uncertainty, says where it comes from, and is never a measurement."""

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest

from drivers.arrays import FloatArray
from goniometer.datasets.dataset import Dataset, Flag
from goniometer.datasets.fill import Filled, fill, unmeasured
from goniometer.geometry import BLOCKED_HALF_WIDTH
from goniometer.plans.plan import next_points
from goniometer.plans.plan_spec import PlanSpec
from goniometer.uncertainty import ErrorSource, everywhere
from simulators.materials.materials import SAMPLES, true_brdf
from tests.benchmarks.sampling import measure
from tests.benchmarks.sampling_materials import MATERIALS
from tests.benchmarks.sector import WAVELENGTHS, dataset_of
from tests.drawn_dataset import directions, drawn_dataset

SPEC = PlanSpec((0.0, 20.0, 40.0, 60.0))


def truth_of(filled: Filled, name: str = "sample-4") -> FloatArray:
    return true_brdf(SAMPLES[name], filled.theta_in, filled.theta_out, filled.wavelengths, spot=0)


def short_of(dataset: Dataset, keep: FloatArray) -> Dataset:
    """The dataset without the points that are not to be kept."""
    some = np.flatnonzero(keep)
    sources = tuple(
        dataclasses.replace(s, values=s.values[some], groups=None if s.groups is None else s.groups[some])
        for s in dataset.sources
    )
    return dataclasses.replace(
        dataset,
        theta_in=dataset.theta_in[some],
        theta_out=dataset.theta_out[some],
        brdf=dataset.brdf[some],
        sources=sources,
        flags=dataset.flags[some],
    )


@pytest.fixture(scope="module")
def one_sided() -> Dataset:
    """Sample 4 from a campaign whose outgoing range begins at -40 degrees, one of its points without a value."""
    at = directions(SAMPLES["sample-4"].alpha)
    kept = at[1] >= -40
    whole = drawn_dataset("sample-4", seed=3, at=(at[0][kept], at[1][kept]))
    lost = (whole.theta_in == 40) & (np.abs(whole.theta_out - 60) < 0.1)
    brdf, flags = whole.brdf.copy(), whole.flags.copy()
    brdf[lost] = np.nan
    flags[lost] |= int(Flag.BEYOND_REFERENCE)
    sources = tuple(dataclasses.replace(s, values=np.where(lost[:, None], 0.0, s.values)) for s in whole.sources)
    return dataclasses.replace(whole, brdf=brdf, flags=flags, sources=sources)


@pytest.fixture(scope="module")
def filled(one_sided: Dataset) -> Filled:
    return fill(one_sided, *unmeasured(one_sided, 2.5))


def test_a_direction_beyond_the_range_is_filled_by_its_reverse_and_names_the_points(
    one_sided: Dataset, filled: Filled
) -> None:
    beyond = np.flatnonzero(filled.theta_out < -45)
    by = np.array(filled.by)[beyond]
    assert set(by) == {"reciprocity", "nothing"}
    known = beyond[by == "reciprocity"]
    # 10, -70 goes back 70, -10 went; 70, -50 would need 50, -70, where nobody looked
    assert {(10.0, -70.0), (0.0, -80.0), (40.0, -50.0)} <= set(
        zip(filled.theta_in[known].tolist(), filled.theta_out[known].tolist(), strict=True)
    )
    for i in known:
        assert np.all(np.abs(one_sided.theta_in[list(filled.points[i])] - abs(filled.theta_out[i])) < 0.05)
    z = (filled.brdf[known] - truth_of(filled)[known]) / filled.u[known]
    assert np.mean(np.abs(z) < 2) > 0.9
    assert np.all(filled.u[known] < 0.1 * filled.brdf[known])


def test_beyond_the_range_nothing_is_extrapolated(filled: Filled) -> None:
    nothing = np.array([by == "nothing" for by in filled.by])
    assert nothing.any()
    assert np.all(np.isnan(filled.brdf[nothing]))
    assert not np.any(filled.tells[nothing])
    # the sector of theta_in = 60 lies beyond -40 degrees altogether
    assert np.all(nothing[(filled.theta_in == 60) & (filled.theta_out < -45)])
    assert all(not points for points, none in zip(filled.points, nothing, strict=True) if none)


def test_a_point_without_a_value_is_filled_and_the_dataset_still_says_that_it_has_none(
    one_sided: Dataset, filled: Filled
) -> None:
    (lost,) = np.flatnonzero((filled.theta_in == 40) & (np.abs(filled.theta_out - 60) < 0.1))
    assert np.all(np.abs(filled.brdf[lost] - truth_of(filled)[lost]) < 3 * filled.u[lost])
    assert np.isnan(one_sided.brdf[(one_sided.theta_in == 40) & (np.abs(one_sided.theta_out - 60) < 0.1)]).all()
    assert not isinstance(filled, Dataset)


def test_an_error_of_the_reference_is_an_error_of_all_that_is_filled() -> None:
    whole = drawn_dataset("sample-1", seed=1)
    known = fill(whole, *unmeasured(whole, 5.0))
    without = tuple(s for s in whole.sources if s.part != "reference")
    panel = 0.05 * whole.brdf
    worse = dataclasses.replace(
        whole, sources=(*without, ErrorSource("panel", "reference", panel, everywhere(len(panel)), True))
    )
    doubted = fill(worse, *unmeasured(worse, 5.0))
    inside = known.tells & (np.abs(known.theta_in + known.theta_out) < BLOCKED_HALF_WIDTH)
    more = doubted.u[inside] ** 2 - known.u[inside] ** 2
    assert np.sqrt(more) / known.brdf[inside] == pytest.approx(np.sqrt(0.05**2 - 0.01**2), rel=0.03)


def test_pairs_that_break_reciprocity_make_what_it_fills_uncertain() -> None:
    whole = drawn_dataset("sample-4", seed=5)
    kept = short_of(whole, whole.theta_out > -45)
    skewed = dataclasses.replace(kept, brdf=kept.brdf * np.where(kept.theta_in > 45, 1.2, 1.0)[:, None])
    at = np.array([10.0, 20.0]), np.array([-60.0, -70.0])
    sound, broken = fill(kept, *at), fill(skewed, *at)
    assert sound.by == broken.by == ("reciprocity", "reciprocity")
    assert np.all(sound.u < 0.03 * sound.brdf)
    # all pairs across 45 degrees differ by ln 1.2, and those are more than half of all
    assert np.all(broken.u > 0.1 * broken.brdf)


@pytest.mark.parametrize("width", [16.0, 8.0, 5.0])
def test_a_peak_that_rises_to_the_sector_is_within_what_is_stated_of_it(width: float) -> None:
    bump = dataclasses.replace(MATERIALS["GGX 0.126"], retro=0.02, retro_width=width)
    found, truth = _sector(bump)
    back = found.theta_in > 0
    assert np.mean(np.abs(found.brdf - truth)[back] < 2 * found.u[back]) > 0.95


def test_where_nothing_rises_to_the_sector_it_is_as_well_known_as_its_edges() -> None:
    found, truth = _sector(MATERIALS["GGX 0.126"])
    assert found.tells.all()
    assert np.all(found.u < 0.02 * found.brdf)
    assert np.mean(np.abs(found.brdf - truth) < 2 * found.u) > 0.9
    assert np.all(np.abs(found.brdf - truth) < 4 * found.u)


def test_a_mirror_that_is_known_from_other_incident_angles_is_filled_at_normal_incidence() -> None:
    whole = drawn_dataset("sample-6", seed=2)
    found = fill(whole, np.zeros(3), np.array([-0.4, 0.1, 0.6]))
    assert found.by == ("interpolation",) * 3
    truth = true_brdf(SAMPLES["sample-6"], found.theta_in, found.theta_out, found.wavelengths, spot=0)
    assert np.all(np.abs(found.brdf - truth) < 3 * found.u)
    assert found.tells.all()


def _sector(truth: Callable[[FloatArray, FloatArray, FloatArray], FloatArray]) -> tuple[Filled, FloatArray]:
    """The sectors of a dynamic scan as they are filled, and as they are."""
    random = np.random.default_rng(4)
    points = []
    while batch := next_points(SPEC, points):
        points += measure(truth, batch, random)
    dataset = dataset_of(truth, [p.geometry for p in points], random)
    found = fill(dataset, *unmeasured(dataset))
    cosine = np.cos(np.radians(found.theta_in))[:, None]
    return found, truth(found.theta_in, found.theta_out, WAVELENGTHS) / cosine
