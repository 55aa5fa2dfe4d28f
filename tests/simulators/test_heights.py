"""Heights that were levelled, filled and characterised are what an independent calculation says they are."""

import numpy as np
import pytest

from simulators.errors import UnfitTopography
from simulators.topographies.heights import HeightField, autocorrelation, filled, levelled, roughness, slopes

PITCH = 0.5
Y, X = np.indices((192, 256)) * PITCH
PERIOD = 32.0


def test_roughness_of_a_sinusoid_is_that_of_its_formula() -> None:
    amplitude = 1.5
    found = roughness(HeightField(amplitude * np.sin(2 * np.pi * X / PERIOD), PITCH, True))
    phase = np.linspace(0, 2 * np.pi, 20001)[1:]
    slope = 2 * np.pi * amplitude / PERIOD * np.cos(phase)
    assert found.sq_um == pytest.approx(amplitude / np.sqrt(2), rel=1e-12)
    assert found.sdq == pytest.approx(2 * np.pi * amplitude / PERIOD / np.sqrt(2), rel=1e-3)
    assert found.sdr == pytest.approx(np.sqrt(1 + slope**2).mean() - 1, rel=2e-3)
    assert found.sal_um == pytest.approx(np.arccos(0.2) / (2 * np.pi) * PERIOD, rel=1e-3)


def test_autocorrelation_of_an_open_patch_is_that_of_its_overlap_with_itself() -> None:
    heights = np.random.default_rng(1).normal(size=(12, 9))
    found = autocorrelation(HeightField(heights, 1.0, False))
    z = heights - heights.mean()
    for down, along in ((0, 0), (2, 3), (-5, 1), (4, -4)):
        pairs = [
            z[y, x] * z[y + down, x + along]
            for y in range(12)
            for x in range(9)
            if 0 <= y + down < 12 and 0 <= x + along < 9
        ]
        assert found[6 + down, 4 + along] == pytest.approx(np.mean(pairs) / np.mean(z**2), rel=1e-9)


def test_a_tilted_plane_has_its_slope_and_area_before_levelling_and_none_after() -> None:
    tilted = HeightField(3 + 0.1 * X - 0.2 * Y, PITCH, False)
    np.testing.assert_allclose(slopes(tilted), np.broadcast_to([0.1, -0.2], (191, 255, 2, 2)), atol=1e-12)
    assert roughness(tilted).sdr == pytest.approx(np.sqrt(1.05) - 1, rel=1e-9)
    np.testing.assert_allclose(levelled(tilted).heights_um, 0, atol=1e-10)


def test_levelling_ignores_what_was_not_measured_and_keeps_it_missing() -> None:
    heights = 0.1 * X - 0.2 * Y
    heights[10:60, 20:90] = np.nan
    flat = levelled(HeightField(heights, PITCH, False)).heights_um
    np.testing.assert_array_equal(np.isnan(flat), np.isnan(heights))
    np.testing.assert_allclose(flat[~np.isnan(heights)], 0, atol=1e-10)


@pytest.mark.parametrize("periodic", [True, False])
def test_filling_invents_nothing_where_the_surroundings_are_smooth(periodic: bool) -> None:
    # exp(k x) cos(k y) solves Laplace's equation, as a membrane does
    k = 2 * np.pi / PERIOD
    true = np.exp(-k * Y) * np.cos(k * X)
    heights = true.copy()
    heights[80:100, 40:60] = np.nan
    heights[60:70, :3] = heights[60:70, -2:] = np.nan  # at the side, where a periodic patch goes on
    found = filled(HeightField(heights, PITCH, periodic)).heights_um
    lost = np.isnan(heights)
    np.testing.assert_array_equal(found[~lost], true[~lost])
    inner = np.zeros_like(lost)
    inner[80:100, 40:60] = True
    assert np.abs(found - true)[inner].max() < 1e-3 * true[80, :].max()
    if periodic:
        assert np.abs(found - true)[lost].max() < 2e-3 * true[60, :].max()


def test_a_single_lost_height_is_the_mean_of_its_four_neighbours_across_the_seam() -> None:
    heights = np.random.default_rng(2).normal(size=(6, 7))
    expected = (heights[1, 0] + heights[-1, 0] + heights[0, 1] + heights[0, -1]) / 4
    heights[0, 0] = np.nan
    assert filled(HeightField(heights, 1.0, True)).heights_um[0, 0] == pytest.approx(expected, rel=1e-12)


def test_a_topography_that_is_none_is_refused_with_the_reason() -> None:
    holes = np.zeros((4, 4))
    holes[1, 1] = np.nan
    with pytest.raises(UnfitTopography, match="lacks 1 of its 16 heights; fill it first"):
        roughness(HeightField(holes, 1.0, False))
    with pytest.raises(UnfitTopography, match="not 0 um"):
        HeightField(np.zeros((4, 4)), 0.0, True)
    with pytest.raises(UnfitTopography, match="2 x 2"):
        HeightField(np.zeros(16), 1.0, True)
    with pytest.raises(UnfitTopography, match="no heights at all"):
        filled(HeightField(np.full((4, 4), np.nan), 1.0, True))
    assert np.isnan(roughness(HeightField(np.zeros((4, 4)), 1.0, False)).sal_um)
