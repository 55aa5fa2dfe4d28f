"""Numbers of photographs: uncertainties against repetition, contrast of known patterns, colours by colour-science."""

import colour
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from analysis.colour import rgb_to_xyz, xyz_to_rgb
from analysis.photo_statistics import (
    BACKWARD_TILT,
    FORWARD_TILT,
    independent_values,
    photo_statistics,
    shown_photo,
    without_slow_variation,
)
from analysis.reports.photographs import photo_page, photo_remarks
from drivers.arrays import BoolArray, FloatArray
from goniometer.photographs.photos import Photo, PhotoSeries


def speckle(rng: np.random.Generator, size: int, width: float) -> FloatArray:
    """Intensity of expectation one: a circular Gaussian field of Gaussian correlation, cut out of a larger one."""
    field = gaussian_filter(rng.normal(size=(2, 2 * size, 2 * size)), (0, width, width), mode="wrap")
    return np.asarray((field**2).sum(axis=0)[:size, :size] * 2 * np.pi * width**2)


def series_of(
    insets: list[FloatArray], angles: list[float] | None = None, saturated: BoolArray | None = None
) -> PhotoSeries:
    none = np.zeros(insets[0].shape[:2], dtype=bool)
    photos = tuple(
        Photo(angle, 0.1, inset.astype(np.float32), none if saturated is None else saturated, inset.astype(np.float32))
        for angle, inset in zip(angles or [float(i) for i in range(len(insets))], insets, strict=True)
    )
    return PhotoSeries("Sample 1", 45.0, photos, (1.5, 1.0, 2.0), 0.0, 1.0, None, None)


def test_the_stated_uncertainty_of_red_over_blue_is_its_scatter() -> None:
    rng = np.random.default_rng(11)
    # half of the blue pattern is that of the red one
    insets = []
    for _ in range(150):
        red, other = (speckle(rng, 48, 2.0) for _ in range(2))
        insets.append(np.stack([1.2 * red, red, 0.5 * (red + other)], axis=-1))
    found = photo_statistics(series_of(insets))
    ratios = np.array([s.red_over_blue for s in found])
    stated = np.sqrt(np.mean([s.u_red_over_blue**2 for s in found]))
    assert ratios.mean() == pytest.approx(1.2, abs=3 * stated / 150**0.5)
    assert stated == pytest.approx(ratios.std(), rel=0.15)


def test_independent_values_are_counted_by_the_area_of_a_speckle() -> None:
    rng = np.random.default_rng(12)
    # |field correlation|^2 = exp(-r^2 / (2 w^2)) has the area 2 pi w^2 (Goodman 2007, section 4.6)
    counts = [independent_values(without_slow_variation(speckle(rng, 96, 2.0))) for _ in range(10)]
    assert np.mean(counts) == pytest.approx(96**2 / (2 * np.pi * 2.0**2), rel=0.2)
    white = rng.normal(size=(64, 64))
    assert independent_values(white) == pytest.approx(64**2, rel=0.1)
    assert independent_values(np.zeros((8, 8))) == 64


def test_contrast_is_one_of_laser_speckle_and_knows_no_slow_variation() -> None:
    rng = np.random.default_rng(13)
    pattern = speckle(rng, 256, 1.5)
    slope = 1 + 0.5 * np.linspace(-1, 1, 256)
    flat, tilted, smooth = (
        photo_statistics(series_of([np.repeat(image[..., None], 3, axis=-1)] * 2))[0]
        for image in (pattern, pattern + slope, np.tile(slope, (256, 1)))
    )
    assert flat.contrast == pytest.approx(1, abs=0.05)
    assert flat.contrast_rgb == pytest.approx([flat.contrast] * 3, rel=1e-4)
    assert tilted.contrast == pytest.approx(flat.contrast / 2, rel=0.03)
    assert smooth.contrast == pytest.approx(0, abs=1e-6)


def test_colours_are_those_of_colour_science() -> None:
    rgb = np.array([1.3, 1.0, 0.8])
    found = photo_statistics(series_of([np.broadcast_to(rgb, (20, 20, 3)).copy()] * 2))[0]
    xyz = colour.RGB_to_XYZ(rgb, "sRGB", apply_cctf_decoding=False)
    assert found.luminance == pytest.approx(xyz[1], rel=1e-3)
    assert found.chromaticity == pytest.approx(colour.XYZ_to_xy(xyz), abs=2e-4)
    lab = [colour.XYZ_to_Lab(v / v[1]) for v in (xyz, colour.RGB_to_XYZ(np.ones(3), "sRGB"))]
    assert found.delta_e == pytest.approx(colour.delta_E(*lab), abs=0.05)
    assert found.red_over_blue == pytest.approx(1.3 / 0.8)
    assert xyz_to_rgb(rgb_to_xyz(rgb)) == pytest.approx(rgb)


def test_forward_and_backward_are_seen_as_from_the_camera_and_what_is_overexposed_is_left_out() -> None:
    angles = [float(a) for a in range(-70, 71, 5)]
    series = series_of([np.ones((20, 20, 3))] * len(angles), angles)
    shown = [shown_photo(series, tilt) for tilt in (FORWARD_TILT, BACKWARD_TILT)]
    assert [angles[i] for i in shown if i is not None] == [25, -20]
    burnt = series_of([np.ones((20, 20, 3))] * 2, saturated=np.eye(20, dtype=bool))
    assert shown_photo(burnt, FORWARD_TILT) is None
    statistics = photo_statistics(burnt)
    assert "0°, 1°" in photo_remarks(burnt, statistics)[0]
    assert "nothing to show" in photo_page([burnt], [statistics])


def test_a_dark_photograph_has_no_colour_and_spoils_no_page() -> None:
    series = series_of([np.zeros((20, 20, 3)), np.ones((20, 20, 3))], [-20.0, 25.0])
    found = photo_statistics(series)
    assert np.isnan(found[0].red_over_blue)
    assert np.isnan(found[0].contrast)
    page = photo_page([series], [found])
    assert page.count("<svg") == 3
    assert page.count("data:image/png") == 2
