"""In-plane spectra by wave optics: reciprocity, colour of mirrors, Fresnel, ghosts of coarse maps, convergence."""

import warnings

import numpy as np
import pytest

from analysis.reflectance.fresnel import load_conductor
from goniometer.errors import InputError
from simulators.choices import Kernel
from simulators.topographies.heights import HeightField
from simulators.waves.diffraction import Coherence
from simulators.waves.sampling import CoarseSampling, refined
from simulators.waves.waves import averaged, averaged_brdf, obliquity, patch_brdf, scattering_vectors

WAVELENGTHS = np.array([420.0, 600.0, 750.0])


def dimpled(pitch_um: float = 0.25, count: int = 160) -> HeightField:
    """A periodic surface of a few waves in all directions, its slopes up to 0.3."""
    rng = np.random.default_rng(7)
    place = 2 * np.pi * np.arange(count) / count
    heights = np.zeros((count, count))
    for across, along in ((1, 3), (2, -1), (3, 2), (-2, 4), (0, 5), (4, 0)):
        heights += 0.12 * np.sin(across * place[:, None] + along * place + rng.uniform(0, 2 * np.pi))
    return HeightField(heights, pitch_um, periodic=True)


@pytest.mark.parametrize("kernel", [Kernel.RECIPROCAL, Kernel.KIRCHHOFF])
def test_source_and_detector_can_change_places(kernel: Kernel) -> None:
    theta_in, theta_out = np.array([10.0, 30.0, 60.0, 25.0]), np.array([35.0, -20.0, 50.0, 70.0])
    field = dimpled(0.125)
    there = patch_brdf(field, theta_in, theta_out, WAVELENGTHS, Coherence(3.0), kernel)
    back = patch_brdf(field, -theta_out, -theta_in, WAVELENGTHS, Coherence(3.0), kernel)
    assert there.brdf == pytest.approx(back.brdf, rel=1e-5)
    mean = averaged(field, theta_in, theta_out, WAVELENGTHS, Coherence(3.0))
    there, back = (
        averaged_brdf(mean, *pair, WAVELENGTHS, kernel) for pair in ((theta_in, theta_out), (-theta_out, -theta_in))
    )
    assert there.brdf == pytest.approx(back.brdf, rel=1e-5)


def test_all_kernels_agree_in_the_mirror_direction_and_two_of_them_nearly_everywhere() -> None:
    mirror = np.array([0.0, 35.0, 80.0])
    for kernel in Kernel:
        assert obliquity(kernel, mirror, mirror) == pytest.approx([1, 1, 1])
    theta_in, theta_out = np.array([0.0, 20.0]), np.array([30.0, -10.0])
    ratio = obliquity(Kernel.KIRCHHOFF, theta_in, theta_out) / obliquity(Kernel.RECIPROCAL, theta_in, theta_out)
    # |q|^2 / q_z = (cos_i + cos_o) / cos^2 of the angle between half vector and normal
    assert ratio == pytest.approx(1 / np.cos(np.radians((theta_out - theta_in) / 2)) ** 4)


def test_a_mirror_is_neutral_under_a_window_that_grows_and_blue_under_one_that_does_not() -> None:
    field = HeightField(np.zeros((200, 200)), 0.5, periodic=True)
    angle = np.array([45.0])
    growing = patch_brdf(field, angle, angle, WAVELENGTHS, Coherence(10.0)).brdf[0]
    fixed = patch_brdf(field, angle, angle, WAVELENGTHS, Coherence(10.0, grows=False)).brdf[0]
    assert growing == pytest.approx(np.full(3, 4 * np.pi * 10**2 / 0.6**2), rel=1e-3)
    assert fixed * WAVELENGTHS**2 == pytest.approx(np.full(3, fixed[1] * 600**2), rel=1e-3)


def test_aluminium_takes_its_share_at_the_half_vector() -> None:
    field = dimpled(0.125)
    pair = np.array([60.0, 70.0]), np.array([60.0, 50.0])
    perfect, metal = (
        patch_brdf(field, *pair, np.array([600.0]), Coherence(3.0), conductor=c).brdf for c in (None, load_conductor())
    )
    assert metal / perfect == pytest.approx(np.full((2, 1), 0.905557), abs=1e-5)


def test_a_coarse_map_shows_ghosts_its_user_is_told_and_refining_as_told_removes_them() -> None:
    field = HeightField(np.zeros((120, 120)), 1.0, periodic=True)
    ghost = np.degrees(np.arcsin(0.42))
    pair = np.array([0.0, 0.0]), np.array([0.0, ghost])
    with pytest.warns(CoarseSampling, match="pitch of 1 um"):
        coarse = patch_brdf(field, *pair, WAVELENGTHS, Coherence(12.0))
    assert coarse.brdf[1, 0] == pytest.approx(coarse.brdf[0, 0] * np.cos(np.radians(ghost)), rel=1e-3)
    with warnings.catch_warnings():
        warnings.simplefilter("error", CoarseSampling)
        fine = patch_brdf(refined(field, coarse.sampling.times), *pair, WAVELENGTHS, Coherence(12.0))
    assert fine.sampling.sufficient
    assert fine.brdf[1, 0] < 1e-9 * fine.brdf[0, 0]


def test_spectra_of_a_map_as_fine_as_told_do_not_change_when_its_step_is_halved() -> None:
    theta_in, theta_out = (each.ravel() for each in np.meshgrid([0.0, 40.0], np.arange(-70.0, 71, 2), indexing="ij"))
    coarse = dimpled(1.0, 40)
    with pytest.warns(CoarseSampling):
        told = averaged(coarse, theta_in, theta_out, WAVELENGTHS, Coherence(6.0)).sampling.times
    once, twice = (
        averaged_brdf(
            averaged(refined(coarse, times), theta_in, theta_out, WAVELENGTHS, Coherence(6.0)),
            theta_in,
            theta_out,
            WAVELENGTHS,
        ).brdf
        for times in (told, 2 * told)
    )
    lit = twice > 1e-6 * twice.max()
    assert lit.mean() > 0.5
    assert np.abs(once / twice - 1)[lit].max() < 0.01


def test_directions_below_the_surface_are_refused() -> None:
    with pytest.raises(InputError, match="above the surface"):
        scattering_vectors(np.array([0.0]), np.array([90.0]), WAVELENGTHS)
