"""What waves and rays say of the paper's claims on synthetic Samples 1 to 5; docs/diffraction-claims.md reads it.

    python -m tests.benchmarks.claims [waves] [rays] [--figure FILE.svg]

Eleven minutes on one core, about 2 GB. `--figure` writes the slopes of the first table over theta_m.
"""

import argparse
from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from analysis.figures.svg import INK, line_colours, new_axes, style, to_svg
from analysis.fits.local_fit import local_fit
from analysis.reflectance.fresnel import load_conductor
from simulators.choices import Kernel
from simulators.computed import Computed, computed_dataset
from simulators.topographies.heights import HeightField
from simulators.waves.sampling import refined, sampling
from simulators.waves.waves import averaged_brdf, scattering_vectors
from tests.benchmarks import claims_rays
from tests.benchmarks.claims_waves import (
    BANDS,
    DARK,
    FIXED,
    IN,
    INCIDENT,
    NM,
    OUT,
    PITCH_UM,
    WINDOW,
    Slopes,
    by_elements,
    craters,
    line,
    looked_at,
    planes,
    rough,
    slopes,
    spectra,
)
from tests.benchmarks.figures import tell

NAMES = tuple(f"sample-{number}" for number in range(1, 6))
SEEDS = (2, 3)
Bands = Mapping[str, tuple[float, float]]
NARROW = {
    f"{low:+g} to {low + 5:+g}": (low, low + 5) for low in (25.0, 15.0, 5.0, -2.5, -10.0, -20.0, -30.0, -40.0, -50.0)
}
"""Of theta_m, degrees."""


def cells(found: Slopes, theta_in: float | None = None, bands: Bands = BANDS) -> str:
    """A row of slopes by band, "dark" where more than half of the directions are."""
    text = ""
    for tilts in bands.values():
        slope, error, lit = found.band(tilts, theta_in)
        text += f"{'-' if np.isnan(lit) else 'dark' if lit < 0.5 else f'{slope:+.2f} ± {error:.2f}':>15}"
    return text


def heading(title: str, first: str, bands: Bands = BANDS) -> None:
    """Of a table of slopes."""
    print(f"\n{title}\n{first:34}" + "".join(f"{band:>15}" for band in bands))


def waves(figure: Path | None) -> None:
    """Print the tables of slopes."""
    smooth, micro = by_sample()
    if figure is not None:
        figure.write_text(drawn(smooth, micro))
    by_incidence(smooth, micro)
    micro_roughness()
    coarse_maps()
    how_it_is_seen()
    convergence()


def by_sample() -> tuple[dict[str, Slopes], dict[str, Slopes]]:
    """Print slopes of all samples, and how well one half of the patches foretells the other."""
    heading("slope m, 1/um, over theta_m, degrees; all incident angles together", "sample")
    smooth, micro = {}, {}
    apart, errors = [], []
    for name in NAMES:
        patches = {seed: craters(name, seed) for seed in SEEDS}
        for kind, results in (("smooth", smooth), ("micro-roughness", micro)):
            looks = []
            for seed, patch in patches.items():
                seen = planes(patch if kind == "smooth" else rough(patch, seed))
                looks += [spectra(plane) for plane in seen]
            results[name] = slopes(np.stack(looks))
            print(f"{name + ', ' + kind:34}{cells(results[name])}", flush=True)
            halves = [slopes(np.stack(half)) for half in (looks[:2], looks[2:])]
            for tilts in BANDS.values():
                (m, _, lit), (n, _, _) = (half.band(tilts) for half in halves)
                if lit > 0.5:
                    apart.append(m - n)
                    errors.append(2 * results[name].band(tilts)[1])
    print(
        f"one half of the patches against the other: {len(apart)} slopes differ by {np.std(apart):.2f} 1/um, root mean "
        f"square, and {np.abs(apart).max():.2f} at most; the standard errors foretell "
        f"{np.sqrt(np.mean(np.square(errors))):.2f}"
    )
    for kind, results in (("smooth", smooth), ("micro-roughness", micro)):
        for band, tilts in BANDS.items():
            told = [found.band(tilts) for found in results.values()]
            means = [m for m, _, share in told if share > 0.5]
            if means:
                tell(f"{kind}, theta_m {band}: mean slope of Samples 1 to 5", float(np.mean(means)), _span(means))
    return smooth, micro


