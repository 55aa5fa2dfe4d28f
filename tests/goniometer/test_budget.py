"""A budget adds up, names what it is made of, and agrees with another program about what errors share."""

from dataclasses import replace

import numpy as np
import pytest
from uncertainties import covariance_matrix, ufloat

from goniometer.datasets.budget import budget, by_part, nearest_point, usual_direction
from goniometer.datasets.dataset import Dataset
from goniometer.errors import GeometryError, InputError
from goniometer.uncertainty import PARTS, ErrorSource, covariance_by_source, everywhere, variance
from tests.drawn_dataset import drawn_dataset

SHAPE = (4, 3)


def small_dataset() -> Dataset:
    """Four points, three wavelengths, errors of every kind of sharing; sizes and signs at random."""
    random = np.random.default_rng(5)
    groups = np.array([0, 1, 0, 1])
    kinds = [
        (None, False),
        (None, True),
        (groups, False),
        (groups, True),
        (everywhere(4), False),
        (everywhere(4), True),
    ]
    parts = ("random", "drift", "dark", "angle", "reference", "reference")
    sources = tuple(
        ErrorSource(f"{part}: {i}", part, random.normal(0, 0.01, SHAPE), of, shared)
        for i, (part, (of, shared)) in enumerate(zip(parts, kinds, strict=True))
    )
    return Dataset(
        sample="a sample",
        theta_in=np.array([20.0, 40, 20, 40]),
        theta_out=np.array([20.0, 40, -60, -60]),
        wavelengths=np.array([500.0, 600, 700]),
        brdf=random.uniform(0.5, 1, SHAPE),
        sources=sources,
        flags=np.zeros(4, dtype=np.uint16),
        u_angle=0.005,
        u_zero=0.01,
        aperture=1.0,
    )


def test_covariance_of_anything_linear_is_what_the_uncertainties_package_finds() -> None:
    dataset = small_dataset()
    values = dataset.brdf.astype(object)
    for source in dataset.sources:
        for point in range(4):
            for wavelength in range(3):
                values[point, wavelength] += source.values[point, wavelength] * error_of(source, point, wavelength)
    gain = np.random.default_rng(6).normal(size=(3, *SHAPE))
    parameters = [np.sum(each * values) for each in gain]
    expected = np.array(covariance_matrix(parameters))
    found = covariance_by_source(gain, dataset.sources)
    assert list(found) == [source.name for source in dataset.sources]
    assert sum(found.values()) == pytest.approx(expected, rel=1e-9)
    assert variance(gain, dataset.sources) == pytest.approx(np.diag(expected), rel=1e-9)
    # of single values it is the uncertainty that the dataset states
    assert dataset.u == pytest.approx(np.array([[v.std_dev for v in row] for row in values]), rel=1e-9)


ERRORS: dict[tuple[str, int, int], object] = {}


def error_of(source: ErrorSource, point: int, wavelength: int) -> object:
    """The standard normal number of `uncertainties` that a value shares with others of a source."""
    key = (
        source.name,
        point if source.groups is None else int(source.groups[point]),
        -1 if source.shared_by_wavelengths else wavelength,
    )
    return ERRORS.setdefault(key, ufloat(0, 1))


def test_the_parts_of_a_budget_add_up_to_the_stated_uncertainty() -> None:
    dataset = small_dataset()
    found = budget(dataset, 40.4, 39.5, 620)
    assert (found.theta_in, found.theta_out, found.wavelength) == (40, 40, 600)
    assert found.brdf == dataset.brdf[1, 1]
    assert [part.name for part in found.parts] == ["random", "dark", "reference", "angle", "drift"]
    assert np.sqrt(sum(part.u**2 for part in found.parts)) == pytest.approx(dataset.u[1, 1])
    assert sum(part.share for part in found.parts) == pytest.approx(1)
    assert found.expanded == pytest.approx(2 * dataset.u[1, 1])
    for part in found.parts:
        assert part.relative == pytest.approx(part.u / found.brdf)
        assert part.u == pytest.approx(np.sqrt(sum(source.u**2 for source in part.sources)))
        assert part.share == pytest.approx(sum(source.share for source in part.sources))
    shared = {source.name: source.shared for part in found.parts for source in part.sources}
    assert shared == {
        "random: 0": "nothing",
        "drift: 1": "all wavelengths",
        "dark: 2": "some points",
        "angle: 3": "some points, all wavelengths",
        "reference: 4": "all points",
        "reference: 5": "all points, all wavelengths",
    }


def test_the_parts_of_all_values_add_up_too() -> None:
    dataset = drawn_dataset("sample-4")
    parts = by_part(dataset)
    assert list(parts) == [part for part in PARTS if part in {"random", "reference", "angle"}]
    assert np.sqrt(sum(u**2 for u in parts.values())) == pytest.approx(dataset.u)


def test_a_budget_is_shown_at_the_mirror_direction_nearest_45_degrees() -> None:
    assert usual_direction(drawn_dataset("sample-4")) == (40, 40)


def test_a_budget_is_shown_beside_the_source_where_it_hides_the_mirror_direction_and_where_there_is_a_value() -> None:
    at = np.zeros(3), np.array([-30.0, 5, 10])
    dataset = drawn_dataset("sample-4", at=at)
    assert usual_direction(dataset) == (0, 5)
    brdf = dataset.brdf.copy()
    brdf[1] = np.nan
    assert usual_direction(replace(dataset, brdf=brdf)) == (0, 10)
    assert budget(dataset, *usual_direction(dataset), 600).theta_out == 5


def test_a_direction_that_was_not_measured_is_refused_and_the_nearest_is_named() -> None:
    with pytest.raises(GeometryError, match=r"within 2° of theta_in = 30°.*nearest is theta_in = 20\.00°"):
        budget(small_dataset(), 30, 20, 600)
    with pytest.raises(InputError, match="no value at 1200 nm; ask for a wavelength from 500 to 700 nm"):
        budget(small_dataset(), 20, 20, 1200)


def test_a_point_without_a_value_has_no_budget() -> None:
    dataset = small_dataset()
    brdf = dataset.brdf.copy()
    brdf[0, 1], brdf[1] = np.nan, np.nan
    gaps = replace(dataset, brdf=brdf)
    with pytest.raises(GeometryError, match=r"no value at 600\.0 nm"):
        budget(gaps, 20, 20, 600)
    assert nearest_point(gaps, 20, 20) == 0
    with pytest.raises(GeometryError, match="nearest is"):
        budget(gaps, 40, 40, 600)
    with pytest.raises(GeometryError, match="has no value at all"):
        budget(replace(dataset, brdf=np.full(SHAPE, np.nan)), 40, 40, 600)
