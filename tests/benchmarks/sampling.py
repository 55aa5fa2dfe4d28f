"""Accuracy against points and time of dynamic resolution, beside uniform grids and midpoint refinement.

    python -m tests.benchmarks.sampling [CHART.svg]

Prints a table and draws a chart. All materials are
known exactly (`sampling_materials`), are read through the aperture, and carry 0.1 % of noise. Errors are those of
reading the BRDF between the points, on a grid of 0.1 degrees at nine incident angles.
"""

import multiprocessing
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.interpolate import PchipInterpolator

from analysis.colour import delta_e_2000, xyz_weights
from drivers.arrays import FloatArray
from goniometer.bench.route import ordered
from goniometer.geometry import Geometry
from goniometer.plans.plan import Measured, interpolation, next_points, reached
from goniometer.plans.plan_spec import PlanSpec, segments
from simulators.costs.scans import (
    Read,
    bench_minutes,
    process_of,
    readings,
    through,
    through_pchip,
    uniform_directions,
)
from tests.benchmarks.figures import tell
from tests.benchmarks.sampling_materials import BANDS, MATERIALS, Truth

THETA_IN = tuple(float(t) for t in range(0, 81, 10))
SPEC = PlanSpec(THETA_IN)
TOLERANCES = (0.02, 0.01, 0.005, 0.002, 0.001)
GRIDS = (10.0, 5.0, 2.0, 1.0, 0.5)
COLOUR = np.arange(400.0, 701.0, 25.0)
"""Wavelengths by which colours are judged, nm."""
AIMS = {"GGX 0.005": 0.05, "GGX 0.02": 0.2, "GGX 0.05": 0.35, "GGX 0.126": 0.6, "two lobes": 0.45}
"""Points over those of the uniform grid of equal rms error, at most; 1 for all others."""


@dataclass(frozen=True)
class Result:
    """One sampling of one material."""

    method: str
    points: float
    """An incident angle."""
    minutes: float
    """At the bench, by the time model."""
    rms: float
    """Error of ln(1 + cos f)."""
    largest: float
    rms_dark: float
    """Error of ln(0.0001 + cos f)."""
    colour: float
    """Mean dE00."""
    predicted: float = float("nan")
    """What the plan thought that `rms` was."""
    predicted_largest: float = float("nan")
    predicted_colour: float = float("nan")
    stopped: str = ""


@dataclass(frozen=True)
class Judge:
    """The truth on the grid of 0.1 degrees."""

    theta_in: FloatArray
    theta_out: FloatArray
    value: FloatArray
    colour: FloatArray

    def errors(self, read: Read) -> tuple[float, float, float, float]:
        """Rms and largest error of ln(1 + cos f), rms of ln(0.0001 + cos f), mean dE00 (through three bands)."""
        value = np.vstack(
            [read(a, b) for a, b in zip(*(np.array_split(x, 12) for x in (self.theta_in, self.theta_out)), strict=True)]
        )
        error = np.log1p(value) - np.log1p(self.value)
        dark = np.log(1e-4 + value) - np.log(1e-4 + self.value)
        ratio = np.maximum(value, 0) / np.maximum(self.value, 1e-12)
        # the error of the bands carried to all wavelengths: colours are those of full spectra
        spectral = np.stack([np.interp(COLOUR, BANDS, r) for r in ratio[::5]])
        weights = xyz_weights(COLOUR)
        difference = delta_e_2000((self.colour[::5] * spectral) @ weights, self.colour[::5] @ weights)
        return (
            float(np.sqrt(np.mean(error**2))),
            float(np.abs(error).max()),
            float(np.sqrt(np.mean(dark**2))),
            float(difference.mean()),
        )


def judge(truth: Truth) -> Judge:
    """Truth on the fine grid of all incident angles."""
    places = [(t, x) for t in THETA_IN for a, b in segments(SPEC, t) for x in np.arange(a, b + 1e-9, 0.1)]
    theta_in, theta_out = np.array(places).T
    return Judge(theta_in, theta_out, truth(theta_in, theta_out), truth(theta_in, theta_out, COLOUR))


def measure(truth: Truth, path: Sequence[Geometry], random: np.random.Generator) -> list[Measured]:
    """What the bench would read."""
    return readings(truth(np.array([g.theta_in for g in path]), np.array([g.theta_out for g in path])), path, random)


