"""What a pass of the plan costs at 400 points of 1044 wavelengths.

    python -m tests.benchmarks.planning_cost

Tells milliseconds of processor time, and each as a part of the time in which the bench measures a batch meanwhile.
"""

import time
from collections.abc import Callable

import numpy as np

from goniometer.bench.route import Motion, travel
from goniometer.geometry import Geometry
from goniometer.interpolation.interpolant import predict_values
from goniometer.plans.learning import learnt_from
from goniometer.plans.plan import Measured, interpolation, next_points
from goniometer.plans.plan_spec import PlanSpec
from goniometer.scans.duration import DEAD_TIME
from simulators.costs.scans import process_of, uniform_directions
from tests.benchmarks.figures import tell
from tests.benchmarks.sampling import THETA_IN
from tests.benchmarks.sampling_materials import BANDS, MATERIALS

SPEC = PlanSpec(THETA_IN, tolerance=1e-5, colour_tolerance=None, minimum_step=0.05)
POINTS = 400
WAVELENGTHS = np.linspace(380.0, 990.0, 1044)
"""Nanometres."""


def best(work: Callable[[], object], times: int = 5) -> float:
    """Processor time of the shortest of some runs, milliseconds."""
    taken = []
    for _ in range(times):
        begin = time.process_time()
        work()
        taken.append(time.process_time() - begin)
    return 1e3 * min(taken)


def main() -> None:
    """Print the costs."""
    truth, random = MATERIALS["two lobes"], np.random.default_rng(1)
    grid = uniform_directions(SPEC, 2.0)
    chosen = [grid[i] for i in sorted(random.choice(len(grid), POINTS, replace=False))]
    theta_in, theta_out = np.array([g.theta_in for g in chosen]), np.array([g.theta_out for g in chosen])
    spectra = truth(theta_in, theta_out, WAVELENGTHS) * (1 + 1e-4 * random.normal(size=(POINTS, WAVELENGTHS.size)))
    coarse = {(g.theta_in, g.theta_out) for g in next_points(SPEC, [])}

    def measured() -> list[Measured]:
        bands = [np.abs(WAVELENGTHS - band) < 20 for band in BANDS]
        values = np.stack([spectra[:, band].mean(axis=1) for band in bands], axis=1)
        return [Measured(g, v, 1e-4 * v) for g, v in zip(chosen, values, strict=True)]

    first = [Geometry(*place) for place in sorted(coarse)]
    value = truth(np.array([g.theta_in for g in first]), np.array([g.theta_out for g in first]))
    points = [*(Measured(g, v, 1e-4 * v) for g, v in zip(first, value, strict=True)), *measured()][:POINTS]
    batch = next_points(SPEC, points)
    duration = 1e3 * (travel(batch, Motion()).seconds + DEAD_TIME * len(batch))

    def afresh() -> None:
        learnt_from.cache_clear()
        interpolation(SPEC, points)

    process = process_of(points)
    everywhere = np.repeat(THETA_IN, 162), np.tile(np.linspace(-85, 85, 162), len(THETA_IN))
    costs = {
        f"bands of {POINTS} points from {WAVELENGTHS.size} wavelengths": best(measured),
        f"a pass: fit, leave-one-out, errors, batch of {len(batch)}": best(lambda: next_points(SPEC, points)),
        "of it fit and leave-one-out": best(lambda: interpolation(SPEC, points)),
        "lobes and scales learnt anew, all milestones": best(afresh, 1),
        f"prediction at {everywhere[0].size} directions": best(lambda: predict_values(process, *everywhere)),
    }
    for what, cost in costs.items():
        aim = "< 50" if what.startswith("a pass") else ""
        tell(what, cost, f"ms, {100 * cost / duration:.2f} % of the next batch", aim)


if __name__ == "__main__":
    main()
