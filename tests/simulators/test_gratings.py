"""Orders of gratings go where Eq. 1 says, carry what scalar theory says, and bin to linear spectra."""

import numpy as np
import pytest
from scipy.stats import linregress

from goniometer.errors import InputError
from simulators.choices import Spread
from simulators.topographies.heights import HeightField
from simulators.waves.diffraction import Coherence
from simulators.waves.gratings import (
    binned_spectra,
    grating_brdf,
    order_angles,
    ring,
    spread_periods,
    straight_lines,
)
from simulators.waves.waves import averaged, averaged_brdf
from tests.thin_grating import sinusoidal_efficiencies


def test_longer_waves_are_bent_further_and_some_orders_do_not_exist() -> None:
    angles = order_angles(40.0, np.array([[0.0], [1.0], [-3.0]]), np.array(2.0), np.array([400.0, 700.0]))
    assert angles[0] == pytest.approx([40, 40])
    assert angles[1] == pytest.approx(np.degrees(np.arcsin(np.sin(np.radians(40)) - np.array([0.2, 0.35]))))
    assert np.isnan(angles[2]).all()
    with pytest.raises(InputError, match="positive length"):
        order_angles(0.0, np.array(1.0), np.array(0.0), np.array([500.0]))


def test_a_shallow_grating_keeps_the_energy() -> None:
    orders = np.arange(-20.0, 21)[:, None]
    wavelengths = np.array([400.0, 600.0, 800.0])
    share = sinusoidal_efficiencies(20.0, orders, np.array(25.0), np.array(0.2), wavelengths)
    assert share.sum(axis=0) == pytest.approx([1, 1, 1], abs=0.01)


def test_the_height_map_of_a_grating_scatters_into_its_orders_what_the_formula_says() -> None:
    period, height, theta_in, s_um = 6.0, 0.15, 30.0, 20.0
    x = np.arange(960) * 0.125
    field = HeightField(np.tile(height * np.sin(2 * np.pi * x / period), (3, 1)), 0.125, periodic=True)
    wavelengths = np.array([550.0])
    orders = np.arange(-3.0, 4)
    expected = sinusoidal_efficiencies(theta_in, orders, np.array(period), np.array(height), wavelengths)
    centre = order_angles(theta_in, orders, np.array(period), wavelengths)
    offset = np.arange(-30, 31) * 0.05
    theta_out = (centre[:, None] + offset).ravel()
    incident = np.full(theta_out.size, theta_in)
    surface = averaged(field, incident, theta_out, wavelengths, Coherence(s_um, grows=False))
    lobe = averaged_brdf(surface, incident, theta_out, wavelengths).brdf[:, 0].reshape(orders.size, -1)
    cos_o = np.cos(np.radians(theta_out)).reshape(lobe.shape)
    # across the plane the lobe is the window's own: the integral of exp(-(k s beta)^2)
    across = np.sqrt(np.pi) / (2 * np.pi / 0.55 * s_um)
    energy = (lobe * cos_o).sum(axis=1) * np.radians(0.05) * across
    assert energy == pytest.approx(expected, rel=0.01, abs=1e-4)


def test_binning_many_gratings_gives_spectra_that_rise_linearly() -> None:
    periods = np.linspace(1.0, 20.0, 200_000)
    wavelengths = np.linspace(400.0, 800.0, 9)
    edges = np.arange(0.0, 8)
    spectra = binned_spectra(0.0, -1, periods, wavelengths, edges)
    shortest, longest = (1e-3 * wavelengths / np.sin(np.radians(e))[:, None] for e in (edges[1:], edges[:-1] + 1e-12))
    overlap = np.clip(np.minimum(longest, 20) - np.maximum(shortest, 1), 0, None) / 19
    assert spectra == pytest.approx(overlap, abs=1e-4)
    for spectrum in spectra[3:]:
        assert spectrum / spectrum[0] == pytest.approx(wavelengths / 400, rel=2e-3)
    assert spectra[1, -1] < spectra[1, 0]


def shares(spread: Spread, shortest: np.ndarray, longest: np.ndarray) -> np.ndarray:
    """Share of the gratings between two spacings, um, of those from 0.5 to 40 um."""
    a, b = np.clip(shortest, 0.5, 40), np.clip(longest, 0.5, 40)
    if spread is Spread.SPACING:
        return np.asarray((b - a) / 39.5)
    if spread is Spread.LOGARITHM:
        return np.asarray(np.log(b / a) / np.log(80))
    return np.asarray((1 / a - 1 / b) / (2 - 1 / 40))


