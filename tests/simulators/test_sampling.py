"""A user who samples a topography too coarsely is told so, and refinement cures it."""

import numpy as np
import pytest

from simulators.topographies.heights import HeightField
from simulators.waves.sampling import refined, sampling


def sine(count: int, pitch_um: float, period_um: float, height_um: float, rows: int = 20) -> HeightField:
    """A grating along x."""
    x = np.arange(count) * pitch_um
    return HeightField(np.tile(height_um * np.sin(2 * np.pi * x / period_um), (rows, 1)), pitch_um, periodic=True)


@pytest.mark.parametrize("turned", [False, True])
def test_the_pitch_that_is_asked_for_is_that_of_the_steepest_slope(turned: bool) -> None:
    along = sine(2000, 0.02, 10.0, 0.5, rows=4)
    field = HeightField(along.heights_um.T, 0.02, periodic=True) if turned else along
    told = sampling(field, np.array([-5.0, 2.0]), np.array([20.0, 21.0]), 8.0)
    slope = 2 * np.pi * 0.5 / 10
    fastest = (21 * slope if turned else 5 + 20 * slope) + 4 / 8
    assert told.needed_um == pytest.approx(2 * np.pi / fastest, rel=1e-3)
    assert told.sufficient
    assert told.aliasing == 0
    assert told.times == 1


def test_a_coarse_map_says_how_much_of_it_is_too_steep_and_what_would_do() -> None:
    field = sine(2000, 0.5, 1000 / 97, 0.5)
    told = sampling(field, np.array([0.0]), np.array([60.0]), 1e6)
    limit = 2 * np.pi / 0.5 / 60
    share = 2 / np.pi * np.arccos(limit / (2 * np.pi * 0.5 / (1000 / 97)))
    assert not told.sufficient
    assert told.aliasing == pytest.approx(share, abs=0.02)
    assert told.times == 2
    assert "pitch of 0.5 um" in told.message
    assert "refine it 2 times" in told.message


def test_level_ground_needs_no_refinement_at_the_mirror_direction() -> None:
    told = sampling(HeightField(np.zeros((4, 4)), 1.0, periodic=False), np.zeros(2), np.ones(2), 10.0)
    assert (told.sufficient, told.times) == (True, 1)


@pytest.mark.parametrize("periodic", [False, True])
def test_refinement_follows_the_surface_between_its_points(periodic: bool) -> None:
    def surface(count: int, pitch_um: float) -> np.ndarray:
        place = np.arange(count) * pitch_um
        return np.asarray(np.sin(2 * np.pi * place / 32) + np.cos(2 * np.pi * place / 16)[:, None])

    finer = refined(HeightField(surface(64, 1.0), 1.0, periodic), 4)
    assert finer.pitch_um == 0.25
    assert finer.heights_um == pytest.approx(surface(256 if periodic else 253, 0.25), abs=2e-3)
