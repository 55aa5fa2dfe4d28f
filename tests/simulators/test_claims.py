"""What docs/diffraction-claims.md says of spectra, on a surface small enough to compute at each test."""

import numpy as np
import pytest

from drivers.arrays import FloatArray
from simulators.topographies.heights import HeightField
from simulators.topographies.synthesis import sandblasted, with_micro_roughness
from simulators.waves.diffraction import seen_through
from simulators.waves.sampling import refined
from simulators.waves.waves import averaged, averaged_brdf

NM = np.linspace(450.0, 750.0, 7)
THETA_M = np.concatenate([np.arange(-40.0, -29.0), np.arange(-5.0, 6.0)])
THETA_IN = np.full(THETA_M.size, 40.0)


@pytest.fixture(scope="module")
def craters() -> HeightField:
    return refined(sandblasted((35.0, 50.0), 0.6, 2.0, 640, 0.2, seed=5).field, 2)


def slopes(field: HeightField) -> tuple[float, float]:
    """Mean m, 1/um, near the mirror direction and at theta_m from 30 to 40 degrees towards the lamp."""
    theta_out = THETA_IN + 2 * THETA_M
    surface = averaged(field, THETA_IN, theta_out, NM, seen_through(1.0))
    brdf: FloatArray = averaged_brdf(surface, THETA_IN, theta_out, NM).brdf
    brdf = brdf + averaged_brdf(surface, -THETA_IN, -theta_out, NM).brdf
    rise, level = np.polyfit((NM - 600) / 1000, brdf.T, 1)
    return float((rise / level)[THETA_M > -6].mean()), float((rise / level)[THETA_M < -6].mean())


def test_smooth_craters_reflect_without_colour_around_the_mirror_direction(craters: HeightField) -> None:
    assert slopes(craters)[0] == pytest.approx(0, abs=0.4)


def test_micro_roughness_makes_the_mirror_direction_red_and_the_directions_around_it_blue(craters: HeightField) -> None:
    near, far = slopes(with_micro_roughness(craters, seed=2))
    assert near > 0.7
    assert far < -1.2
