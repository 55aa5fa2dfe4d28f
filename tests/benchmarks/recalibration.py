"""How long a full recalibration takes: 300 points of 1044 pixels, with every correction, from raw counts to a budget.

    python -m tests.benchmarks.recalibration

Binned as usual, and with every pixel on its own; the time of a plain division by the reference, without any
correction or uncertainty, stands beside it as the least that could be done.
"""

import time
from collections.abc import Callable

import numpy as np

from goniometer.certificates.certificate import NOMINAL_SRS99
from goniometer.geometry import Geometry
from goniometer.radiometry.calibration import calibrate
from goniometer.radiometry.raw import RawScan
from goniometer.radiometry.response import Settings
from goniometer.storage.records import pack_dataset
from tests.benchmarks.figures import tell
from tests.goniometer.forward import Bench, Wrong, lobe, spectralon

REPEATS = 7


def scans() -> tuple[RawScan, RawScan]:
    """A reference scan of 162 points and a sample scan of 300, two exposures each, with stray light and monitors."""
    incident = [float(t) for t in range(0, 81, 10)]
    bench = Bench(Wrong(drift=0.01, stray=3e-4), noisy=False)
    grid = [Geometry(t, float(o)) for t in incident for o in np.linspace(-85, 85, 18)]
    reference = bench.scan(grid, spectralon(), 20.0, scan_id=1, stray_time=30.0, monitor_every=40)
    angles = [Geometry(t, float(o)) for t in incident for o in np.linspace(-85, 85, 34)][:300]
    sample = bench.scan(angles, lobe(), [(1.0, 20.0)] * 300, scan_id=2, stray_time=30.0, monitor_every=40)
    return sample, reference


def plain(sample: RawScan, reference: RawScan) -> np.ndarray:
    """Counts over counts of the nearest reference point."""
    panel = {shot.point: shot.counts.mean(axis=0) - 1500.0 for shot in reference.shots}
    found = []
    for shot in sample.shots:
        here = sample.planned[shot.point or 0]
        away = [abs(g.theta_in - here.theta_in) * 1e3 + abs(g.theta_out - here.theta_out) for g in reference.planned]
        found.append((shot.counts.mean(axis=0) - 1500.0) / np.maximum(panel[int(np.argmin(away))], 1.0))
    return np.array(found)


def median(work: Callable[[], object]) -> tuple[float, float, float]:
    """Median, least and largest of the seconds that `work` takes."""
    work()
    seconds = []
    for _ in range(REPEATS):
        began = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - began)
    return float(np.median(seconds)), min(seconds), max(seconds)


def main() -> None:
    """Print the table."""
    sample, reference = scans()
    binned, every = Settings(), Settings(bin_size=1)
    datasets = {settings: calibrate(sample, reference, NOMINAL_SRS99, settings) for settings in (binned, every)}
    rows = {
        "plain division": lambda: plain(sample, reference),
        "calibrate, 6 pixels a bin": lambda: calibrate(sample, reference, NOMINAL_SRS99, binned),
        "calibrate, every pixel": lambda: calibrate(sample, reference, NOMINAL_SRS99, every),
        "pack for the database, 6 pixels a bin": lambda: pack_dataset(datasets[binned]),
        "pack for the database, every pixel": lambda: pack_dataset(datasets[every]),
    }
    for name, work in rows.items():
        middle, least, largest = median(work)
        aim = "< 1" if name.startswith("calibrate") else ""
        tell(name, middle, f"s ({least:.3f} to {largest:.3f})", aim)
    for settings, dataset in datasets.items():
        size = len(pack_dataset(dataset)) / 1e6
        print(f"{settings.bin_size} pixels a bin: {dataset.brdf.shape}, {len(dataset.sources)} sources, {size:.1f} MB")


if __name__ == "__main__":
    main()
