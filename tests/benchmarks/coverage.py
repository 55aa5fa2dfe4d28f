"""How often the 95 % interval of a calibrated BRDF holds the truth, on simulated benches that are wrong in every way.

    python -m tests.benchmarks.coverage [SEEDS]

Once with looks at the lamp and at stray light, once without either, when the stated bounds must do. Each seed is
another bench: its zeros, wavelength scale, polynomial, aperture, panel and lamp depart from what is stated of it as the
stated uncertainties allow, and its counts and stages are noisy. Samples 1, 4 and 5 are measured through the drivers,
calibrated, and compared with the truth in every (point, wavelength) cell.
"""

import multiprocessing
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from drivers.arrays import FloatArray
from goniometer.campaigns.campaign import Campaign, Monitor, Reference, Resolution, Sample
from goniometer.constants import BenchData
from goniometer.radiometry.calibration import calibrate_scan
from goniometer.storage.store import Store
from simulators.bench.imperfections import drawn, generator
from simulators.materials.materials import material, true_brdf
from tests.benchmarks.figures import tell
from tests.benchmarks.measured import measure

SAMPLES = ("sample-1", "sample-4", "sample-5")
LAMP_DRIFT = 0.01
COVERAGE_FACTOR = 1.96
"""Of a 95 % interval of a normal distribution."""
BANDS = (380, 420, 500, 600, 700, 800, 900, 995)
"""Edges of the wavelength bands of the table, nm."""
ANGLES = (-85, -60, -30, 0, 30, 60, 75, 86)
"""Edges of the ranges of theta_out, degrees."""


@dataclass(frozen=True)
class Scores:
    """(measured - true) / standard uncertainty of one sample on one bench."""

    sample: str
    theta_out: FloatArray
    """[points] degrees."""
    wavelengths: FloatArray
    """[wavelengths] nm."""
    z: FloatArray
    """[points, wavelengths]"""


def scores(seed: int, watched: bool) -> list[Scores]:
    """One bench; `watched` is one whose lamp and stray light are looked at."""
    campaign = Campaign(
        name="Coverage",
        seed=seed,
        samples=tuple(Sample(name=name, material=name) for name in SAMPLES),
        incident=(10.0, 40.0, 70.0),
        resolution=Resolution(mode="uniform", step=10.0),
        reference=Reference(step=20.0),
        monitor=Monitor() if watched else None,
        stray_light=watched,
    )
    stated = BenchData()
    if watched:
        imperfections = drawn(seed, stated, lamp_drift=LAMP_DRIFT)
    else:
        # a sine of root 2 times the stated lamp, and stray light as it is stated
        stray = abs(float(generator(seed, "unwatched").normal(0, stated.u_stray_light)))
        imperfections = replace(drawn(seed, stated, lamp_drift=np.sqrt(2) * stated.u_lamp), stray_light=stray)

    with tempfile.TemporaryDirectory() as folder:
        store = Store.open(Path(folder) / "bench.db")
        found = []
        for scan in measure(store, campaign, imperfections)[1:]:
            data = calibrate_scan(store, scan.id)
            truth = true_brdf(material(scan.material), data.theta_in, data.theta_out, data.wavelengths)
            found.append(Scores(scan.sample, data.theta_out, data.wavelengths, (data.brdf - truth) / data.u))
        store.close()
    return found


def covered(z: FloatArray) -> float:
    """Share of cells with a value whose interval holds the truth."""
    return float(np.mean(np.abs(z[np.isfinite(z)]) <= COVERAGE_FACTOR))


def run(seeds: range, watched: bool = True) -> list[Scores]:
    """All benches, in two processes."""
    with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn")) as executor:
        return [each for bench in executor.map(scores, seeds, [watched] * len(seeds)) for each in bench]


def report(found: list[Scores]) -> dict[str, float]:
    """Print the tables and return the coverage of each sample."""
    result = {}
    for sample in SAMPLES:
        mine = [s for s in found if s.sample == sample]
        of_bench = np.array([covered(s.z) for s in mine])
        result[sample] = covered(np.concatenate([s.z.ravel() for s in mine]))
        spread = of_bench.std(ddof=1) / np.sqrt(len(mine))
        cells = sum(int(np.isfinite(s.z).sum()) for s in mine)
        print(
            f"{sample}: {100 * result[sample]:.1f} % of {cells} cells (standard error over benches {100 * spread:.1f})"
        )
    print("theta_out / deg, all samples:")
    for low, high in pairwise(ANGLES):
        z = np.concatenate([s.z[(s.theta_out >= low) & (s.theta_out < high)].ravel() for s in found])
        print(f"  {low:4} to {high:3}: {100 * covered(z):.1f} %, rms z {np.sqrt(np.nanmean(z**2)):.2f}")
    print("wavelength / nm, all samples:")
    for low, high in pairwise(BANDS):
        z = np.concatenate([s.z[:, (s.wavelengths >= low) & (s.wavelengths < high)].ravel() for s in found])
        print(f"  {low:4} to {high:3}: {100 * covered(z):.1f} %, rms z {np.sqrt(np.nanmean(z**2)):.2f}")
    return result


if __name__ == "__main__":
    wanted = range(1, 1 + int(sys.argv[1] if len(sys.argv) > 1 else 50))
    for watched, how in ((True, ""), (False, ", without looks at the lamp and at stray light")):
        print(f"{len(wanted)} benches{how}")
        for sample, share in report(run(wanted, watched)).items():
            tell(f"{sample}, {len(wanted)} benches{how}", 100 * share, "% of cells", "93 to 97" if watched else "")
