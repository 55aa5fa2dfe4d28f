"""The simulated camera: neutral white, photon noise, pixels, and photographs that read back as what was rendered."""

from pathlib import Path

import numpy as np
import pytest

from goniometer.errors import InputError
from goniometer.photographs.photos import read_series
from simulators.photographs.camera import Scene, Sensor, lighting_for, photograph, response, scene
from simulators.photographs.session import PANEL_REFLECTANCE, convergence, take_series
from simulators.topographies.heights import HeightField
from simulators.topographies.synthesis import gaussian, gaussian_correlation
from simulators.waves.speckle import Lens

LENS = Lens(f_number=8, magnification=1, theta_out=30)
ANGLES = (10.0, 20.0)


@pytest.fixture(scope="module")
def rough() -> HeightField:
    return gaussian(0.4, gaussian_correlation(4.0), 512, 0.2, seed=4)


@pytest.fixture(scope="module")
def taken(rough: HeightField) -> Scene:
    return scene(rough, LENS, [lighting_for(rough, LENS, angle, 1.0) for angle in ANGLES])


def test_a_white_panel_is_white_before_and_after_the_colour_matrix() -> None:
    camera = response(1 / np.linspace(1 / 400, 1 / 700, 31))
    assert camera.weights.sum(axis=0) == pytest.approx([1, 1, 1])
    assert camera.colour_matrix.sum(axis=1) == pytest.approx([1, 1, 1])
    assert camera.weights.min() >= 0
    # each filter passes most where it should
    red, green, blue = camera.wavelengths @ camera.weights
    assert blue < 500 < green < 575 < red


def test_noise_is_that_of_photons_and_read_out() -> None:
    sensor = Sensor()
    values = np.full((200, 200, 3), 0.3)
    exposure = 0.02
    counts = sensor.counts(values, np.ones(3), exposure, seed=1).astype(float)
    electrons = (counts - sensor.black_level) * sensor.full_well / (65535 - sensor.black_level)
    expected = (0.3 * sensor.panel + sensor.dark_current) * exposure
    assert electrons.mean() == pytest.approx(expected, rel=1e-3)
    assert electrons.var() == pytest.approx(expected + sensor.read_noise**2, rel=0.02)
    dark = sensor.counts(np.zeros((200, 200, 3)), np.ones(3), 1 / 8000, seed=2)
    assert dark.min() > 0  # the black level keeps the noise of dark pixels whole
    assert sensor.exposure(values, np.ones(3)) * 0.3 * sensor.panel < 0.7 * sensor.full_well


def test_pixels_keep_the_mean_and_see_more_along_the_plane_of_incidence(taken: Scene) -> None:
    fine, coarse = (photograph(taken, Sensor(pixel_um=p), 0) for p in (1.0, 4.88))
    assert fine.shape[:2] == (102, int(512 * 0.2 * np.cos(np.radians(30))))
    assert coarse.mean(axis=(0, 1)) == pytest.approx(fine.mean(axis=(0, 1)), rel=0.06)
    assert coarse.std() < fine.std()


def test_photographs_read_back_as_what_the_camera_saw(taken: Scene, tmp_path: Path) -> None:
    path, colours = take_series(taken, Sensor(), "Rough", tmp_path, seed=1, done=lambda _: None)
    series = read_series(path, inset=1.0)
    assert [photo.angle for photo in series.photos] == [10, 20]
    assert series.pixel_um == pytest.approx(4.88)
    for i, photo in enumerate(series.photos):
        seen = photograph(taken, Sensor(), i)
        columns = (seen.shape[1] - photo.inset.shape[1]) // 2
        assert columns == 0
        rows = (seen.shape[0] - photo.inset.shape[0]) // 2
        inner = seen[rows : rows + photo.inset.shape[0]]
        usable = ~photo.saturated
        assert photo.inset[usable].mean(axis=0) * PANEL_REFLECTANCE == pytest.approx(
            inner[usable].mean(axis=0), rel=0.01
        )
        assert seen.mean(axis=(0, 1)) == pytest.approx(colours[i])


def test_twice_as_many_wavelengths_and_points_of_the_lamp_change_nothing(rough: HeightField, taken: Scene) -> None:
    found = convergence(rough, taken, [lighting_for(rough, LENS, ANGLES[1], 1.0, finer=2)], Sensor())
    assert found.reached, found.message


def test_a_lamp_that_is_not_collimated_is_refused(rough: HeightField) -> None:
    with pytest.raises(InputError, match="0 to 10 degrees"):
        lighting_for(rough, LENS, ANGLES[0], 20.0)
