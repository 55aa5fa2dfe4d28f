"""Two engines for a sum of squares of few parameters and many residuals.

"fast" is Levenberg-Marquardt with the model's own derivatives on the normal equations, which are as small as the
parameters are few (Marquardt 1963, with its scaling by the diagonal; bounds by projection). "lmfit" is the library
that the paper used, with derivatives by differences; it takes longer and knows nothing of our derivatives, so that
the one can be held against the other. Both go downhill from where they start: where to start is the fit's business.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from analysis.choices import Engine
from drivers.arrays import BoolArray, FloatArray

_ITERATIONS = 200
_EVALUATIONS = 2000
_STEP_TOLERANCE = 1e-9
_COST_TOLERANCE = 1e-8


@dataclass(frozen=True)
class SumOfSquares:
    """What is minimised: the sum of squares of `residual`."""

    residual: Callable[[FloatArray], FloatArray]
    """Residuals [data] at parameters [parameters]."""
    linearised: Callable[[FloatArray], tuple[FloatArray, FloatArray]]
    """Residuals [data] and their derivatives [parameters, data]."""
    lower: FloatArray
    """[parameters] lower bounds, -inf for none."""
    upper: FloatArray
    """[parameters] upper bounds, inf for none."""


@dataclass(frozen=True)
class Minimum:
    """Where an engine stopped."""

    parameters: FloatArray
    """[parameters]"""
    cost: float
    """Sum of squares of the residuals."""
    converged: bool
    message: str
    """Why the engine stopped; a sentence where it did not converge."""


def minimise(problem: SumOfSquares, start: FloatArray, free: BoolArray, engine: Engine) -> Minimum:
    """Go downhill from `start` [parameters], changing only the parameters that are `free` [parameters]."""
    if not free.any():
        residual = problem.residual(start)
        return Minimum(start, float(residual @ residual), True, "nothing was free")
    if engine == "lmfit":
        return _by_lmfit(problem, start, free)
    return _marquardt(problem, np.clip(start, problem.lower, problem.upper), free)


def _marquardt(problem: SumOfSquares, start: FloatArray, free: BoolArray) -> Minimum:
    """Levenberg-Marquardt with Nielsen's damping (1999); a step that leads out of the bounds stops at them."""
    parameters, damping, growth = start.copy(), 1e-3, 2.0
    residual, jacobian = problem.linearised(parameters)
    cost = float(residual @ residual)
    for _ in range(_ITERATIONS):
        some = _movable(problem, parameters, jacobian @ residual, free)
        if not some.any():
            return Minimum(parameters, cost, True, "all parameters stand at their bounds")
        normal, gradient = jacobian[some] @ jacobian[some].T, jacobian[some] @ residual
        scale = np.diag(np.where(np.diag(normal) > 0, np.diag(normal), 1.0))
        while True:
            trial = parameters.copy()
            trial[some] -= np.linalg.solve(normal + damping * scale, gradient)
            trial = np.clip(trial, problem.lower, problem.upper)
            step = (trial - parameters)[some]
            small = bool(np.all(np.abs(step) <= _STEP_TOLERANCE * (1e-3 + np.abs(parameters[some]))))
            new_residual, new_jacobian = problem.linearised(trial)
            gained = cost - float(new_residual @ new_residual)
            if gained >= 0:
                break
            if small:
                return Minimum(parameters, cost, True, "no smaller step descends")
            damping, growth = damping * growth, 2 * growth
        expected = -float(step @ (2 * gradient + normal @ step))
        ratio = min(gained / expected, 1.0) if expected > 0 else 1.0
        damping, growth = damping * max(1 / 3, 1 - (2 * ratio - 1) ** 3), 2.0
        parameters, residual, jacobian, cost = trial, new_residual, new_jacobian, cost - gained
        if small or max(gained, expected) <= _COST_TOLERANCE * cost:
            return Minimum(parameters, cost, True, "the step or its gain is below what matters")
    return Minimum(parameters, cost, False, f"After {_ITERATIONS} steps the cost still fell.")


def _movable(problem: SumOfSquares, parameters: FloatArray, gradient: FloatArray, free: BoolArray) -> BoolArray:
    """[parameters] which are free and not pressed against a bound by their gradient."""
    pressed = ((parameters <= problem.lower) & (gradient > 0)) | ((parameters >= problem.upper) & (gradient < 0))
    return np.asarray(free & ~pressed)


def _by_lmfit(problem: SumOfSquares, start: FloatArray, free: BoolArray) -> Minimum:
    import lmfit  # noqa: PLC0415  (takes most of a second)

    parameters = lmfit.Parameters()
    for i, value in enumerate(start):
        low, high = problem.lower[i], problem.upper[i]
        # lmfit sees no slope at a bound, so that a start there would never leave it
        inside = min(max(value, low + 1e-6), high - 1e-6) if free[i] else value
        parameters.add(f"p{i}", value=inside, vary=bool(free[i]), min=low, max=high)

    def residual(wanted: lmfit.Parameters) -> FloatArray:
        return problem.residual(np.array([wanted[f"p{i}"].value for i in range(start.size)]))

    result = lmfit.minimize(residual, parameters, method="leastsq", calc_covar=False, max_nfev=_EVALUATIONS)
    best = np.array([result.params[f"p{i}"].value for i in range(start.size)])
    # beyond the codes that lmfit calls success, MINPACK's 6 to 8 say that rounding stops any further descent
    converged = not result.aborted and result.ier in {1, 2, 3, 4, 6, 7, 8} and math.isfinite(result.chisqr)
    return Minimum(best, float(result.chisqr), converged, f"lmfit: {' '.join(str(result.message).split())}")
