"""Images in the light that a topography scatters: gratings in closed form, statistics of speckle, the mean BRDF."""

import numpy as np
import pytest
from scipy.special import jv

from analysis.reflectance.directions import Aperture, round_aperture
from drivers.arrays import FloatArray
from goniometer.errors import InputError
from simulators.choices import Kernel
from simulators.errors import UnfitTopography
from simulators.photographs.camera import window_of
from simulators.topographies.heights import HeightField
from simulators.topographies.synthesis import gaussian, gaussian_correlation
from simulators.waves.speckle import Lens, Lighting, image_points, phase_screen, pupil, squared_field
from simulators.waves.waves import averaged, averaged_brdf, obliquity

POINT = Aperture(np.zeros(1), np.zeros(1), np.ones(1))
LENS = Lens(f_number=11, magnification=1, theta_out=30)
MIRROR = 30.0
"""The lens is in the mirror direction."""


def images(field: HeightField, lens: Lens, lighting: Lighting) -> list[FloatArray]:
    """|E|^2 of the first angle, one for each wavelength."""
    screen = phase_screen(field, lens, [lighting])
    points = image_points(screen, lens, lighting.wavelengths)
    return [squared_field(screen, lens, lighting, i, points) for i in range(lighting.wavelengths.size)]


def contrast(image: FloatArray) -> float:
    return float(image.std() / image.mean())


@pytest.fixture(scope="module")
def rough() -> HeightField:
    """So rough, and so finely, that each resolution cell holds many independent places: speckle is fully developed."""
    return gaussian(0.6, gaussian_correlation(2.0), 1024, 0.25, seed=3)


def test_a_grating_shows_fringes_of_its_two_orders_within_the_lens() -> None:
    amplitude, period, size = 0.06, 24.0, 384
    x = 0.5 * np.arange(size)
    field = HeightField(np.tile(amplitude * np.sin(2 * np.pi * x / period), (size, 1)), 0.5, periodic=True)
    # the lens looks between the orders zero and one, and is too narrow for a third
    between = np.degrees(np.arcsin(np.sin(np.radians(30)) - 0.5 * 0.6 / period))
    lighting = Lighting(between, np.array([600.0]), POINT)
    image = images(field, LENS, lighting)[0]
    kz = float(lighting.wave_vectors(LENS)[2][0, 0])
    along, across = pupil(LENS, lighting.wavelengths)
    orders = jv([0, 1], kz * amplitude)
    mean = (orders**2).sum() * (2 * np.pi) ** 2 / (np.pi * along[0] * across[0])
    assert image.mean() == pytest.approx(mean, rel=1e-4)
    visibility = 2 * orders.prod() / (orders**2).sum()
    line = image[0]
    assert np.ptp(image, axis=0).max() < 1e-4 * mean
    fringes = np.abs(np.fft.rfft(line)) / line.size / line.mean()
    assert 2 * fringes[round(size * 0.5 / period)] == pytest.approx(visibility, rel=1e-3)


def test_a_polished_spot_shines_where_it_lies(rough: HeightField) -> None:
    ny, nx = rough.heights_um.shape
    y, x = (np.arange(n) * rough.pitch_um for n in (ny, nx))
    spot = np.hypot(y[:, None] - 60, x - 150) < 15
    field = HeightField(np.where(spot, 0.0, rough.heights_um), rough.pitch_um, periodic=True)
    image = images(field, LENS, Lighting(30.0, np.array([550.0]), POINT))[0]
    bright = image > image.max() / 2
    row, column = (np.flatnonzero(bright.any(axis=axis)).mean() for axis in (1, 0))
    assert row / image.shape[0] * ny * rough.pitch_um == pytest.approx(60, abs=5)
    assert column / image.shape[1] * nx * rough.pitch_um == pytest.approx(150, abs=5)


def test_laser_speckle_of_a_rough_surface_has_the_contrast_one(rough: HeightField) -> None:
    wavelengths = np.array([450.0, 550.0, 650.0])
    found = [
        contrast(image)
        for angle in (10.0, 30.0, 50.0)
        for image in images(rough, LENS, Lighting(angle, wavelengths, POINT))
    ]
    assert np.mean(found) == pytest.approx(1, abs=0.06)


