"""Orders of gratings go where Eq. 1 says, carry what scalar theory says, and bin to linear spectra."""

import numpy as np
import pytest

from goniometer.errors import InputError
from simulators.diffraction import Coherence
from simulators.gratings import binned_spectra, order_angles, sinusoidal_efficiencies
from simulators.heights import HeightField
from simulators.waves import averaged, averaged_brdf


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