def midpoints(truth: Truth, tolerance: float, random: np.random.Generator) -> list[Measured]:
    """Refinement of a monotone cubic: an interval is halved where it departs from its chord by more than allowed."""
    near = [Geometry(t, t + d) for t in THETA_IN for d in (-3.0, -1.0, 0.0, 1.0, 3.0)]
    first = {g for g in [*uniform_directions(SPEC, 10.0), *near] if not g.blocked and abs(g.theta_out) <= 85}
    points = measure(truth, ordered(sorted(first)), random)
    while True:
        new: list[Geometry] = []
        for t in THETA_IN:
            for low, high in segments(SPEC, t):
                mine = sorted(
                    (p for p in points if p.geometry.theta_in == t and low <= p.geometry.theta_out <= high),
                    key=lambda p: p.geometry.theta_out,
                )
                if len(mine) < 2:
                    continue
                x = np.array([p.geometry.theta_out for p in mine])
                y = np.log1p(np.maximum([p.values for p in mine], 0))
                middle = 0.5 * (x[1:] + x[:-1])
                excess = np.abs(PchipInterpolator(x, y)(middle) - 0.5 * (y[1:] + y[:-1])).max(axis=1)
                new += [
                    Geometry(t, float(m))
                    for m, e, (a, b) in zip(middle, excess, pairwise(x), strict=True)
                    if e > tolerance and b - a > 0.2
                ]
        if not new:
            return points
        points += measure(truth, ordered(new), random)


def dynamic(truth: Truth, spec: PlanSpec, random: np.random.Generator) -> list[Measured]:
    """All points of a dynamic sampling."""
    points: list[Measured] = []
    while batch := next_points(spec, points):
        points += measure(truth, batch, random)
    return points


def sample(name: str) -> list[Result]:
    """All methods on one material."""
    truth = MATERIALS[name]
    random, judged = np.random.default_rng(1), judge(truth)

    def result(method: str, points: list[Measured], read: Read, spec: PlanSpec | None = None) -> Result:
        rms, largest, dark, colour = judged.errors(read)
        told = reached(spec, points) if spec else None
        extra = (told.error, told.largest_error, told.colour_error, str(told.stopped)) if told else ()
        return Result(method, len(points) / len(THETA_IN), bench_minutes(points), rms, largest, dark, colour, *extra)

    results = []
    for step in GRIDS:
        points = measure(truth, uniform_directions(SPEC, step), random)
        results.append(result("uniform", points, through_pchip(SPEC, points)))
        if step >= 2:
            results.append(result("uniform, same interpolation", points, through(process_of(points))))
    for tolerance in (0.05, 0.02, 0.01, 0.005, 0.002):
        points = midpoints(truth, tolerance, random)
        results.append(result("midpoints", points, through_pchip(SPEC, points)))
    for tolerance in TOLERANCES:
        spec = PlanSpec(THETA_IN, tolerance=tolerance, colour_tolerance=None)
        points = dynamic(truth, spec, random)
        results.append(result("dynamic", points, through_process_of_plan(spec, points), spec))
    spec = PlanSpec(THETA_IN, tolerance=1.0, colour_tolerance=0.1)
    points = dynamic(truth, spec, random)
    results.append(result("dynamic, dE00 0.1", points, through_process_of_plan(spec, points), spec))
    return results


def show(name: str, results: list[Result]) -> None:
    """Print the table of one material."""
    print(f"\n{name}")
    print(
        f"{'method':28}{'points':>8}{'minutes':>9}{'rms':>9}{'max':>9}{'rms 1e-4':>10}{'dE00':>8}"
        "   predicted rms, max, dE00"
    )
    for r in results:
        told = (
            f"   {r.predicted:.5f} {r.predicted_largest:.4f} {r.predicted_colour:.3f} {r.stopped}" if r.stopped else ""
        )
        print(
            f"{r.method:28}{r.points:8.1f}{r.minutes:9.1f}{r.rms:9.5f}{r.largest:9.4f}{r.rms_dark:10.5f}{r.colour:8.3f}{told}"
        )
    for label, error in (
        ("ln(1 + v)", lambda r: r.rms),
        ("ln(0.0001 + v)", lambda r: r.rms_dark),
        ("max", lambda r: r.largest),
    ):
        ratios = [ratio(r, results, error) for r in results if r.method == "dynamic"]
        print(f"  points over uniform grid of equal {label}: " + ", ".join(f"{v:.3f}" for v in ratios), flush=True)


def through_process_of_plan(spec: PlanSpec, points: list[Measured]) -> Read:
    """What the plan itself believes at its end."""
    process = interpolation(spec, points)
    assert process is not None
    return through(process)


