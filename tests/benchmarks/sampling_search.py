"""Are lobes missed that lie between all points?

    python -m tests.benchmarks.sampling_search [COUNT]

A lobe of random place, width (0.3 to 30 degrees) and height (five decades) stands on a diffuse ground and is seen
through the aperture. It is sampled with and without a pre-scan. Without one a narrow lobe is found by chance; with one
none may be missed that stands above the noise of the pre-scan.
"""

import multiprocessing
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass

import numpy as np

from analysis.reflectance.directions import round_aperture
from drivers.arrays import FloatArray
from goniometer.interpolation.interpolant import predict_values
from goniometer.plans.plan import Measured, interpolation, next_points
from goniometer.plans.plan_spec import PlanSpec, segments
from goniometer.plans.sweep import Swept
from tests.benchmarks.figures import tell
from tests.goniometer.test_sweep import averaged, intervals

THETA_IN = 30.0
SPEC = PlanSpec((THETA_IN,), tolerance=0.005, colour_tolerance=None, most_points=120)
SWEEP_STEP = 2.0
"""Degrees of theta_out that a reading of the pre-scan covers."""
SWEEP_NOISE = 0.003, 1e-4
"""Relative, and in 1/sr, of a reading of the moving detector."""
POINT_NOISE = 0.001, 1e-5
TINT = np.array([1.0, 1.02, 1.05, 1.1])
_APERTURE = round_aperture(1.0)


@dataclass(frozen=True)
class Case:
    """One lobe on a diffuse ground."""

    width: float
    """Full width at half maximum, degrees."""
    height: float
    """cos(theta_in) f, 1/sr, before the aperture."""
    place: float
    """theta_out, degrees."""
    ground: float
    """cos(theta_in) f, 1/sr."""

    def __call__(self, theta_in: FloatArray, theta_out: FloatArray) -> FloatArray:
        """[points, bands] as the aperture sees it."""
        away = (theta_out[:, None] + _APERTURE.along - self.place) / self.width
        lobe = self.height * np.exp(-4 * np.log(2) * away**2) @ _APERTURE.weights
        return np.asarray((self.ground + lobe)[:, None] * TINT)


@dataclass(frozen=True)
class Found:
    """What became of a case."""

    missed: bool
    """Whether less than half of the lobe is in the interpolation."""
    error: float
    """Largest error of ln(1 + cos f)."""
    points: int


def random_case(random: np.random.Generator) -> Case:
    """Uniform in the logarithms of width, height and ground, and in place outside the blocked sector."""
    while True:
        place = float(random.uniform(-85, 85))
        if abs(place + THETA_IN) >= 5:
            break
    width, height, ground = (10 ** random.uniform(*np.log10(ends)) for ends in ((0.3, 30), (1e-3, 1e2), (0.01, 0.3)))
    return Case(float(width), float(height), place, float(ground))


def noise(value: FloatArray, model: tuple[float, float]) -> FloatArray:
    """Standard deviation of a reading."""
    return np.asarray(np.hypot(model[0] * value, model[1]))


def sweep(case: Case, random: np.random.Generator) -> tuple[list[Swept], float]:
    """The pre-scan, and by how many standard deviations of its noise, or of 2 % of the ground, the lobe stands out."""
    readings, clearest = [], 0.0
    for start, stop in intervals(segments(SPEC, THETA_IN), SWEEP_STEP):
        value = averaged(case, THETA_IN, (start, stop))
        u = noise(value, SWEEP_NOISE)
        excess = float(np.mean(value / TINT)) - case.ground
        clearest = max(clearest, excess / float(np.hypot(u.mean(), 0.02 / 4 * value.mean())))
        readings.append(Swept(THETA_IN, start, stop, value + u * random.normal(size=value.shape), u))
    return readings, clearest


def sampled(case: Case, swept: list[Swept], random: np.random.Generator) -> Found:
    """Sample a case until the plan is content."""
    points: list[Measured] = []
    while batch := next_points(SPEC, points, swept):
        value = case(np.full(len(batch), THETA_IN), np.array([g.theta_out for g in batch]))
        u = noise(value, POINT_NOISE)
        value = value + u * random.normal(size=value.shape)
        points += [Measured(g, v, s, 1.0) for g, v, s in zip(batch, value, u, strict=True)]
    process = interpolation(SPEC, points)
    assert process is not None
    grid = [np.arange(a, b, 0.1) for a, b in segments(SPEC, THETA_IN)]
    theta_out = np.concatenate([*grid, [case.place]])
    theta_in = np.full(theta_out.size, THETA_IN)
    read, _ = predict_values(process, theta_in, theta_out)
    truth = case(theta_in, theta_out)
    lobe = truth[-1, 0] - case.ground
    return Found(
        bool(read[-1, 0] - case.ground < 0.5 * lobe), float(np.abs(np.log1p(read) - np.log1p(truth)).max()), len(points)
    )


def both_ways(case: Case, seed: int) -> tuple[Case, float, Found, Found]:
    """How clearly a case stands out, and what becomes of it with a pre-scan and without."""
    random = np.random.default_rng([11, seed])
    swept, clear = sweep(case, random)
    return case, clear, sampled(case, swept, random), sampled(case, [], random)


def main(arguments: Sequence[str]) -> None:
    """Print a table of both ways by width."""
    count = int(arguments[0]) if arguments else 1000
    random = np.random.default_rng(11)
    cases = [random_case(random) for _ in range(count)]
    begin = time.perf_counter()
    with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn")) as executor:
        rows = list(executor.map(both_ways, cases, range(count)))
    print(f"{count} lobes at theta_in = {THETA_IN:g} degrees, {time.perf_counter() - begin:.0f} s")
    above = [row for row in rows if row[1] > 5]
    print(
        f"{'width':>12}{'lobes':>7}   with pre-scan: missed, points, median and worst error   without: missed, points"
    )
    for low, high in ((0.3, 1.0), (1.0, 3.0), (3.0, 10.0), (10.0, 30.0)):
        here = [row for row in above if low <= row[0].width < high]
        if not here:
            continue
        seen, blind = [row[2] for row in here], [row[3] for row in here]
        errors = [f.error for f in seen]
        print(
            f"{low:5g} to {high:3g}{len(here):7}{sum(f.missed for f in seen):26}"
            f"{np.mean([f.points for f in seen]):8.1f}"
            f"{np.median(errors):10.4f}{max(errors):8.4f}{np.mean([f.missed for f in blind]):22.2f}"
            f"{np.mean([f.points for f in blind]):8.1f}"
        )
    for case, clear, found, _ in above:
        if found.missed:
            print(f"missed: {case}, {clear:.1f} standard deviations above the noise, error {found.error:.4f}")
    tell("random lobes more than five standard deviations above the noise of the pre-scan", len(above))
    tell("missed of those, with the pre-scan", sum(row[2].missed for row in above), aim="= 0")
    tell("missed of those, without it", 100 * float(np.mean([row[3].missed for row in above])), "%")
    tell("worst error of ln(1 + v) with it", max(row[2].error for row in above))


if __name__ == "__main__":
    main(sys.argv[1:])
