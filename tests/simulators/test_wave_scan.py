"""Patches of a surface under waves: orders of a grating, errors that cover, convergence, light reflected more often."""

from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

import numpy as np
import pytest

from drivers.arrays import FloatArray
from goniometer.errors import InputError
from simulators.choices import Kernel
from simulators.topographies.heights import HeightField
from simulators.topographies.synthesis import gaussian, gaussian_correlation
from simulators.waves.convergence import HALF_STEP, TWICE_STEP
from simulators.waves.diffraction import Coherence
from simulators.waves.gratings import order_angles
from simulators.waves.multiple_reflection import combined, kz_reach, multiply_reflected, shift_of_multiple
from simulators.waves.scan import Patches, Setup, average, choose_patches, fine_enough, seen, spread, tiles
from simulators.waves.simulation import WaveSimulation, simulate
from tests.thin_grating import sinusoidal_efficiencies

WAVELENGTHS = np.linspace(450.0, 750.0, 7)


def grating(period_um: float, height_um: float, pitch_um: float, periods: int) -> HeightField:
    x = np.arange(round(periods * period_um / pitch_um)) * pitch_um
    return HeightField(np.tile(height_um * np.sin(2 * np.pi * x / period_um), (4, 1)), pitch_um, periodic=True)


def rough(seed: int, size: int = 96, pitch_um: float = 0.25) -> HeightField:
    return gaussian(0.3, gaussian_correlation(3.0), size, pitch_um, seed)


def simulated(fields: list[HeightField], setup: Setup, **multiple: Any) -> WaveSimulation:
    make = tuple(partial(_give, field) for field in fields)
    with ThreadPoolExecutor(1) as executor:
        return simulate(Patches("a surface", {}, make, make, symmetric=False), setup, executor, **multiple)


def _give(field: HeightField) -> HeightField:
    return field


def test_a_coarsely_known_grating_is_refined_by_itself_and_has_the_orders_of_theory() -> None:
    period, height, theta_in, s_um = 6.0, 0.15, 30.0, 12.0
    orders = np.arange(-2.0, 3)
    centre = order_angles(theta_in, orders[:, None], np.array(period), WAVELENGTHS)
    offset = np.arange(-20, 21) * 0.15
    wanted = sinusoidal_efficiencies(theta_in, orders[:, None], np.array(period), np.array(height), WAVELENGTHS)
    for number in (0, 6):  # the shortest and the longest wavelength
        theta_out = np.append((centre[:, [number]] + offset).ravel(), -80)  # where a coarse grating has ghosts
        setup = Setup(
            np.full(theta_out.size, theta_in),
            theta_out,
            WAVELENGTHS,
            Coherence(s_um, grows=False),
            Kernel.HARVEY_SHACK,
            None,
        )
        found = simulated([grating(period, height, 0.5, 20)] * 4, setup)
        assert found.sampling.sufficient
        assert found.sampling.pitch_um < 0.5
        lobe = (found.computed.brdf[:, number] * np.cos(np.radians(theta_out)))[:-1].reshape(orders.size, -1)
        # across the plane the lobe is the window's own: the integral of exp(-(k s beta)^2)
        across = np.sqrt(np.pi) / (2 * np.pi / (1e-3 * WAVELENGTHS[number]) * s_um)
        energy = lobe.sum(axis=1) * np.radians(0.15) * across
        assert energy == pytest.approx(wanted[:, number], rel=0.01, abs=2e-4)
        assert np.abs(found.computed.u_level).max() == 0


def test_half_the_step_changes_nothing_and_a_step_that_is_too_wide_is_seen_to_be() -> None:
    theta_out = np.arange(-60.0, 61, 10)
    setup = Setup(np.full(13, 40.0), theta_out, WAVELENGTHS, Coherence(2.0), Kernel.RECIPROCAL, None)
    found = simulated([rough(seed, 48, 0.5) for seed in range(4)], setup)
    study = found.convergence
    half, twice = study.p95[HALF_STEP], study.p95[TWICE_STEP]
    assert half is not None
    assert half < 1e-3
    assert twice is not None
    assert twice > 10 * half
    assert [figure.what for figure in study.figures if figure.theta_out == 40] == ["f", "m"]
    assert all(figure.converged(HALF_STEP) for figure in study.figures if figure.theta_out > -20)


def test_the_error_of_a_mean_of_patches_covers_what_other_patches_give() -> None:
    theta_out = np.arange(-20.0, 61, 8)
    setup = Setup(np.full(theta_out.size, 20.0), theta_out, WAVELENGTHS, Coherence(2.0), Kernel.RECIPROCAL, None)
    each = np.stack(
        [seen(average(fine_enough(rough(seed), setup)[0], setup), setup, symmetric=True) for seed in range(60)]
    )
    truth = each.mean(axis=0)
    z, tilted = [], []
    place = WAVELENGTHS - WAVELENGTHS.mean()
    for few in each.reshape(10, 6, *truth.shape):
        found = spread(few, WAVELENGTHS)
        u = np.sqrt(found.u_level**2 + found.u_tilt**2 + found.u_spectral**2)
        z.append((found.mean - truth) / u)
        deviation = (found.mean / truth) @ place / (place @ place)
        tilted.append(deviation / (found.u_tilt[:, 0] / found.mean[:, 0] / place[0]))
    # six of the sixty are part of the truth, which takes a tenth of the variance
    assert np.sqrt(np.mean(np.square(z))) == pytest.approx(0.95, abs=0.25)
    assert np.sqrt(np.mean(np.square(tilted))) == pytest.approx(0.95, abs=0.25)
    assert np.mean(np.abs(z) < 2) > 0.93