def ratio(one: Result, results: Sequence[Result], error: Callable[[Result], float]) -> float:
    """Points of `one` over those of a uniform grid with its error, interpolated between grids on logarithmic axes.

    Beyond the finest grid its own points count, so the true ratio is smaller.
    """
    grids = sorted((r for r in results if r.method == "uniform"), key=lambda r: r.points)
    best = np.minimum.accumulate([error(r) for r in grids])
    needed = np.interp(-np.log(error(one)), -np.log(best), np.log([r.points for r in grids]))
    return float(one.points / np.exp(needed))


def chart(everything: dict[str, list[Result]]) -> str:
    """Error against points and against time, and predicted against actual error, as SVG."""
    from matplotlib.figure import Figure  # noqa: PLC0415
    from matplotlib.ticker import NullFormatter  # noqa: PLC0415

    from analysis.figures.svg import INK, style, to_svg  # noqa: PLC0415

    looks = {
        "uniform": ("#c95a5a", "s"),
        "uniform, same interpolation": ("#94790f", "D"),
        "midpoints": ("#a862bd", "^"),
        "dynamic": ("#3a7bd5", "o"),
    }
    rows = len(everything)
    with style():
        figure = Figure(figsize=(9.5, 1.9 * rows + 0.5), facecolor="none", layout="constrained")
        axes = figure.subplots(rows, 3, squeeze=False)
        for row, (name, results) in zip(axes, everything.items(), strict=True):
            for method, (colour, marker) in looks.items():
                mine = [r for r in results if r.method == method]
                for ax, x in ((row[0], [r.points for r in mine]), (row[1], [r.minutes for r in mine])):
                    ax.loglog(
                        x,
                        [r.rms for r in mine],
                        marker,
                        color=colour,
                        markersize=4,
                        label=method,
                        linestyle="-",
                        linewidth=0.8,
                    )
                    ax.loglog(
                        x,
                        [r.largest for r in mine],
                        marker,
                        color=colour,
                        markersize=3,
                        markerfacecolor="none",
                        linestyle=":",
                        linewidth=0.8,
                    )
            mine = [r for r in results if r.method == "dynamic"]
            row[2].loglog(
                [r.rms for r in mine], [r.predicted for r in mine], "o", color="#3a7bd5", markersize=4, label="rms"
            )
            row[2].loglog(
                [r.largest for r in mine],
                [r.predicted_largest for r in mine],
                "o",
                color="#3a7bd5",
                markersize=4,
                markerfacecolor="none",
                label="largest",
            )
            ends = [min(r.rms for r in mine) / 2, max(r.largest for r in mine) * 2]
            row[2].loglog(ends, ends, color=INK, linewidth=0.7, alpha=0.5)
            row[0].set(ylabel=f"{name}\nerror of ln(1 + v)")
            row[2].set(ylabel="predicted")
            for ax in row:
                ax.set_facecolor("none")
                ax.xaxis.set_minor_formatter(NullFormatter())
                ax.yaxis.set_minor_formatter(NullFormatter())
                ax.grid(visible=True)
                ax.spines[["top", "right"]].set_visible(False)
        figure.legend(*axes[0][0].get_legend_handles_labels(), loc="outside upper left", ncols=4, frameon=False)
        axes[0][2].legend(frameon=False, fontsize=7)
        for ax, label in zip(
            axes[-1], ("points an incident angle", "minutes at the bench", "actual error"), strict=True
        ):
            ax.set(xlabel=label)
        return to_svg(
            figure, "sampling", "Error of dynamic resolution and of uniform grids; filled marks rms, open ones largest"
        )


def main(arguments: Sequence[str]) -> None:
    """Print the tables, and write the chart where a path is given."""
    everything = {}
    with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn")) as executor:
        for name, results in zip(MATERIALS, executor.map(sample, MATERIALS), strict=True):
            show(name, results)
            everything[name] = results
    print()
    trust = []
    for name, results in everything.items():
        worst = max(ratio(r, results, lambda r: r.rms) for r in results if r.method == "dynamic")
        dark = max(ratio(r, results, lambda r: r.rms_dark) for r in results if r.method == "dynamic")
        what = f"{name}: points over a uniform grid of equal rms error"
        tell(what, worst, f"({dark:.3f} in ln(0.0001 + v))", f"<= {AIMS.get(name, 1.0):g}")
        asked = results[-1]
        tell(f"{name}: points an incident angle for dE00 0.1", asked.points, f"(dE00 {asked.colour:.3f})", "<= 20")
        trust += [r.predicted / r.rms for r in results if r.method == "dynamic"]
    tell("predicted over actual rms error, lowest", min(trust))
    tell("predicted over actual rms error, highest", max(trust))
    if arguments:
        Path(arguments[0]).write_text(chart(everything), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
