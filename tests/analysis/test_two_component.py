"""The shift of two components stands for what one cosine cannot, and turns into the cosine where that is enough."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from analysis.errors import OutOfRange
from analysis.reflectance.directions import in_plane
from analysis.reflectance.models import cosine_slope, shift, theta_m
from analysis.reflectance.two_component import (
    mixed_slope,
    two_component_slope,
    two_component_slope_derivative,
)
from drivers.arrays import FloatArray

_GRID = np.meshgrid(np.arange(0.0, 81, 10), np.arange(-80.0, 81, 4), indexing="ij")
_SEEN = np.abs(_GRID[0] + _GRID[1]) >= 5
THETA_IN, THETA_OUT = _GRID[0][_SEEN], _GRID[1][_SEEN]
DIRECTIONS = in_plane(THETA_IN, THETA_OUT)
TO_MIRROR, TO_LAMP = np.abs(THETA_OUT - THETA_IN) / 2, np.abs(THETA_OUT + THETA_IN) / 2
"""theta_m and theta_d, degrees."""


@pytest.mark.parametrize("threshold", [0.0, 0.4])
def test_without_sharpness_and_light_from_behind_it_is_the_papers_cosine(threshold: float) -> None:
    cosine = cosine_slope(theta_m(DIRECTIONS), 1.2, 4.5, 0.1)
    np.testing.assert_allclose(two_component_slope(DIRECTIONS, 1.2, 4.5, 0.1, 0, 0, threshold), cosine, atol=1e-14)
    nearly = two_component_slope(DIRECTIONS, 1.2, 4.5, 0.1, 0, 1e-6, threshold)
    np.testing.assert_allclose(nearly, cosine, atol=1e-5)


def test_the_share_is_that_of_two_lobes_and_the_shift_is_the_sum_of_two() -> None:
    h, w, t_y, kappa, sharpness, threshold = 0.8, 2.1, 0.1, 0.7, 6.0, 0.3
    b = np.sqrt(sharpness)
    single = np.exp(2 * b * np.cos(w * np.radians(TO_MIRROR)))
    multiple = np.exp(2 * b * (threshold + kappa * np.cos(w * np.radians(TO_LAMP))))
    share = multiple / (single + multiple)

    level = np.tanh(b * threshold)
    m_1, m_2 = t_y + h * (level + 1) / b, t_y + h * (level - 1) / b
    wavelengths = np.array([450.0, 600, 750])
    x = (wavelengths - 600) * 1e-3
    both = (1 - share[:, None]) * (1 + m_1 * x) + share[:, None] * (1 + m_2 * x)
    slope = two_component_slope(DIRECTIONS, h, w, t_y, kappa, sharpness, threshold)
    np.testing.assert_allclose(shift(slope, wavelengths), both, rtol=1e-7)
    np.testing.assert_allclose(mixed_slope(share, m_1, m_2), slope, rtol=1e-7, atol=1e-9)


def test_forward_and_backward_shift_compensate_at_normal_incidence_and_part_beyond_it() -> None:
    slope = two_component_slope(DIRECTIONS, 0.6, 2.0, 0.05, 1.0, 3.0)
    np.testing.assert_allclose(slope[THETA_IN == 0], 0.05, atol=1e-12)
    oblique = slope[THETA_IN == 60]
    assert oblique[THETA_OUT[THETA_IN == 60] == 60] > 0.3
    assert oblique[THETA_OUT[THETA_IN == 60] == -52] < -0.2


def _lobes(strength: float, single: float, multiple: float) -> FloatArray:
    """Share of multiple reflections of two Gaussian lobes, their widths in degrees: not the form of the model."""
    ratio = strength * np.exp(TO_MIRROR**2 / (2 * single**2) - TO_LAMP**2 / (2 * multiple**2))
    return np.asarray(ratio / (1 + ratio))


@pytest.mark.parametrize(
    ("share", "cosine_misses"),
    [(_lobes(1.0, 20.0, 30.0), 0.4), (_lobes(0.02, 7.0, 90.0), 0.3)],
    ids=["compensating, as SRS-02 sanded with grit 1000", "fast transition, as a smooth metal"],
)
def test_slopes_that_one_cosine_misses_are_fitted(share: FloatArray, cosine_misses: float) -> None:
    truth = mixed_slope(share, 0.7, -0.4)
    spread = truth.std()

    def missed_by_cosine(w: float) -> float:
        columns = np.stack([np.cos(w * np.radians(TO_MIRROR)), np.ones_like(truth)], axis=1)
        left = columns @ np.linalg.lstsq(columns, truth, rcond=None)[0] - truth
        return float(left.std() / spread)

    assert min(missed_by_cosine(w) for w in np.arange(0.2, 12, 0.1)) > cosine_misses

    def residual(p: FloatArray) -> FloatArray:
        return two_component_slope(DIRECTIONS, *p) - truth

    def jacobian(p: FloatArray) -> FloatArray:
        return two_component_slope_derivative(DIRECTIONS, *p)[1].T

    lower, upper = [-20, 0.3, -5, -1, 0, -1], [20, 10, 5, 3, 3e3, 1]
    starts = [(1.0, w, 0.0, kappa, 4.0, threshold) for w in (1.5, 3) for kappa in (0, 0.8) for threshold in (0, 0.6)]
    fits = [least_squares(residual, s, jacobian, bounds=(lower, upper), x_scale="jac", max_nfev=80) for s in starts]
    assert min(fit.fun.std() for fit in fits) < 0.02 * spread


def test_what_is_no_share_and_no_sharpness_is_refused() -> None:
    with pytest.raises(OutOfRange, match=r"from 0\.2 to 1\.1; it must lie between 0 and 1"):
        mixed_slope(np.array([0.2, 1.1]), 0.5, -0.5)
    with pytest.raises(OutOfRange, match="must not be negative"):
        two_component_slope(DIRECTIONS, 1.0, 2.0, sharpness=-1.0)