@pytest.mark.parametrize("spread", Spread)
def test_each_way_to_spread_the_spacings_gives_the_colour_of_its_formula(spread: Spread) -> None:
    wavelengths = np.linspace(400.0, 800.0, 21)
    edges = np.arange(1.0, 12)
    periods = spread_periods(spread, 0.5, 40.0, 100_000)
    spectra = binned_spectra(0.0, -1, periods, wavelengths, edges)
    near, far = (1e-3 * wavelengths / np.sin(np.radians(e))[:, None] for e in (edges[1:], edges[:-1]))
    assert spectra == pytest.approx(shares(spread, near, far), abs=2e-5)
    power = {Spread.SPACING: 1, Spread.LOGARITHM: 0, Spread.FREQUENCY: -1}[spread]
    lines = straight_lines(spectra, wavelengths)
    expected = np.polynomial.Polynomial.fit(wavelengths, wavelengths**power, 1)
    slope = 1e3 * expected.deriv()(600.0) / expected(600.0)
    assert lines.slope[3:] == pytest.approx(np.full(7, slope), abs=0.01)


def test_lines_are_those_of_a_regression_and_darkness_has_none() -> None:
    wavelengths = np.linspace(400.0, 800.0, 41)
    noisy = 2 + 1e-3 * wavelengths + np.random.default_rng(3).normal(size=41)
    lines = straight_lines(np.stack([noisy, np.zeros(41)]), wavelengths)
    found = linregress(wavelengths, noisy)
    assert lines.slope[0] == pytest.approx(1e3 * found.slope / noisy.mean())
    assert lines.r2[0] == pytest.approx(found.rvalue**2)
    assert np.isnan([lines.slope[1], lines.r2[1]]).all()


def test_gratings_in_all_azimuths_have_the_brdf_that_their_orders_draw_on_the_hemisphere() -> None:
    random = np.random.default_rng(4)
    theta_in, wavelength, count = 35.0, 0.55, 2_000_000
    periods = random.uniform(0.3, 20.0, count)
    azimuth = random.uniform(0, 2 * np.pi, count)
    # each sends half of its light to either side; one azimuth and its opposite are equally frequent
    x = np.sin(np.radians(theta_in)) + wavelength / periods * np.cos(azimuth)
    y = wavelength / periods * np.sin(azimuth)
    for theta_out in (20.0, 29.0, 42.0, 50.0, -10.0):
        # a box of 1 by 1 degree around the direction: energy / (solid angle cos(theta_out)) = energy / (dx dy)
        low, high = np.sin(np.radians([theta_out - 0.5, theta_out + 0.5]))
        half = np.radians(0.5)
        inside = (x > low) & (x < high) & (np.abs(y) < half)
        drawn = inside.mean() / ((high - low) * 2 * half)
        rings = ring(np.array([theta_in]), np.array([theta_out]), 1.0)
        (found,) = grating_brdf(*rings, np.sort(periods), np.array([1e3 * wavelength]))[0]
        error = drawn / np.sqrt(inside.sum())
        assert found == pytest.approx(drawn, abs=4 * error + 0.03 * drawn)


def test_gratings_send_back_all_light_and_no_more() -> None:
    # rings that touch each other around the mirror direction, as far as any order goes
    outer = np.linspace(0, 2, 401)[1:]
    inner = np.concatenate([[0.0], outer[:-1]])
    periods = spread_periods(Spread.FREQUENCY, 0.4, 20.0, 10_000)
    brdf = grating_brdf(inner, outer, periods, np.array([400.0, 700.0]))
    assert (np.pi * (outer**2 - inner**2)) @ brdf == pytest.approx([1, 1], abs=1e-3)


def test_spacings_that_cannot_be_are_refused() -> None:
    for smallest, largest in ((0.0, 3.0), (3.0, 3.0), (5.0, 1.0), (1.0, np.inf), (np.nan, 2.0)):
        with pytest.raises(InputError, match="give the smaller one first"):
            spread_periods(Spread.SPACING, smallest, largest, 10)
