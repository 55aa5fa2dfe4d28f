"""What each correction is good for: the bias of a BRDF with all corrections, and with each one left out, on the bench.

    python -m tests.benchmarks.corrections

The simulated bench has stray light of 1e-3 1/sr, a wavelength scale that is off by 2 nm and known to be, and a sample
of 15 mm besides two of 50 mm; another one, for the drift alone, has a lamp that drifts by 3 % up and down in an hour
and is looked at every five minutes.

The bias of a point is that of its mean between 450 and 850 nm, and the largest is shown, over points of at least a
hundredth of the brightest one; for stray light, a ten-thousandth. For the wavelength it is the bias of the worst
wavelength, as a mean over all points; so it is for the non-linearity and the aperture, over the points around the
mirror direction at 60 degrees, which fill the detector more than the panel does. What is left are the errors of the
stages, 0.005 degrees each, and noise.
"""

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from drivers.arrays import FloatArray
from goniometer.campaigns.campaign import AngleSteps, Campaign, Integration, Monitor, Reference, Resolution, Sample
from goniometer.datasets.dataset import Dataset
from goniometer.radiometry.calibration import calibrate
from goniometer.radiometry.raw import RawScan, read_raw
from goniometer.radiometry.response import CORRECTIONS, DEFAULT_CORRECTIONS, Settings
from goniometer.storage.store import Store
from simulators.bench.imperfections import Imperfections
from simulators.materials.materials import PANEL_CERTIFICATE, material, true_brdf
from tests.benchmarks.figures import tell
from tests.benchmarks.measured import measure

WRONG = Imperfections(stray_light=1e-3, wavelength_offset=2.0)
DRIFTING = Imperfections(lamp_drift=0.03)
SEED = 4
SAMPLE_OF = {
    "dark": "sample-5",
    "non-linearity": "sample-5",
    "stray light": "sample-5",
    "drift": "sample-5",
    "wavelength": "sample-1",
    "footprint": "coupon",
    "aperture": "sample-5",
}
"""On which sample a correction is looked at."""


def campaign(names: tuple[str, ...], monitor: Monitor | None, scans: int) -> Campaign:
    """Samples at two incident angles, finely around the mirror direction, with little noise."""
    diameters = {"coupon": 15.0}
    return Campaign(
        name="Corrections",
        seed=SEED,
        samples=tuple(Sample(name=n, material=n, diameter=diameters.get(n, 50.0)) for n in names),
        incident=AngleSteps(start=20, stop=60, step=40),
        resolution=Resolution(),
        integration=Integration(scans=scans),
        reference=Reference(scans=scans),
        monitor=monitor,
    )


def measured(wanted: Campaign, wrong: Imperfections) -> dict[str, list[RawScan]]:
    """By sample: the scans of the campaign up to its own."""

    with tempfile.TemporaryDirectory() as folder:
        store = Store.open(Path(folder) / "bench.db")
        scans = measure(store, wanted, wrong)
        raws = [read_raw(store, scan.id) for scan in scans]
        store.close()
    known = [
        replace(
            raw,
            constants=replace(
                raw.constants, bench=replace(raw.constants.bench, wavelength_offset=wrong.wavelength_offset)
            ),
        )
        for raw in raws
    ]
    return {scan.sample: known[: scan.number + 1] for scan in scans[1:]}


def calibrated(scans: list[RawScan], corrections: frozenset[str]) -> Dataset:
    """The last of the scans, with the first as reference."""
    reference, *between, sample = scans
    return calibrate(sample, reference, PANEL_CERTIFICATE, Settings(corrections=corrections), between)


def bias(dataset: Dataset, correction: str) -> float:
    """Largest relative bias; see the module's text."""
    aperture = 0.0 if correction == "aperture" else 1.0
    truth = true_brdf(
        material(SAMPLE_OF[correction]), dataset.theta_in, dataset.theta_out, dataset.wavelengths, aperture
    )
    lit = (dataset.wavelengths > 450) & (dataset.wavelengths < 850)
    level: FloatArray = truth[:, lit].mean(axis=1)
    least = 1e-4 if correction == "stray light" else 0.01
    bright = (level > least * level.max()) & np.isfinite(dataset.brdf).all(axis=1)
    if correction in {"non-linearity", "aperture"}:
        bright &= (dataset.theta_in > 59) & (np.abs(dataset.theta_out - dataset.theta_in) < 2.5)
    relative = (dataset.brdf / truth - 1)[np.ix_(bright, lit)]
    if correction in {"non-linearity", "wavelength", "aperture"}:
        return float(np.abs(relative.mean(axis=0)).max())
    return float(np.abs(relative.mean(axis=1)).max())


def table() -> dict[str, tuple[float, float]]:
    """Correction -> bias with it, and without it, both with all others of the standard set."""
    steady = measured(campaign(("sample-1", "sample-5", "coupon"), None, scans=8), WRONG)
    drifting = measured(campaign(("sample-5",), Monitor(every=300.0), scans=1), DRIFTING)
    found = {}
    for correction in CORRECTIONS:
        mine = (drifting if correction == "drift" else steady)[SAMPLE_OF[correction]]
        with_it = calibrated(mine, DEFAULT_CORRECTIONS | {correction})
        without = calibrated(mine, DEFAULT_CORRECTIONS - {correction})
        found[correction] = bias(with_it, correction), bias(without, correction)
    return found


def main() -> None:
    """Tell the bias without each over that with it."""
    for correction, (with_it, without) in table().items():
        what = f"{correction} on {SAMPLE_OF[correction]}: bias without over bias with the correction"
        tell(what, without / with_it, f"({100 * without:.2f} % over {100 * with_it:.2f} %)", "> 1")


if __name__ == "__main__":
    main()
