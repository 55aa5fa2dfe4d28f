"""What is said of noise and flags before any fit is believed."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from analysis.fits.noise import above_noise, at_wavelength, flag_sentences, flag_words, hue_is_known
from goniometer.datasets.dataset import Dataset, Flag
from goniometer.uncertainty import ErrorSource


@pytest.fixture(scope="module")
def dataset(measure: Callable[..., Dataset]) -> Dataset:
    """A small measurement; 600 nm lies in the middle of two of its wavelengths."""
    made = measure(0.3, incident=(40,), wavelength_step=10.0)
    return replace(made, wavelengths=made.wavelengths + 3.0)


def test_an_error_that_wavelengths_share_does_not_average_out_between_two_of_them(dataset: Dataset) -> None:
    one = np.ones_like(dataset.brdf)
    own = ErrorSource("own", "random", 3 * one, None, False)
    shared = ErrorSource("shared", "reference", -4 * one, np.zeros(one.shape[0], dtype=np.intp), True)
    for sources, u in (((own,), 3 / np.sqrt(2)), ((shared,), 4.0), ((own, shared), np.sqrt(4.5 + 16))):
        np.testing.assert_allclose(at_wavelength(replace(dataset, sources=sources), 600.0)[1], u)


def test_a_wrong_certificate_does_not_make_a_hue_unknown(dataset: Dataset) -> None:
    certificate = ErrorSource(
        "certificate", "reference", dataset.brdf, np.zeros(dataset.flags.size, dtype=np.intp), True
    )
    doubted = replace(dataset, sources=(*dataset.sources, certificate))
    assert hue_is_known(doubted, 600.0).all()
    assert above_noise(doubted).all()
    noisy = replace(dataset, sources=(ErrorSource("counts", "random", 0.1 * dataset.brdf, None, False),))
    assert not hue_is_known(noisy, 600.0).any()
    assert above_noise(noisy).all()


def test_flags_say_how_many_points_and_what_the_fits_do_with_them(dataset: Dataset) -> None:
    flags = dataset.flags.copy()
    flags[[0, 1]] = Flag.CLIPPED
    flags[[1, 2, 3]] |= np.uint16(Flag.BELOW_NOISE)
    total = flags.size
    assert flag_sentences(replace(dataset, flags=flags)) == (
        f"2 of {total} points are left out of all fits: footprint leaves the sample.",
        f"3 of {total} points are kept in fits of all points, without a slope of their own: below the noise.",
    )
    assert flag_sentences(dataset) == ()
    assert [flag_words(int(f)) for f in flags[:5]] == [
        "footprint leaves the sample",
        "footprint leaves the sample, below the noise",
        "below the noise",
        "below the noise",
        "",
    ]
