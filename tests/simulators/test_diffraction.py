"""The fast transform is the plain sum, orders of a grating are Bessel functions, and a flat patch keeps its energy."""

import numpy as np
import pytest
from scipy.special import jv

from goniometer.errors import InputError
from simulators.errors import UnfitTopography
from simulators.topographies.heights import HeightField
from simulators.waves.diffraction import Coherence, diffraction_integral, direct_integral, seen_through, window
from simulators.waves.sampling import refined


def test_the_fast_path_is_the_sum_that_defines_it() -> None:
    rng = np.random.default_rng(1)
    field = HeightField(rng.normal(scale=0.8, size=(90, 70)), 0.7, periodic=False)
    amplitude = window(field, 9.0, (20.0, 31.0))
    kx, kz = rng.uniform(-30, 30, (40, 30)), rng.uniform(2, 33, (40, 30))
    fast = diffraction_integral(field, amplitude, kx, kz, ky=0.4)
    some = rng.choice(kx.size, 60, replace=False)
    direct = direct_integral(field, amplitude, kx.ravel()[some], kz.ravel()[some], ky=0.4)
    assert np.abs(fast.ravel()[some] - direct).max() < 1e-6 * np.sqrt((np.abs(direct) ** 2).mean())


def test_a_large_map_that_is_transformed_in_parts_gives_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(2)
    field = HeightField(rng.normal(size=(40, 30)), 0.5, periodic=True)
    amplitude, kx, kz = window(field, 4.0), rng.uniform(-9, 9, 50), rng.uniform(3, 20, 50)
    whole = diffraction_integral(field, amplitude, kx, kz)
    monkeypatch.setattr("simulators.waves.diffraction._AT_ONCE", 200)
    assert diffraction_integral(field, amplitude, kx, kz) == pytest.approx(whole, abs=1e-7)


def test_a_map_in_coarse_steps_has_the_order_efficiencies_of_its_grating_once_refined() -> None:
    period, height = 12.0, 0.4
    x = np.arange(240.0)
    coarse = HeightField(np.tile(height * np.sin(2 * np.pi * x / period), (240, 1)), 1.0, periodic=True)
    field = refined(coarse, 4)
    order, kz = (each.ravel() for each in np.meshgrid(np.arange(-8, 9), [8.0, 14.7, 20.9], indexing="ij"))
    amplitude = window(field, 24.0)
    integral = diffraction_integral(field, amplitude, 2 * np.pi * order / period, kz)
    efficiency = np.abs(integral) ** 2 / (4 * np.pi * 24.0**2)
    assert efficiency == pytest.approx(jv(order, kz * height) ** 2, abs=1e-3)


@pytest.mark.parametrize("theta_in", [0.0, 40.0])
def test_a_flat_patch_reflects_all_of_the_light_and_no_more(theta_in: float) -> None:
    field = HeightField(np.zeros((160, 160)), 1.0, periodic=False)
    k = 2 * np.pi / 0.6
    amplitude = window(field, 16.0)
    offset = np.arange(-12, 13) * 0.5 / (k * 16.0)
    along, sine = np.sin(np.radians(theta_in)) + offset, np.sin(np.radians(theta_in))
    energy = 0.0
    for across in offset:
        cos_i, cos_o = np.cos(np.radians(theta_in)), np.sqrt(1 - along**2 - across**2)
        integral = diffraction_integral(field, amplitude, k * (along - sine), k * (cos_i + cos_o), ky=k * across)
        # f cos_o d omega, and d omega = d alpha d beta / cos_o
        energy += float((cos_o / cos_i * np.abs(integral) ** 2 / 0.6**2).sum()) * (offset[1] - offset[0]) ** 2
    assert energy == pytest.approx(1, abs=0.01)


@pytest.mark.parametrize("periodic", [False, True])
def test_every_window_is_normalised_also_at_the_edge(periodic: bool) -> None:
    field = HeightField(np.zeros((50, 40)), 0.5, periodic)
    amplitude = window(field, 3.0, (1.0, 24.0))
    assert (amplitude**2).sum() * 0.5**2 == pytest.approx(1)
    assert [int(i) for i in np.unravel_index(np.argmax(amplitude), amplitude.shape)] == [48, 2]
    assert amplitude[0, 2] == pytest.approx(amplitude[46, 2] if periodic else 0.0, abs=1e-3)


def test_the_window_of_an_aperture_spreads_a_mirror_as_much_as_the_aperture_does() -> None:
    s_um = seen_through(1.0).size(np.array([450.0]))[0]
    angle = np.linspace(-0.05, 0.05, 4001)
    lobe = np.exp(-((2 * np.pi / 0.45 * angle * s_um) ** 2))
    within = np.linspace(-1, 1, 4001)
    chord = np.sqrt(1 - within**2)
    of_disc = np.radians(0.5) * np.sqrt((within**2 * chord).sum() / chord.sum())
    assert np.sqrt((angle**2 * lobe).sum() / lobe.sum()) == pytest.approx(of_disc, rel=1e-3)


def test_a_window_without_size_and_a_map_with_holes_are_refused() -> None:
    with pytest.raises(InputError, match="positive size"):
        Coherence(0.0)
    holed = HeightField(np.array([[0.0, np.nan], [0.0, 0.0]]), 1.0, periodic=False)
    with pytest.raises(UnfitTopography, match="lacks 1 of its 4"):
        diffraction_integral(holed, np.ones((2, 2)), np.zeros(1), np.ones(1))
