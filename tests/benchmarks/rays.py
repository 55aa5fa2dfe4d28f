"""How fast rays are traced over a height map, against Embree on the same triangles.

    python -m tests.benchmarks.rays

Surfaces are the synthetic Samples 1 and 4, 1024 x 1024 heights, and a Gaussian one as rough as Sample 1; patches are
not periodic, so that both tracers see the same triangles. Rates are rays (not reflections) per second of processor
time, the shortest of a few runs that take turns within this process: the ratios are to be read. "Embree" is the time
within `embreex` alone; "whole" includes the reflections, which NumPy computes, as our time includes ours. The last
columns are the largest difference of the escape fractions by number of reflections, and what our own tracer spends on a
whole virtual scan (20 wavelengths, 171 detector positions), as rays per second.

The second table tells at which pitch, number of rays and area what is published of the synthetic Sample 1 stands still:
one surface of 512 um, made at the finest pitch, of which every second point is left out again and again; then the
finest with a quarter of the rays, and a quarter of its area. "More than once" is a share of the light that leaves at
380 nm, the BRDF is that 15 degrees off the mirror direction towards the normal, within 5 degrees. Below each row stand
standard errors, of the surface and of the rays.
"""

import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from analysis.reflectance.fresnel import fresnel_conductor, load_conductor
from drivers.arrays import FloatArray
from simulators.materials.materials import SAMPLES
from simulators.rays.decomposition import coarser, jackknife
from simulators.rays.rays import beam, terrain, trace, virtual_scan
from simulators.rays.scan import Goniometer, RayScan, ray_scan
from simulators.topographies.heights import HeightField
from simulators.topographies.synthesis import gaussian, gaussian_correlation, sandblasted_sample
from tests.benchmarks.figures import tell
from tests.embree_tracer import embree

SIZE, PITCH_UM = 1024, 0.625
RAYS, LIMIT, TURNS = 500_000, 24, 3
NM = np.linspace(380.0, 780.0, 20)
OUT = np.linspace(-85.0, 85.0, 171)
INCIDENT = np.array([0.0, 40.0, 60.0, 80.0])
FINEST_UM, SCAN_RAYS = 0.25, 2_000_000


def aluminium(cosine: FloatArray) -> FloatArray:
    """[..., wavelengths]"""
    return fresnel_conductor(cosine, *load_conductor().index(NM))


def surfaces() -> dict[str, HeightField]:
    """What is traced."""
    made = {name: sandblasted_sample(SAMPLES[name], SIZE, PITCH_UM, seed=1).field for name in ("sample-1", "sample-4")}
    made["gaussian"] = gaussian(2.39, gaussian_correlation(8.0), SIZE, PITCH_UM, seed=1)
    return {name: HeightField(field.heights_um, PITCH_UM, False) for name, field in made.items()}


def finer_and_coarser() -> Iterator[tuple[str, HeightField, int]]:
    """What it is, a surface, and rays for each incident angle."""
    finest = sandblasted_sample(SAMPLES["sample-1"], 2048, FINEST_UM, seed=1).field
    field = finest
    for _ in range(4):
        yield f"{field.pitch_um:g} um", field, SCAN_RAYS
        field = coarser(field)
    yield "1/4 of the rays", finest, SCAN_RAYS // 4
    yield "1/4 of the area", HeightField(finest.heights_um[:1024, :1024], FINEST_UM, False), SCAN_RAYS


def published(scan: RayScan) -> tuple[FloatArray, FloatArray]:
    """[figures, incident] share of light reflected more than once, and the BRDF aside; and their standard errors."""
    aside = np.abs(OUT - (INCIDENT[:, None] - 15)) <= 2.5
    light = scan.light[..., 0].mean(axis=1).sum(axis=-1)
    brdf = np.einsum("io,piok->pi", aside / aside.sum(axis=1, keepdims=True), scan.by_order.mean(axis=1))

    def figures(parts: np.ndarray) -> FloatArray:
        mean = light[parts].mean(axis=0)
        return np.stack([1 - mean[:, 0] / mean.sum(axis=1), brdf[parts].mean(axis=0)])

    return jackknife(figures, len(light))


def convergence() -> None:
    """Print the second table."""
    print(f"\n{'Sample 1, 512 um':<18}" + "".join(f"{f'more, {angle:g} °':>13}" for angle in INCIDENT), end="")
    print("".join(f"{f'BRDF, {angle:g} °':>13}" for angle in INCIDENT))
    by_pitch = []
    for name, field, rays in finer_and_coarser():
        asked = Goniometer(INCIDENT, OUT, NM, aluminium, 0, rays, 1, 1.0, 0.0)
        with ThreadPoolExecutor(2) as executor:
            value, u = published(ray_scan([terrain(field)], asked, executor))
        for first, found in ((name, value), ("", u)):
            print(f"{first:<18}" + "".join(f"{each:>13.5f}" for each in found.ravel()))
        by_pitch.append(value.ravel())
    lit = by_pitch[0] > 0
    change = np.abs(by_pitch[1][lit] / by_pitch[0][lit] - 1)
    tell("figures that change by less than 1 % at half the pitch", (change < 0.01).sum(), f"of {change.size}")
    tell("median change of a figure at half the pitch", 100 * np.median(change), "%")


def main() -> None:
    """Print both tables."""
    speed()
    convergence()


def speed() -> None:
    """Print the first table."""
    print("Mrays per core-second")
    print(f"{'surface':<10} {'theta_in':>8} {'ours':>6} {'Embree':>7} {'ratio':>6} {'whole':>6} {'ratio':>6}", end=" ")
    print(f"{'difference':>10} {'scan':>6}")
    ratios, differences = [], []
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
            ratios.append(inside / ours)
            differences.append(difference)
    tell("rays a core-second over those of Embree, lowest", min(ratios), f"times, highest {max(ratios):.1f}", ">= 2")
    tell("largest difference of escape fractions by number of reflections", max(differences), aim="<= 1e-4")


if __name__ == "__main__":
    main()
