"""What the bench knows comes back from wire to fit, within the stated uncertainty."""

import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from analysis.fits.brdf_fit import brdf_fit
from api.commands.demo import SAMPLES
from goniometer.campaigns.campaign import Campaign
from goniometer.radiometry.calibration import calibrate_scan
from goniometer.storage.store import Store
from simulators.materials.materials import SAMPLES as MATERIALS
from tests.benchmarks.measured import measure

SEEDS = range(1, 11)


def z_scores(folder: Path, seed: int) -> list[list[float]]:
    """(fitted - true) / standard error of alpha, h and w, for Samples 1 and 4, measured with this seed."""
    store = Store.open(folder / f"{seed}.db")
    campaign = Campaign(
        name="Recovery", seed=seed, samples=SAMPLES[:2], incident=(0.0, 20.0, 40.0, 60.0, 80.0), monitor=None
    )
    found = []
    for scan in measure(store, campaign):
        if scan.kind == "sample":
            fit = brdf_fit(calibrate_scan(store, scan.id))
            assert fit.verdict.trusted
            truth = MATERIALS[scan.material]
            found.append([(p.value - getattr(truth, p.name)) / p.standard_error for p in fit.parameters])
    return found


@pytest.mark.slow
def test_alpha_h_and_w_lie_within_three_standard_errors_of_the_truth_for_ten_seeds(tmp_path: Path) -> None:
    with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn")) as executor:
        scores = np.array(list(executor.map(z_scores, [tmp_path] * len(SEEDS), SEEDS)))
    assert scores.shape == (10, 2, 3)
    print(f"z scores of alpha, h, w: rms {np.sqrt((scores**2).mean(axis=(0, 1)))}, largest {np.abs(scores).max():.2f}")
    assert np.abs(scores).max() < 3
    # Standard errors that are honest are not too large either: the scores of an honest error have an rms of one.
    assert np.sqrt((scores**2).mean()) > 0.5