def test_level_tilt_and_rest_are_told_apart() -> None:
    random = np.random.default_rng(3)
    place = WAVELENGTHS - WAVELENGTHS.mean()
    level, tilt = random.normal(0, 0.1, (5000, 1)), random.normal(0, 3e-4, (5000, 1))
    patches = 2.0 * (1 + level + tilt * place + random.normal(0, 0.02, (5000, WAVELENGTHS.size)))
    found = spread(patches[:, None, :], WAVELENGTHS)
    root = np.sqrt(5000)
    assert found.u_level[0] * root == pytest.approx(np.full(7, 0.2), rel=0.05)
    assert found.u_tilt[0] * root == pytest.approx(2 * 3e-4 * place, rel=0.05)
    assert found.u_spectral[0] * root == pytest.approx(np.full(7, 0.04), rel=0.05)


def test_a_measured_map_is_cut_into_patches_that_are_as_square_as_can_be() -> None:
    field = HeightField(np.arange(63.0 * 40).reshape(63, 40), 0.5, periodic=True)
    parts = tiles(field, 6)
    assert [part.heights_um.shape for part in parts] == [(31, 13)] * 6
    assert not any(part.periodic for part in parts)
    assert parts[4].heights_um[0, 0] == field.heights_um[31, 13]
    with pytest.raises(InputError, match="ask for fewer"):
        tiles(field, 4000)
    with pytest.raises(InputError, match="at least 4"):
        choose_patches("sample-1", None, None, 1, 3, micro=False)


def steep_setup(theta_in: FloatArray) -> Setup:
    incident, reflected = (each.ravel() for each in np.meshgrid(theta_in, np.arange(-80.0, 81, 5), indexing="ij"))
    return Setup(incident, reflected, WAVELENGTHS, Coherence(4.0), Kernel.RECIPROCAL, None)


def test_a_plane_reflects_once_and_a_shift_of_what_is_not_there_adds_nothing() -> None:
    plane = HeightField(np.zeros((64, 64)), 0.25, periodic=True)
    setup = steep_setup(np.array([0.0, 50.0]))
    found = multiply_reflected(plane, average(plane, setup, kz_reach(setup)), setup, 1, rays=2000)
    assert found.leaves == pytest.approx(np.ones(setup.theta_in.size))
    assert not found.brdf.any()
    assert not found.again_by_rays.any()
    wave = np.full((setup.theta_in.size, 7), 0.3)
    slope = np.full(setup.theta_in.size, -5.0)
    assert combined(wave, found.leaves, found.brdf, slope, WAVELENGTHS) == pytest.approx(wave)


def test_waves_meet_a_smooth_surface_again_about_as_often_as_rays() -> None:
    setup = steep_setup(np.array([40.0, 60.0]))
    fields = [gaussian(1.2, gaussian_correlation(6.0), 256, 0.25, seed) for seed in range(2)]
    found = [
        multiply_reflected(field, average(fine_enough(field, setup)[0], setup, kz_reach(setup)), setup, 1, rays=10_000)
        for field in fields
    ]
    by_waves, by_rays = (
        np.mean([getattr(each, name) for each in found], axis=0) for name in ("again", "again_by_rays")
    )
    assert (by_rays > 0.02).all()
    assert by_waves[:, 3] == pytest.approx(by_rays, rel=0.5)
    assert np.abs(shift_of_multiple(by_waves, WAVELENGTHS)).max() < 0.6  # geometric optics has no colour


def test_only_light_that_is_reflected_again_takes_the_shift_that_is_given_for_it() -> None:
    theta_out = np.array([20.0, 60, 80])
    setup = Setup(np.full(3, 60.0), theta_out, WAVELENGTHS, Coherence(2.0), Kernel.RECIPROCAL, None)
    fields = [gaussian(1.2, gaussian_correlation(6.0), 96, 0.5, seed) for seed in range(4)]
    none, one = (simulated(fields, setup, multiple_seed=1, multiple_shift=shift) for shift in (0.0, 1.0))
    assert none.multiple is not None
    assert none.multiple.brdf[1:].min() > 0.01
    x = 1e-3 * (WAVELENGTHS - 600)
    assert one.computed.brdf - none.computed.brdf == pytest.approx(none.multiple.brdf * x, abs=1e-9)
    assert one.computed.lineage["multiple_shift_per_um"] == [1.0]
    derived = simulated(fields, setup, multiple_seed=1)
    assert derived.multiple is not None
    assert derived.multiple.derived
    share = derived.multiple.again[0] / derived.multiple.at_600(WAVELENGTHS)[0]
    # the straight line that the slope comes from is what the share of the light does
    assert np.polyval(np.polyfit(x, share, 1), x)[-1] - 1 == pytest.approx(0.15 * derived.multiple.slope[0], abs=0.03)
