"""What scans cost and how well they are read between their points, on a material that the bench knows.

A scan is what the plan asks for, read with noise but without the wire: its time is what the time model of the bench
gives for this order of moves, exposures and dead times. Errors are those of reading the BRDF between the points.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from analysis.colour import delta_e_2000, xyz_weights
from analysis.tradeoff import Axis, Chart, Choice, Use
from drivers.arrays import FloatArray
from goniometer.bench.route import Motion, ordered, travel
from goniometer.geometry import Geometry
from goniometer.interpolation.interpolant import Interpolant, condition, learn, predict_values
from goniometer.plans.plan import Measured, interpolation, next_points
from goniometer.plans.plan_spec import PlanSpec, segments
from goniometer.scans.duration import DEAD_TIME

NOISE = 1e-3
"""Relative standard deviation of a reading."""
DARK = 1e-5
"""Its standard deviation in the dark, 1/sr."""
FULL = 0.1
"""Seconds of integration for cos(theta_in) f = 1."""

BANDS = np.array([450.0, 550.0, 650.0, 800.0])
"""Centres of the bands that the plan looks at, nm."""

GRIDS = (10.0, 5.0, 2.0, 1.0)
"""Steps of the uniform grids of a chart, degrees."""
TOLERANCES = (0.05, 0.02, 0.01, 0.005, 0.002, 0.001, 0.0005, 0.0002)
"""Of the dynamic scans of a chart; one that stops where a looser one did is left out."""

_COLOUR = np.arange(400.0, 701.0, 25.0)
_JUDGED_STEP = 0.5

Read = Callable[[FloatArray, FloatArray], FloatArray]
"""cos(theta_in) f [points, bands] at theta_in, theta_out [points]."""

Truth = Callable[[FloatArray, FloatArray, FloatArray], FloatArray]
"""cos(theta_in) f [points, wavelengths] at theta_in, theta_out [points] and wavelengths, nm."""


@dataclass(frozen=True)
class Scanned:
    """One way to scan, done."""

    name: str
    setting: str
    family: str
    points: Sequence[Measured]
    read: Read
    use: Use
    """The resolution of a campaign that scans so."""


def readings(values: FloatArray, path: Sequence[Geometry], random: np.random.Generator) -> list[Measured]:
    """What the bench would read where cos(theta_in) f is `values` [points, bands]."""
    noise = np.hypot(NOISE * values, DARK)
    read = values + noise * random.normal(size=values.shape)
    return [Measured(g, v, u) for g, v, u in zip(path, read, noise, strict=True)]


def bench_minutes(points: Sequence[Measured]) -> float:
    """Time to measure points in this order: moves, integration until the detector is full, dead time."""
    integration = sum(float(np.clip(FULL / max(p.values.max(), 1e-9), 0.008, 30.0)) for p in points)
    return (travel([p.geometry for p in points], Motion()).seconds + integration + DEAD_TIME * len(points)) / 60


def uniform_directions(spec: PlanSpec, step: float) -> list[Geometry]:
    """A uniform grid with the edges of the blocked sector, in the order in which a bench would take it."""
    places = [
        Geometry(t, float(x))
        for t in spec.theta_in
        for a, b in segments(spec, t)
        for x in {a, b, *np.arange(np.ceil(a / step) * step, b, step)}
    ]
    return ordered(places)


def through_pchip(spec: PlanSpec, points: Sequence[Measured]) -> Read:
    """Monotone cubic through ln(1 + cos f) of each incident angle and each side of the blocked sector."""

    def read(theta_in: FloatArray, theta_out: FloatArray) -> FloatArray:
        out = np.zeros((theta_in.size, points[0].values.size))
        for t in np.unique(theta_in):
            for low, high in segments(spec, float(t)):
                here = (theta_in == t) & (theta_out >= low - 1e-9) & (theta_out <= high + 1e-9)
                mine = sorted(
                    (p for p in points if p.geometry.theta_in == t and low <= p.geometry.theta_out <= high),
                    key=lambda p: p.geometry.theta_out,
                )
                if not here.any():
                    continue
                x = np.array([p.geometry.theta_out for p in mine])
                y = np.log1p(np.maximum([p.values for p in mine], 0))
                out[here] = np.expm1(
                    scipy.interpolate.PchipInterpolator(x, y)(theta_out[here]) if len(x) > 1 else y[:1]
                )
        return out

    return read


def process_of(points: Sequence[Measured]) -> Interpolant:
    """The plan's interpolation of any points."""
    theta_in = np.array([p.geometry.theta_in for p in points])
    theta_out = np.array([p.geometry.theta_out for p in points])
    values, noise = np.array([p.values for p in points]), np.array([p.noise for p in points])
    stride = max(len(points) // 300, 1)
    shape = learn(theta_in[::stride], theta_out[::stride], values[::stride], noise[::stride])
    return condition(shape, theta_in, theta_out, values, noise)


def through(process: Interpolant) -> Read:
    """An interpolation as a function."""
    return lambda theta_in, theta_out: predict_values(process, theta_in, theta_out)[0]


def scan_charts(sample: str, truth: Truth, spec: PlanSpec, seeds: int, tell: Callable[[str], None]) -> list[Chart]:
    """Uniform and dynamic scans of a material: time at the bench against the error of reading between the points.

    `spec` says which directions there are.
    Each is done `seeds` times with other noise.
    """
    theta_in = spec.theta_in
    places = np.array([(t, x) for t in theta_in for a, b in segments(spec, t) for x in np.arange(a, b, _JUDGED_STEP)])
    at_in, at_out = places.T
    right, colour = truth(at_in, at_out, BANDS), truth(at_in, at_out, _COLOUR)
    weights = xyz_weights(_COLOUR)

    def judged(scan: Scanned) -> tuple[float, float, float]:
        """Minutes, rms error of ln(1 + cos f), mean dE00."""
        value = scan.read(at_in, at_out)
        rms = float(np.sqrt(np.mean((np.log1p(np.maximum(value, 0)) - np.log1p(right)) ** 2)))
        ratio = np.maximum(value, 0) / np.maximum(right, 1e-12)
        # the error of the bands carried to all wavelengths: colours are those of full spectra
        spectral = np.stack([np.interp(_COLOUR, BANDS, r) for r in ratio])
        difference = delta_e_2000((colour * spectral) @ weights, colour @ weights)
        return bench_minutes(scan.points), rms, float(difference.mean())

    draws = []
    for seed in range(seeds):
        random = np.random.default_rng(seed)
        tell(f"noise {seed + 1} of {seeds}")
        scans = _scans(spec, truth, random, tell)
        draws.append([(scan, judged(scan)) for scan in scans])
    what = (
        f"{sample} at {len(theta_in)} incident angles, {100 * NOISE:g} % noise. Time by the time model of the bench: "
        f"moves, exposures, {DEAD_TIME:g} s beside each. Error of reading"
    )
    return [
        Chart(
            "scan-error",
            "Scanning: time at the bench against error between the points",
            f"{what} ln(1 + cos(θ in) f) every {_JUDGED_STEP:g}° of θ out, root mean square.",
            Axis("time at the bench", "min"),
            Axis("rms error of ln(1 + cos f)", ""),
            _choices(draws, 1),
        ),
        Chart(
            "scan-colour",
            "The same scans: time at the bench against error of the colours",
            f"{what} a colour there, mean dE00.",
            Axis("time at the bench", "min"),
            Axis("mean dE00", ""),
            _choices(draws, 2),
        ),
    ]


def _choices(draws: Sequence[Sequence[tuple[Scanned, tuple[float, float, float]]]], which: int) -> tuple[Choice, ...]:
    """One for each scan, over all noises."""
    found = []
    names = dict.fromkeys((scan.family, scan.name) for draw in draws for scan, _ in draw)
    for name in names:
        same = [(scan, told) for draw in draws for scan, told in draw if (scan.family, scan.name) == name]
        scan = same[0][0]
        low, middle, high = np.quantile([told[0] for _, told in same], [0.25, 0.5, 0.75])
        error = float(np.sqrt(np.mean([told[which] ** 2 for _, told in same])))
        points = float(np.mean([len(each.points) for each, _ in same]))
        found.append(
            Choice(
                scan.name, scan.setting, scan.family, middle, low, high, error, {"points": round(points, 1)}, scan.use
            )
        )
    return tuple(found)


def _scans(spec: PlanSpec, truth: Truth, random: np.random.Generator, tell: Callable[[str], None]) -> list[Scanned]:
    def measure(path: Sequence[Geometry]) -> list[Measured]:
        angles = np.array([(g.theta_in, g.theta_out) for g in path])
        return readings(truth(angles[:, 0], angles[:, 1], BANDS), path, random)

    scans = []
    for step in GRIDS:
        tell(f"uniform grid of {step:g}°")
        points = measure(uniform_directions(spec, step))
        setting = f"uniform grid of {step:g}° in θ out, read by"
        use = Use("campaign", {"mode": "uniform", "step": step})
        scans.append(
            Scanned(f"{step:g}°", f"{setting} a monotone cubic", "uniform", points, through_pchip(spec, points), use)
        )
        if step >= 2:  # finer ones gain nothing and take minutes
            read = through(process_of(points))
            family = "uniform, our interpolation"
            scans.append(Scanned(f"{step:g}°", f"{setting} our process", family, points, read, use))
    for tolerance in TOLERANCES:
        tell(f"dynamic to {tolerance:g}")
        wanted = replace(spec, tolerance=tolerance, colour_tolerance=None)
        found: list[Measured] = []
        while batch := next_points(wanted, found):
            found += measure(batch)
        if scans[-1].family == "dynamic" and len(scans[-1].points) == len(found):
            continue
        process = interpolation(wanted, found)
        assert process is not None  # a finished plan has points enough
        scans.append(
            Scanned(
                f"{tolerance:g}",
                f"dynamic resolution to a tolerance of {tolerance:g}",
                "dynamic",
                found,
                through(process),
                Use("campaign", {"mode": "dynamic", "tolerance": tolerance}),
            )
        )
    return scans
