"""The average over all places of the window is what the places give one by one, and what theory says it is."""

import numpy as np
import pytest
from scipy.special import gammaln, jv

from goniometer.errors import InputError
from simulators.errors import UnfitTopography
from simulators.topographies.heights import HeightField
from simulators.waves.diffraction import direct_integral, window
from simulators.waves.power_spectrum import power_spectrum

FloatArray = np.ndarray


def gaussian_surface(count: int, pitch_um: float, rms_um: float, length_um: float, seed: int) -> HeightField:
    """A periodic surface of Gaussian heights and autocorrelation exp(-r^2 / length^2), by circulant embedding."""
    lag = np.arange(count) * pitch_um
    lag = np.minimum(lag, count * pitch_um - lag)
    spectrum = np.fft.fft2(np.exp(-(lag**2 + lag[:, None] ** 2) / length_um**2)).real
    noise = np.random.default_rng(seed).normal(size=(count, count))
    return HeightField(
        rms_um * np.fft.ifft2(np.fft.fft2(noise) * np.sqrt(np.maximum(spectrum, 0))).real, pitch_um, True
    )


def beckmann(kx: FloatArray, kz: FloatArray, rms_um: float, length_um: float, s_um: float) -> FloatArray:
    """Mean |I|^2 in um^2 of the ensemble, coherent part included (Beckmann & Spizzichino 1963, section 5.3, with a
    Gaussian window): a sum over powers of the autocorrelation."""
    g = ((kz * rms_um) ** 2)[:, None]
    m = np.arange(int(g.max() + 12 * np.sqrt(g.max()) + 12))
    width = m / length_um**2 + 1 / (4 * s_um**2)
    terms = np.exp(m * np.log(g) - g - gammaln(m + 1) - kx[:, None] ** 2 / (4 * width))
    return np.asarray((terms * np.pi / width).sum(axis=1))


def test_the_average_is_that_of_all_windows_one_by_one() -> None:
    field = gaussian_surface(24, 1.0, 0.3, 4.0, seed=3)
    s_um = 2.5
    rng = np.random.default_rng(4)
    kx, kz = rng.uniform(-1.5, 1.5, 12), rng.uniform(2, 9, 12)
    spectrum = power_spectrum(field, s_um, 2.0, 9.0)
    places = [(x, y) for x in range(24) for y in range(24)]
    tiled = HeightField(np.tile(field.heights_um, (3, 3)), 1.0, periodic=False)
    centres = [(24.0 + x, 24.0 + y) for x, y in places]
    mean = np.mean([np.abs(direct_integral(tiled, window(tiled, s_um, c), kx, kz)) ** 2 for c in centres], axis=0)
    assert spectrum.mean_square(kx, kz, s_um) == pytest.approx(mean, rel=1e-3)


@pytest.mark.parametrize("kz", [3.1, 14.7, 29.9])
def test_orders_of_a_sinusoidal_grating_have_the_efficiencies_of_theory(kz: float) -> None:
    period, height, s_um = 8.0, 0.35, 12.0
    x = np.arange(512) * 0.125
    field = HeightField(np.tile(height * np.sin(2 * np.pi * x / period), (3, 1)), 0.125, periodic=True)
    order = np.arange(-14, 15)
    found = power_spectrum(field, s_um, 3.0, 30.0).mean_square(2 * np.pi * order / period, np.full(29, kz), s_um)
    assert found / (4 * np.pi * s_um**2) == pytest.approx(jv(order, kz * height) ** 2, abs=1e-4)


@pytest.mark.slow
def test_the_mean_over_rough_surfaces_is_beckmanns_within_its_statistical_error() -> None:
    rms_um, length_um, s_um, count = 0.4, 4.0, 4.0, 60
    theta = np.radians(np.arange(-60.0, 61, 4))
    k = 2 * np.pi / 0.6
    kx, kz = k * (np.sin(theta) - np.sin(np.radians(20))), k * (np.cos(theta) + np.cos(np.radians(20)))
    found = np.array(
        [
            power_spectrum(gaussian_surface(256, 0.25, rms_um, length_um, seed), s_um, kz.min(), kz.max()).mean_square(
                kx, kz, s_um
            )
            for seed in range(count)
        ]
    )
    expected = beckmann(kx, kz, rms_um, length_um, s_um)
    error = found.std(axis=0, ddof=1) / np.sqrt(count)
    z = (found.mean(axis=0) - expected) / error
    bright = expected > 0.02 * expected.max()  # facets that are rarer than that are too few for a normal distribution
    assert bright.sum() > 18
    assert np.sqrt((z[bright] ** 2).mean()) < 1.5
    assert np.abs(z[bright]).max() < 3.5
    assert np.median((error / expected)[bright]) < 0.04


def test_a_surface_of_which_a_part_was_measured_scatters_as_the_whole() -> None:
    whole = gaussian_surface(400, 0.25, 0.1, 3.0, seed=5)
    part = HeightField(whole.heights_um[:360, :], 0.25, periodic=False)
    kx, kz = np.linspace(-1.5, 1.5, 61), np.full(61, 12.0)
    found, expected = (power_spectrum(each, 5.0, 12.0, 12.0).mean_square(kx, kz, 5.0) for each in (part, whole))
    assert found.sum() == pytest.approx(expected.sum(), rel=0.1)
    flat = power_spectrum(HeightField(np.full((400, 400), 3.0), 0.25, periodic=False), 5.0, 12.0, 12.0)
    lobe = flat.mean_square(kx, kz, 5.0)
    # where the map fades out, the window is narrower, and the lobe wider, by a few per cent along each axis
    assert lobe.sum() / lobe.max() == pytest.approx(np.sqrt(np.pi) / (5.0 * 0.05), rel=0.05)
    assert lobe.max() == pytest.approx(4 * np.pi * 25, rel=0.08)


def test_what_the_spectrum_does_not_hold_is_refused() -> None:
    field = gaussian_surface(40, 0.5, 0.2, 3.0, seed=6)
    spectrum = power_spectrum(field, 4.0, 5.0, 10.0)
    for kz, s_um in ((3.0, 4.0), (13.0, 4.0), (7.0, 3.9)):
        with pytest.raises(InputError, match="compute it for these"):
            spectrum.mean_square(np.zeros(1), np.array([kz]), s_um)
    with pytest.raises(UnfitTopography, match="smaller window"):
        power_spectrum(HeightField(field.heights_um, 0.5, periodic=False), 4.0, 5.0, 10.0)
