"""How fast rays are traced over a height map, against Embree on the same triangles.

    python -m tests.benchmarks.rays

Surfaces are the synthetic Samples 1 and 4, 1024 x 1024 heights, and a Gaussian one as rough as Sample 1; patches are
not periodic, so that both tracers see the same triangles. Rates are rays (not reflections) per second of processor
time, the shortest of a few runs that take turns within this process: the ratios are to be read. "Embree" is the time
within `embreex` alone; "whole" includes the reflections, which NumPy computes, as our time includes ours. The last
columns are the largest difference of the escape fractions by number of reflections, and what our own tracer spends on a
whole virtual scan (20 wavelengths, 171 detector positions), as rays per second.
"""

import time

import numpy as np

from analysis.fresnel import fresnel_conductor, load_conductor
from drivers.arrays import FloatArray
from simulators.heights import HeightField
from simulators.materials import SAMPLES
from simulators.rays import beam, terrain, trace, virtual_scan
from simulators.synthesis import gaussian, gaussian_correlation, sandblasted_sample
from tests.embree_tracer import embree

SIZE, PITCH_UM = 1024, 0.625
RAYS, LIMIT, TURNS = 500_000, 24, 3
NM = np.linspace(380.0, 780.0, 20)
OUT = np.linspace(-85.0, 85.0, 171)


def aluminium(cosine: FloatArray) -> FloatArray:
    """[..., wavelengths]"""
    return fresnel_conductor(cosine, *load_conductor().index(NM))


def surfaces() -> dict[str, HeightField]:
    """What is traced."""
    made = {name: sandblasted_sample(SAMPLES[name], SIZE, PITCH_UM, seed=1).field for name in ("sample-1", "sample-4")}
    made["gaussian"] = gaussian(2.39, gaussian_correlation(8.0), SIZE, PITCH_UM, seed=1)
    return {name: HeightField(field.heights_um, PITCH_UM, False) for name, field in made.items()}


def main() -> None:
    """Print the table."""
    print("Mrays per core-second")
    print(f"{'surface':<10} {'theta_in':>8} {'ours':>6} {'Embree':>7} {'ratio':>6} {'whole':>6} {'ratio':>6}", end=" ")
    print(f"{'difference':>10} {'scan':>6}")
    for name, patch in surfaces().items():
        surface = terrain(patch)
        trace(surface, *beam(surface, 0.0, 10, seed=1))  # compiles
        for theta_in in (0.0, 30.0, 70.0):
            origins, directions = beam(surface, theta_in, RAYS, seed=2)
            ours = inside = whole = np.inf
            for _ in range(TURNS):
                begin = time.process_time()
                paths = trace(surface, origins, directions, LIMIT)
                ours = min(ours, time.process_time() - begin)
                other = embree(patch, origins, directions, LIMIT)
                inside, whole = min(inside, other.inside), min(whole, other.whole)
            begin = time.process_time()
            virtual_scan(patch, theta_in, OUT, aluminium, RAYS, seed=3, limit=LIMIT)
            scan = time.process_time() - begin
            counts = np.bincount(paths.reflections[paths.escaped], minlength=LIMIT + 1)
            difference = np.abs(counts - other.escaped).max() / RAYS
            rates = [RAYS / 1e6 / spent for spent in (ours, inside, whole, scan)]
            print(
                f"{name:<10} {theta_in:>6g} ° {rates[0]:>6.2f} {rates[1]:>7.2f} {inside / ours:>6.2f} {rates[2]:>6.2f} "
                f"{whole / ours:>6.2f} {difference:>10.1e} {rates[3]:>6.2f}"
            )


if __name__ == "__main__":
    main()