def _span(slopes: list[float]) -> str:
    return f"1/um ({min(slopes):+.2f} to {max(slopes):+.2f})"


def by_incidence(smooth: Mapping[str, Slopes], micro: Mapping[str, Slopes]) -> None:
    """Print slopes for each incident angle, in bands so narrow that all cover the same theta_m."""
    heading("with micro-roughness, each incident angle", "sample, theta_in", NARROW)
    for name in (NAMES[0], NAMES[-1]):
        for theta_in in INCIDENT:
            print(f"{f'{name}, {theta_in:g}':34}{cells(micro[name], theta_in, NARROW)}")
    print("rms departure of a spectrum from its straight line, median and 90 % of the directions that are not dark:")
    for kind, results in (("smooth", smooth), ("micro-roughness", micro)):
        bent = np.concatenate([found.bent[found.brdf > DARK] for found in results.values()])
        print(f"  {kind:16}{100 * np.median(bent):5.1f} %{100 * np.quantile(bent, 0.9):7.1f} %")


def micro_roughness() -> None:
    """Print slopes over the height and the correlation length of the micro-roughness."""
    heading("Sample 1, other micro-roughness (seed 2)", "rms, correlation")
    for rms_um, correlation_um in ((0.03, 0.2), (0.04, 0.2), (0.05, 0.2), (0.04, 0.15), (0.04, 0.3)):
        patch = craters("sample-1", 2, min(PITCH_UM, correlation_um / 2))
        found = looked_at([rough(patch, 2, rms_um, correlation_um)])
        print(f"{f'{1000 * rms_um:g} nm, {correlation_um:g} um':34}{cells(found)}", flush=True)


def coarse_maps() -> None:
    """Print slopes of a map of 1 um, read in three ways."""
    heading("a map of 1 um pitch, window of one size for all wavelengths", "sample, noise, read as")
    for name, noises_um in (("sample-1", (0.0, 0.02, 0.04)), ("sample-5", (0.0, 0.04))):
        exact = [craters(name, seed, 1.0) for seed in SEEDS]
        for noise_um in noises_um:
            maps = [noisy(field, seed, noise_um) for seed, field in zip(SEEDS, exact, strict=True)]
            readings: Mapping[str, Slopes] = {
                "points": looked_at(maps, FIXED),
                "elements": by_elements(maps),
                "splines": looked_at((refined(field, 8) for field in maps), FIXED),
            }
            for way, found in readings.items():
                lit = found.brdf > DARK
                bent = f"{100 * np.median(found.bent[lit]):8.0f} %"
                print(f"{f'{name}, {1000 * noise_um:g} nm, {way}':34}{cells(found)}{bent}", flush=True)
    print("last column: rms departure of a spectrum from its line, median; splines are refined to 0.125 um")


def noisy(field: HeightField, seed: int, rms_um: float) -> HeightField:
    """With an error of each height by itself, as a microscope adds, or as roughness below the pitch is read."""
    noise = np.random.default_rng(2000 + seed).normal(size=field.heights_um.shape)
    return replace(field, heights_um=field.heights_um + rms_um * noise)


