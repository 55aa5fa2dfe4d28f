"""The budget against a Monte Carlo of the whole chain (JCGM 101:2008, GUM Supplement 1).

Every error is drawn from its stated uncertainty, a measurement of sample and panel is computed forwards to raw counts,
and calibrated. The scatter of the results is what the budget must state: in each cell, and for quantities that are
made from many cells, where shared errors decide.
"""

from dataclasses import replace

import numpy as np
import pytest

from goniometer.certificates.certificate import NOMINAL_SRS99
from goniometer.geometry import Geometry
from goniometer.radiometry.calibration import calibrate
from goniometer.uncertainty import covariance_by_source
from tests.goniometer.forward import DATA, Bench, Wrong, lobe, spectralon

DRAWS = 240
SAMPLE_ANGLES = [Geometry(t, float(o)) for t in (30.0, 60.0) for o in (-10, 5, 20, 25, 30, 35, 40, 50, 60, 65, 75)]
REFERENCE_ANGLES = [Geometry(t, float(o)) for t in (30.0, 60.0) for o in (-10, 10, 30, 50, 75)]
BRDF = lobe(0.18)


def draw(seed):
    """What is wrong this time."""
    normal = np.random.default_rng([seed, 7]).normal
    return Wrong(
        sample_zero=normal(0, DATA.u_zero),
        detector_zero=normal(0, DATA.u_zero),
        position=DATA.u_angle,
        wavelength=normal(0, DATA.u_wavelength),
        nonlinearity=normal(0, DATA.u_nonlinearity),
        panel=tuple(normal(size=4)),
        aperture=normal(0, DATA.u_aperture),
    )


def measure(seed):
    """Counts of the panel, then of the sample, calibrated as if nothing were wrong."""
    wrong = draw(seed)
    bench = Bench(wrong, seed)
    reference = bench.scan(REFERENCE_ANGLES, spectralon(wrong), 20.0, scan_id=1)
    sample = bench.scan(SAMPLE_ANGLES, BRDF, 4.0, scan_id=2)
    lamp = np.random.default_rng([seed, 8]).normal(0, np.sqrt(2) * DATA.u_lamp)
    dataset = calibrate(sample, reference, NOMINAL_SRS99)
    stray = np.random.default_rng([seed, 9]).normal(0, DATA.u_stray_light)
    # a lamp that nobody watched, and stray light that nobody measured, enter at the end as they would in the counts
    coloured = 1 + lamp * np.maximum(600 / dataset.wavelengths, 1)
    panel = NOMINAL_SRS99.brdf(dataset.theta_in, dataset.theta_out, dataset.wavelengths)
    veil = stray / np.cos(np.radians(dataset.theta_in))[:, None] * (1 - dataset.brdf / panel)
    return replace(dataset, brdf=dataset.brdf * coloured + veil)


@pytest.fixture(scope="module")
def datasets():
    """All draws."""
    return [measure(seed) for seed in range(DRAWS)]


@pytest.mark.slow
def test_the_stated_uncertainty_is_the_scatter_of_measurements_with_every_error_drawn(datasets):
    values = np.array([d.brdf for d in datasets])
    stated = np.sqrt(np.mean([d.u**2 for d in datasets], axis=0))
    ratio = values.std(axis=0, ddof=1) / stated
    sampling = 1 / np.sqrt(2 * DRAWS)
    print(f"scatter / stated: mean {ratio.mean():.3f}, {ratio.min():.3f} to {ratio.max():.3f}; sampling {sampling:.3f}")
    # cells share most of their errors, so their mean is no better known than a few of them
    assert ratio.mean() == pytest.approx(1, abs=2 * sampling)
    assert np.all(np.abs(ratio - 1) < 4.5 * sampling)


@pytest.mark.slow
def test_sums_and_contrasts_of_many_cells_have_the_uncertainty_that_shared_errors_give_them(datasets):
    shape = datasets[0].brdf.shape
    red, blue = datasets[0].wavelengths > 700, datasets[0].wavelengths < 550
    quantities = np.zeros((4, *shape))
    quantities[0] = 1 / np.prod(shape)  # mean over all cells
    quantities[1, :11], quantities[1, 11:] = 1 / 11, -1 / 11  # one incident angle against the other
    quantities[2, 4, red], quantities[2, 4, blue] = 1 / red.sum(), -1 / blue.sum()  # colour of one point
    quantities[3, 3], quantities[3, 5] = 1, -1  # one flank of the lobe against the other
    values = np.array([[np.sum(q * d.brdf) for q in quantities] for d in datasets])
    variances = [sum(np.diag(c) for c in covariance_by_source(quantities, d.sources).values()) for d in datasets[:20]]
    ratio = values.std(axis=0, ddof=1) / np.sqrt(np.mean(variances, axis=0))
    print("scatter / stated of sum, contrast, colour and flanks:", np.round(ratio, 3))
    assert ratio == pytest.approx(np.ones(4), abs=4 / np.sqrt(2 * DRAWS))
