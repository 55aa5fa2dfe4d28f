"""Invented surfaces have the roughness, the dents and the spectrum that were asked for."""

import numpy as np
import pytest
from scipy import ndimage, stats

from simulators.errors import UnfitTopography
from simulators.materials.materials import SAMPLES
from simulators.topographies.heights import autocorrelation, roughness
from simulators.topographies.synthesis import (
    brushed,
    gaussian,
    gaussian_correlation,
    sandblasted,
    sandblasted_sample,
    with_micro_roughness,
)


@pytest.mark.parametrize("name", ["sample-1", "sample-7", "sample-8"])
def test_a_blasted_sample_is_as_rough_as_table_1_says_and_as_bare_as_its_coverage_leaves_it(name: str) -> None:
    sample = SAMPLES[name]
    made = sandblasted_sample(sample, 320, 1.25, seed=1)
    assert roughness(made.field).sq_um == pytest.approx(sample.roughness_rms_um, rel=2e-4)
    assert made.bare == pytest.approx(np.exp(-1.0 if name == "sample-8" else -3.0), abs=0.05)
    assert sample.abrasive_um is not None
    assert made.depth_um < sample.abrasive_um[1] / 2


def test_dents_are_spherical_caps_of_the_beads_they_were_made_with() -> None:
    bead = 80.0
    made = sandblasted((bead, bead), 0.3, 0.05, 1024, 0.625, seed=4)
    depth = made.field.heights_um.max() - made.field.heights_um
    labels, count = ndimage.label(depth > 0)
    alone = 0
    for label in range(1, count + 1):
        here = labels == label
        rows, columns = np.nonzero(here)
        d = depth[here].max()
        if min(rows.min(), columns.min()) == 0 or max(rows.max(), columns.max()) == 1023:
            continue  # cut by the side of the patch
        area = np.pi * (bead * d - d**2)
        if here.sum() * 0.625**2 < 1.05 * area:  # it overlaps with no other
            assert here.sum() * 0.625**2 == pytest.approx(area, rel=0.03)
            assert depth[here].sum() * 0.625**2 == pytest.approx(np.pi * d**2 * (1.5 * bead - d) / 3, rel=0.03)
            assert made.depth_um / 2 * 0.999 < d <= made.depth_um
            alone += 1
    assert alone > 5


def test_the_same_seed_gives_the_same_surface_and_another_seed_another() -> None:
    one, same, other = (sandblasted((70, 100), 1.2, 2.0, 256, 1.25, seed).field.heights_um for seed in (1, 1, 2))
    np.testing.assert_array_equal(one, same)
    assert abs(np.corrcoef(one.ravel(), other.ravel())[0, 1]) < 0.3


def test_a_gaussian_surface_has_the_rms_and_the_correlation_that_were_asked_for() -> None:
    length = 6.0
    field = gaussian(0.8, gaussian_correlation(length), 1024, 1.0, seed=3)
    areas = 1024**2 / (np.pi * length**2)
    found = roughness(field)
    assert found.sq_um == pytest.approx(0.8, rel=3 / np.sqrt(2 * areas))
    assert found.sal_um == pytest.approx(length * np.sqrt(np.log(5)), rel=0.02)
    # forward differences of exp(-r^2 / length^2) over one um, in both directions
    assert found.sdq == pytest.approx(0.8 * np.sqrt(4 * (1 - np.exp(-1 / length**2))), rel=0.02)
    assert stats.kurtosis(field.heights_um.ravel()) == pytest.approx(0, abs=0.1)


def test_brushing_runs_along_x_with_strokes_as_long_and_wide_as_asked() -> None:
    correlation = autocorrelation(brushed(0.3, 3.0, 60.0, 1024, 1.0, seed=6))
    assert correlation[512 + 3, 512] == pytest.approx(np.exp(-1), abs=0.04)
    assert correlation[512, 512 + 60] == pytest.approx(np.exp(-1), abs=0.08)


def test_fine_roughness_adds_its_own_and_changes_nothing_else() -> None:
    smooth = gaussian(0.5, gaussian_correlation(8.0), 512, 0.1, seed=1)
    fine = with_micro_roughness(smooth, seed=2).heights_um - smooth.heights_um
    assert fine.std() == pytest.approx(0.04, rel=0.02)
    assert np.mean(fine[:, 2:] * fine[:, :-2]) / fine.var() == pytest.approx(np.exp(-1), abs=0.02)


def test_what_cannot_be_made_is_refused_with_the_reason() -> None:
    with pytest.raises(UnfitTopography, match="was polished, not sandblasted"):
        sandblasted_sample(SAMPLES["sample-6"], 64, 5.0, seed=1)
    with pytest.raises(UnfitTopography, match="cannot make a roughness of 20 um"):
        sandblasted((70, 100), 20.0, 2.0, 64, 10.0, seed=1)
    with pytest.raises(UnfitTopography, match="smaller than a bead"):
        sandblasted((70, 100), 1.0, 2.0, 64, 1.0, seed=1)
    with pytest.raises(UnfitTopography, match=r"needs 0\.1 um or less"):
        with_micro_roughness(gaussian(1.0, gaussian_correlation(8.0), 64, 0.5, seed=1), seed=2)
    with pytest.raises(UnfitTopography, match="four strokes long"):
        brushed(0.3, 3.0, 60.0, 64, 1.0, seed=1)