def how_it_is_seen() -> None:
    """Print slopes of one surface for all windows, kernels, and by the local fit with Fresnel's reflectance."""
    heading("Sample 1 with micro-roughness (seed 2), seen in other ways", "")
    seen = planes(rough(craters("sample-1", 2), 2))
    fixed = [replace(plane, coherence=FIXED) for plane in seen]
    for way, surfaces in (("window grows with wavelength", seen), ("window of one size", fixed)):
        print(f"{way:34}{cells(slopes(np.stack([spectra(plane) for plane in surfaces])))}")
    usual, *others = (line(spectra(seen[0], kernel))[1] for kernel in Kernel)
    print(
        f"the three kernels: slopes differ by {max(np.abs(other - usual).max() for other in others):.0e} 1/um at most"
    )
    oblique = IN > 0
    there = IN[oblique], OUT[oblique], NM
    bare, metal = (
        np.mean([averaged_brdf(plane, *there, conductor=conductor).brdf for plane in seen], axis=0)
        for conductor in (None, load_conductor())
    )
    fit = local_fit(computed_dataset(Computed("sample-1", *there, metal, np.zeros_like(metal), 0.01 * metal, 0.0, {})))
    print(
        f"local fit of the same on aluminium, theta_in 20 to 60, medians: its slope departs from the line's by "
        f"{np.median(np.abs(fit.slope - line(bare)[1])):.2f} 1/um, its exponent is {np.median(fit.exponent):.1f}"
    )


def convergence() -> None:
    """Print what changes when the pitch is halved, and what pitch is needed."""
    heading("convergence", "")
    small = craters("sample-1", 2, patch_um=160.0)
    for kind, patch in (("smooth", small), ("micro-roughness", rough(small, 2))):
        needed = sampling(patch, *scattering_vectors(IN, OUT, NM), float(WINDOW.size(NM).min())).needed_um
        for times in (1, 2):
            fine = refined(patch, times)
            print(f"{f'160 um, {kind}, pitch {1000 * fine.pitch_um:.4g} nm':34}{cells(looked_at([fine]))}", flush=True)
        print(f"  the sampling criterion asks for {1000 * needed:.0f} nm")
    made_fine = looked_at([craters("sample-1", 2, PITCH_UM / 2, 160.0)])
    print(f"{'160 um, smooth, made at 50 nm':34}{cells(made_fine)}")


def drawn(smooth: Mapping[str, Slopes], micro: Mapping[str, Slopes]) -> str:
    """SVG of slopes over theta_m."""
    edges = np.arange(-70.0, 41.0, 5.0)
    panels: tuple[tuple[str, Mapping[str, Slopes]], ...] = (("smooth craters", smooth), ("with micro-roughness", micro))
    with style():
        figure, left = new_axes(620, 300, left=46, right=320, bottom=38, top=26)
        right = figure.add_axes((326 / 620, 38 / 300, 254 / 620, 236 / 300), facecolor="none", sharey=left)
        for axes, (title, results) in zip((left, right), panels, strict=True):
            axes.axhline(0, color=INK, linewidth=0.6, alpha=0.5)
            axes.axvline(0, color=INK, linewidth=0.6, alpha=0.5)
            colours = line_colours(len(results))
            for number, (name, found) in enumerate(results.items()):
                points = [found.band(pair) for pair in pairwise(edges)]
                slope, error, lit = np.array(points).T
                shown = lit >= 0.5
                middle = (edges[:-1] + edges[1:]) / 2 + 0.5 * (number - 2)
                axes.errorbar(
                    middle[shown], slope[shown], 2 * error[shown],
                    fmt="o-", color=colours[number], markersize=2.6, linewidth=1.1, elinewidth=0.9, label=name,
                )  # fmt: skip
            axes.set(title=title, xlim=(-72, 42), ylim=(-5, 5), xlabel="θ m towards the lamp (−), the horizon (+) / °")
            axes.grid(True)
        left.set_ylabel("slope m / (1/µm)")
        left.legend(frameon=False, loc="upper left")
        return to_svg(figure, "claims", "slopes of spectra over theta_m, without and with micro-roughness")


def main() -> None:
    """Print what was asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("parts", nargs="*", help="waves, rays; both if none is named")
    parser.add_argument("--figure", type=Path, help="write the slopes of all samples as SVG")
    arguments = parser.parse_args()
    parts = arguments.parts or ["waves", "rays"]
    if unknown := set(parts) - {"waves", "rays"}:
        parser.error(f"there is no part {', '.join(sorted(unknown))}; name waves, rays or both")
    if "waves" in parts:
        waves(arguments.figure)
    if "rays" in parts:
        claims_rays.tables(NAMES)


if __name__ == "__main__":
    main()
