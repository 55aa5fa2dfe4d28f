"""The blocked sector as it is filled, against the truth that nobody sees on a bench.

    python -m tests.benchmarks.sector [SEEDS]

For every material a dynamic scan is simulated, its sectors are filled (`goniometer.datasets.fill`), and the actual
errors are compared with the stated uncertainties: of all materials of `sampling_materials`, and of bumps around the way
back into the lamp that become ever narrower than the sector, once as the plan ends it and once with more directions
beside it.
"""

import sys
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from drivers.arrays import FloatArray
from goniometer.datasets.dataset import Dataset
from goniometer.datasets.fill import fill, unmeasured
from goniometer.geometry import LARGEST_ANGLE, Geometry
from goniometer.uncertainty import ErrorSource, everywhere
from simulators.costs.scans import DARK, NOISE
from tests.benchmarks.figures import tell
from tests.benchmarks.sampling import SPEC, THETA_IN, dynamic
from tests.benchmarks.sampling_materials import MATERIALS

WAVELENGTHS = np.linspace(420.0, 780.0, 13)
REFERENCE = 0.002
"""Relative standard uncertainty that all points share."""
BUMPS = {"GGX 0.41": 0.1, "GGX 0.126": 0.02, "GGX 0.05": 0.01, "two lobes": 0.05}
"""Heights of bumps about as bright as what they stand on, 1/sr."""
WIDTHS = (16.0, 10.0, 8.0, 6.0, 5.0, 4.0, 3.0, 2.0)
"""theta_in + theta_out at which a bump has fallen to 1/e, degrees."""
BESIDE = (6.0, 7.5)
"""theta_in + theta_out of further directions beside the sector, degrees."""

Material = Callable[[FloatArray, FloatArray, FloatArray], FloatArray]
"""cos(theta_in) f [points, wavelengths] at theta_in, theta_out [points], degrees, and nm."""


def dataset_of(truth: Material, path: Sequence[Geometry], random: np.random.Generator) -> Dataset:
    """What calibration would make of the directions of a scan."""
    theta_in, theta_out = np.array([(g.theta_in, g.theta_out) for g in path]).T
    f = truth(theta_in, theta_out, WAVELENGTHS) / np.cos(np.radians(theta_in))[:, None]
    noise = np.hypot(NOISE * f, DARK)
    sources = (
        ErrorSource("random", "random", noise, None, False),
        ErrorSource("reference", "reference", REFERENCE * f, everywhere(theta_in.size), True),
    )
    brdf = f * (1 + REFERENCE * random.standard_normal()) + noise * random.standard_normal(f.shape)
    flags = np.zeros(theta_in.size, dtype=np.uint16)
    return Dataset("a sample", theta_in, theta_out, WAVELENGTHS, brdf, sources, flags, 0.0, 0.0, 1.0)


def sector(name: str, truth: Material, seeds: range, beside: Sequence[float] = ()) -> float:
    """Print a line of the table; returns the share of truths within twice the stated uncertainty."""
    errors, stated, covered, silent = [], [], [], []
    points = 0
    for seed in seeds:
        random = np.random.default_rng(seed)
        path = [p.geometry for p in dynamic(truth, SPEC, random)]
        more = [Geometry(t, side * s - t) for t in THETA_IN for s in beside for side in (-1, 1)]
        path += [g for g in more if abs(g.theta_out) <= LARGEST_ANGLE and g not in path]
        points += len(path)
        dataset = dataset_of(truth, path, random)
        found = fill(dataset, *unmeasured(dataset, 0.5))
        told = found.tells
        f = truth(found.theta_in, found.theta_out, WAVELENGTHS) / np.cos(np.radians(found.theta_in))[:, None]
        errors.append((found.brdf / f - 1)[told].ravel())
        stated.append((found.u / f)[told].ravel())
        covered.append(np.abs(found.brdf - f)[told].ravel() < 2 * found.u[told].ravel())
        silent.append(~told)
    rms, largest = (float(v) for v in (np.sqrt(np.mean(np.square(np.hstack(errors)))), np.abs(np.hstack(errors)).max()))
    u, within, mute = (float(np.mean(np.hstack(v))) for v in (np.square(np.hstack(stated)), covered, silent))
    print(
        f"{name:30}{points / len(seeds) / len(THETA_IN):7.1f}{100 * rms:9.2f}{100 * largest:9.1f}"
        f"{100 * np.sqrt(u):9.2f}{100 * within:9.1f}{100 * mute:9.1f}",
        flush=True,
    )
    return within


if __name__ == "__main__":
    wanted = range(1, 1 + int(sys.argv[1] if len(sys.argv) > 1 else 3))
    print(
        f"{'':30}{'points':>7}{'error':>9}{'largest':>9}{'stated':>9}{'within':>9}{'too':>9}\n"
        f"{'':30}{'an angle':>7}{'rms / %':>8}{'/ %':>9}{'u / %':>9}{'2 u / %':>9}{'unsure/%':>9}"
    )
    held = [sector(material, its_truth, wanted) for material, its_truth in MATERIALS.items()]
    wide, narrow = [], []
    for material, height in BUMPS.items():
        for width in WIDTHS:
            bump = replace(MATERIALS[material], retro=height, retro_width=width)
            (wide if width > 3 else narrow).append(sector(f"{material}, bump of {width:g}°", bump, wanted))
            if width in {10.0, 8.0, 6.0}:
                sector("    more beside the sector", bump, wanted, BESIDE)
    for what, shares in (
        ("all materials", held),
        ("bumps of more than 3° towards the lamp", wide),
        ("narrower ones, which nothing shows", narrow),
    ):
        tell(f"{what}: truth within 2 u, lowest share", 100 * min(shares), f"%, median {100 * np.median(shares):.0f} %")
