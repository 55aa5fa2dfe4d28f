"""Colours agree with colour-science and with the paper's definition."""

import colour
import numpy as np
import pytest

from analysis.colour import (
    brdf_to_rgb,
    brdf_to_xyz,
    colour_differences,
    delta_e_2000,
    display_encoded,
    xyz_weights,
)
from analysis.errors import OutOfRange
from analysis.reflectance.fresnel import fresnel_conductor, load_conductor

WAVELENGTHS = np.arange(382.0, 998.0, 4.6)
IRREGULAR = np.sort(np.concatenate([WAVELENGTHS + 0.4 * np.sin(WAVELENGTHS), [555.5, 600.1]]))


def smooth_spectra(wavelengths: np.ndarray) -> np.ndarray:
    x = (wavelengths - 600) * 1e-3
    return np.stack([1 + 1.5 * x, 0.3 * np.exp(-((x + 0.1) ** 2) / 0.01) + 0.05, 0.5 - 0.8 * x + x**2])


@pytest.mark.parametrize("wavelengths", [WAVELENGTHS, IRREGULAR, np.arange(380.0, 1000, 20), np.array([400.0, 700])])
def test_a_uniform_brdf_of_one_at_normal_incidence_is_white_on_any_grid(wavelengths: np.ndarray) -> None:
    rgb = brdf_to_rgb(np.ones((1, wavelengths.size)), np.array([0.0]), wavelengths)
    np.testing.assert_allclose(rgb, 1, atol=1e-12)


def test_white_is_the_tabulated_d65() -> None:
    # CIE 15: D65, 2 degree observer
    np.testing.assert_allclose(xyz_weights(WAVELENGTHS).sum(axis=0), [0.95047, 1.0, 1.08883], atol=1e-4)


@pytest.mark.parametrize("wavelengths", [WAVELENGTHS, IRREGULAR])
def test_tristimulus_values_are_those_of_colour_science(wavelengths: np.ndarray) -> None:
    fine = np.arange(360.0, 781.0)
    illuminant = colour.SDS_ILLUMINANTS["D65"]
    ours = brdf_to_xyz(smooth_spectra(wavelengths), np.array([0.0, 60, 40]), wavelengths)
    for spectrum, xyz, theta_in in zip(smooth_spectra(fine), ours, (0, 60, 40), strict=True):
        distribution = colour.SpectralDistribution(spectrum, fine)
        expected = colour.sd_to_XYZ(distribution, illuminant=illuminant, method="Integration") / 100
        np.testing.assert_allclose(xyz, expected * np.cos(np.radians(theta_in)), atol=3e-4)


def test_rgb_agrees_with_colour_science_but_for_the_rounded_white() -> None:
    xyz = brdf_to_xyz(smooth_spectra(WAVELENGTHS), np.zeros(3), WAVELENGTHS)
    rgb = brdf_to_rgb(smooth_spectra(WAVELENGTHS), np.zeros(3), WAVELENGTHS)
    expected = colour.XYZ_to_RGB(xyz, "ITU-R BT.709", chromatic_adaptation_transform=None)
    np.testing.assert_allclose(rgb, expected, atol=1e-3)
    np.testing.assert_allclose(display_encoded(rgb), colour.models.eotf_inverse_sRGB(np.clip(rgb, 0, 1)), atol=1e-12)


@pytest.mark.parametrize(("slope", "expected"), [(1, 6.6), (-1, 6.0), (0.5, 3.4), (-0.5, 3.4), (2, 12)])
def test_a_tilt_has_the_colour_difference_that_makes_the_shift_worth_modelling(slope: float, expected: float) -> None:
    aluminium = fresnel_conductor(np.array([1.0]), *load_conductor().index(WAVELENGTHS))
    tilted = aluminium * (1 + slope * (WAVELENGTHS - 600) * 1e-3)
    differences = colour_differences(tilted[None], aluminium[None], WAVELENGTHS, np.array([40.0]))
    assert differences.chromatic[0] == pytest.approx(expected, rel=0.06)


def test_chromatic_differences_ignore_brightness_and_absolute_ones_do_not() -> None:
    spectrum = smooth_spectra(WAVELENGTHS)[:1]
    differences = colour_differences(3 * spectrum, spectrum, WAVELENGTHS, np.array([50.0]))
    assert differences.chromatic[0] == pytest.approx(0, abs=1e-9)
    assert differences.absolute[0] > 10


def test_one_noisy_sample_at_lambda_n_does_not_spoil_the_chromatic_difference() -> None:
    spectrum = smooth_spectra(WAVELENGTHS)[2:]
    spoilt = spectrum.copy()
    spoilt[0, np.argmin(np.abs(WAVELENGTHS - 600))] *= 1.3
    differences = colour_differences(spoilt, spectrum, WAVELENGTHS, np.array([0.0]))
    # 4.6 nm of 30 % more orange light; normalised by that one sample everything would darken by 30 %
    assert differences.chromatic[0] < 1.5


def test_a_gap_in_the_visible_has_no_colour_and_one_in_the_infrared_does_not_matter() -> None:
    spectra = np.repeat(smooth_spectra(WAVELENGTHS)[:1], 3, axis=0)
    spectra[1, 40], spectra[2, -1] = np.nan, np.nan
    differences = colour_differences(spectra, 1.1 * spectra, WAVELENGTHS, np.zeros(3))
    np.testing.assert_array_equal(np.isnan(differences.absolute), [False, True, False])
    np.testing.assert_array_equal(np.isnan(differences.chromatic), [False, True, False])
    assert differences.statistics()["max"] > 0


def test_a_grid_that_misses_blue_has_no_colour() -> None:
    with pytest.raises(OutOfRange, match="450 to 700 nm"):
        xyz_weights(np.linspace(450, 700, 20))


def test_colour_difference_reproduces_the_published_test_pair() -> None:
    # Sharma, Wu & Dalal 2005, table 1, pair 25
    lab = np.array([[60.2574, -34.0099, 36.2677], [60.4626, -34.1751, 39.4387]])
    white = colour.XYZ_to_xy(xyz_weights(WAVELENGTHS).sum(axis=0))
    xyz = colour.Lab_to_XYZ(lab, white)
    assert delta_e_2000(xyz[0], xyz[1]) == pytest.approx(1.2644, abs=1e-4)