def test_contrast_falls_with_the_root_of_the_number_of_wavelengths_and_of_lamp_points(rough: HeightField) -> None:
    apart = 1 / np.linspace(1 / 430, 1 / 680, 4)
    assert np.diff(Lighting(MIRROR, apart, POINT).wave_vectors(LENS)[2][0]).max() * 0.6 < -1.8
    each = np.array(images(rough, LENS, Lighting(MIRROR, apart, POINT)))
    # patterns that have nothing in common (Goodman, Speckle Phenomena in Optics, section 3.3)
    assert contrast((each / each.mean(axis=(1, 2), keepdims=True)).sum(axis=0)) == pytest.approx(1 / 2, abs=0.06)
    wide = 1.2 * np.degrees(2 * LENS.numerical_aperture)  # further apart than the lens is wide
    for count in (4, 9):
        lamp = Aperture(np.zeros(count), wide * np.arange(count), np.full(count, 1 / count))
        image = images(rough, LENS, Lighting(MIRROR, np.array([550.0]), lamp))[0]
        assert contrast(image) == pytest.approx(count**-0.5, abs=0.06)


def test_neighbouring_wavelengths_share_as_much_of_their_speckle_as_the_roughness_lets_them(rough: HeightField) -> None:
    near = 1 / np.linspace(1 / 550, 1 / 600, 6)
    lighting = Lighting(MIRROR, near, POINT)
    first, *others = (image / image.mean() - 1 for image in images(rough, LENS, lighting))
    kz = lighting.wave_vectors(LENS)[2][0]
    for other, k in zip(others, kz[1:], strict=True):
        shared = (first * other).mean() / np.sqrt((first**2).mean() * (other**2).mean())
        # Gaussian heights (Goodman, section 6.3), and pupils of which the smaller lies within the larger
        expected = np.exp(-(((k - kz[0]) * 0.6) ** 2)) * min(k / kz[0], kz[0] / k) ** 2
        assert shared == pytest.approx(expected, abs=0.12)


def test_a_lamp_that_is_small_against_the_lens_changes_nothing(rough: HeightField) -> None:
    wavelengths = np.array([550.0])
    small = round_aperture(0.02, 2, 6)
    sharp, blurred = (images(rough, LENS, Lighting(20.0, wavelengths, s))[0] for s in (POINT, small))
    assert contrast(blurred) == pytest.approx(contrast(sharp), rel=0.01)


@pytest.mark.filterwarnings("ignore::simulators.waves.sampling.CoarseSampling")
def test_the_mean_brightness_is_the_averaged_brdf(rough: HeightField) -> None:
    angles, wavelengths = np.array([0.0, 20.0, 45.0]), np.array([450.0, 550.0, 650.0])
    lens = Lens(f_number=5.6, magnification=1, theta_out=30)
    screen = phase_screen(rough, lens, lights := [Lighting(float(a), wavelengths, POINT) for a in angles])
    points = image_points(screen, lens, wavelengths)
    out = np.full(3, 30.0)
    mean = averaged(rough, angles, out, wavelengths, window_of(lens))
    expected = averaged_brdf(mean, angles, out, wavelengths).brdf
    square = np.array([[squared_field(screen, lens, light, w, points).mean() for w in range(3)] for light in lights])
    found = square * obliquity(Kernel.HARVEY_SHACK, angles, out)[:, None] / (1e-3 * wavelengths) ** 2
    # the window weighs the same waves by a Gaussian, the lens all alike: some 250 speckles each
    assert found == pytest.approx(expected, rel=0.2)
    assert (found / expected).mean() == pytest.approx(1, abs=0.03)


def test_a_flat_mirror_is_uniform_and_neutral() -> None:
    field = HeightField(np.zeros((256, 256)), 0.5, periodic=True)
    wavelengths = np.array([420.0, 550.0, 680.0])
    shown = images(field, LENS, Lighting(30.0, wavelengths, round_aperture(0.5, 2, 6)))
    level = [image.mean() / w**2 for image, w in zip(shown, wavelengths, strict=True)]
    assert max(contrast(image) for image in shown) < 1e-4
    assert level == pytest.approx([level[0]] * 3, rel=1e-4)


def test_what_the_lens_cannot_see_is_refused_in_words(rough: HeightField) -> None:
    tiny = HeightField(np.zeros((32, 32)), 0.25, periodic=True)
    with pytest.raises(UnfitTopography, match="hardly more than one speckle"):
        phase_screen(tiny, LENS, [Lighting(0.0, np.array([550.0]), POINT)])
    with pytest.raises(InputError, match="stay below 90"):
        phase_screen(rough, LENS, [Lighting(90.0, np.array([550.0]), POINT)])
