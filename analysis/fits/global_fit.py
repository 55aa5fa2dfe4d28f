"""The global model: one function of direction for the slopes of all spectra (Eqs. 3 to 5).

m(theta_m) = h cos(w theta_m) + t_y is singular at small w, where h and t_y only appear as their sum. The search
uses m0 + c (1 - cos(w theta_m)) / w^2 instead, which stays well conditioned, and goes through w on a grid. The
two-component slope (`analysis.reflectance.two_component`) starts from that cosine and goes downhill from many places.
"""

from itertools import product

import numpy as np
import scipy

from analysis.choices import Engine
from analysis.errors import FitError
from analysis.fits.global_verdict import SlopeEvidence, judge_slopes
from analysis.fits.least_squares import SumOfSquares, minimise
from analysis.fits.local_fit import local_gain, shifted_fresnel
from analysis.fits.misfit import MISFIT, excess, moved_by
from analysis.fits.propagation import correlation, covariance_by_part, errors_by_part
from analysis.fits.structure import Structure, structure
from analysis.reflectance.directions import Directions, in_plane
from analysis.reflectance.fresnel import Conductor, load_conductor
from analysis.reflectance.models import cosine_slope_derivative, shift_is_clamped
from analysis.reflectance.two_component import (
    TWO_COMPONENTS,
    two_component_shapes,
    two_component_slope,
    two_component_slope_derivative,
)
from analysis.results import LocalFit, ModelFit, Parameter
from drivers.arrays import FloatArray
from goniometer.datasets.angular import SAME_INCIDENCE, incidence_groups
from goniometer.datasets.dataset import Dataset
from goniometer.uncertainty import ErrorSource

W_BOUNDS = (0.1, 12.0)
"""Between which w is searched."""

LEAST_SLOPES = 5
"""Reliable slopes that a fit must have."""

_W_STEP = 0.1
_NAMES = {
    "constant-slope": ("t_y",),
    "global": ("h", "w", "t_y"),
    "global-two-component": ("h", "w", "t_y", "kappa", "sharpness", "threshold"),
}
_UNITS = {"h": "1/um", "t_y": "1/um"}
_SLOPES = {
    "constant-slope": "m = t_y",
    "global": "m = h cos(w theta_m) + t_y",
    "global-two-component": f"m = {TWO_COMPONENTS}",
}
_SHAPES = np.array(
    list(product((0.7, 1.2, 1.8, 2.5, 3.2, 4.0, 5.0, 7.0), (0.0, 0.3, 0.6, 1.0, 1.5), (0.1, 0.7, 3.0, 15.0, 50.0),
                 (-1.5, -0.7, 0.0, 0.7)))
)  # fmt: skip
"""[shapes, 4] w, kappa, sharpness and threshold among which a two-component slope looks for its starts."""

SLOPE_MODELS = tuple(_NAMES)
"""Names of the models that `global_fit` knows."""


def global_fit(
    dataset: Dataset,
    local: LocalFit,
    conductor: Conductor | None = None,
    engine: Engine = "fast",
    model: str = "global",
) -> ModelFit:
    """Fit one function of direction to the reliable slopes of `local`, and one exponent p to its exponents (Eq. 3).

    `model` is one of `SLOPE_MODELS`; "global" is the paper's cosine (Eq. 5). Slopes and exponents are weighted by the
    local uncertainties, of all errors: with the noise alone, the few brightest directions would decide, whose errors
    are anything but noise. Standard errors come from the measurement, errors that points or wavelengths share
    included; where the slopes (or exponents) scatter more than their uncertainty, by a reduced chi-square above one,
    they are inflated by its root (Birge ratio) and the verdict says so. What Eq. 2 does not describe of the spectra,
    and the model of the slopes where its residuals are structured, is a part of them, too (`analysis.fits.misfit`). The
    verdict of a cosine rests on an F-test against a constant slope. It is a model of normalised spectra: `fitted` takes
    its scale at lambda_n from `local`, point by point; p is absent where `local` held the exponents. r2 is that of the
    slopes, weighted. Raises `FitError` for fewer than five reliable slopes, or fewer than parameters and two more, and
    `OutOfRange` beyond the conductor's table.
    """
    metal = (conductor or load_conductor()) if local.fresnel else None
    used = local.reliable
    count, names = int(used.sum()), _NAMES[model]
    if count < max(LEAST_SLOPES, len(names) + 2):
        raise FitError(
            f"Only {count} of {used.size} spectra of {dataset.sample} have a reliable slope; "
            f"the model {model} needs at least {max(LEAST_SLOPES, len(names) + 2)}."
        )
    directions = in_plane(dataset.theta_in, dataset.theta_out)
    seen = Directions(*(cosine[used] for cosine in directions))
    slopes, weight = local.slope[used], local.u_slope[used] ** -2
    parameters, chi2 = search_slopes(model, slopes, weight, seen, engine)

    gain_of_slope, gain_of_exponent = local_gain(dataset, local, metal)
    columns = slope_and_derivative(model, seen, parameters)[1]
    root = np.sqrt(weight)
    estimator = np.asarray(np.linalg.pinv((columns * root).T, rcond=1e-14) * root, dtype=float)
    inflation = [np.sqrt(max(chi2 / (count - len(names)), 1.0))] * len(names)
    gain = np.zeros((len(names), *dataset.brdf.shape))
    gain[:, used] = estimator[:, :, None] * gain_of_slope[used]
    p = 0.0
    if local.fresnel:
        u_exponent = local.u_exponent[used]
        share = u_exponent**-2 / np.sum(u_exponent**-2)
        p = float(share @ local.exponent[used])
        gain_of_p = np.zeros(dataset.brdf.shape)
        gain_of_p[used] = share[:, None] * gain_of_exponent[used]
        gain = np.concatenate([gain, gain_of_p[None]])
        names += ("p",)
        chi2_p = float(np.sum(((local.exponent[used] - p) / u_exponent) ** 2))
        inflation.append(np.sqrt(max(chi2_p / (count - 1), 1.0)))
    by_part = covariance_by_part(gain, dataset.sources)
    residual = slopes - slope_and_derivative(model, seen, parameters)[0]
    of_residuals = _structure(dataset, local, gain_of_slope, residual)
    misfit = moved_by(estimator, local.misfit[0, used])
    if of_residuals.structured:
        misfit = np.hypot(
            misfit,
            moved_by(
                estimator,
                excess(residual, local.u_slope[used]),
                incidence_groups(dataset.theta_in[used], SAME_INCIDENCE),
            ),
        )
    if local.fresnel:
        misfit = np.append(misfit, share @ local.misfit[1, used])
    covariance = np.sum(list(by_part.values()), axis=0) * np.outer(inflation, inflation) + np.diag(misfit**2)
    sigma = np.sqrt(np.diag(covariance))

    constant = float(weight @ slopes / weight.sum())
    chi2_constant = float(weight @ (slopes - constant) ** 2)
    verdict = judge_slopes(
        SlopeEvidence(
            dataset=dataset,
            model=model,
            names=names,
            values=np.append(parameters, p)[: len(names)],
            u=sigma,
            w_bounds=W_BOUNDS,
            chi2=chi2,
            chi2_constant=chi2_constant,
            slopes=count,
            spectra=used.size,
            largest_theta_m=float(np.arccos(np.clip(seen.cos_m.min(), -1, 1))),
            scatter=float(inflation[0]),
            scatter_of_p=float(inflation[-1]) if local.fresnel else 1.0,
            other_w=_other_minima(slopes, weight, seen, float(parameters[1]), chi2) if model == "global" else (),
            structure=of_residuals,
            doubts=local.doubts,
        )
    )
    slope = slope_and_derivative(model, directions, parameters)[0]
    return ModelFit(
        model=model,
        equation=(
            f"f / f(lambda_n) = (1 + m (lambda - lambda_n)){' F_n^p' if local.fresnel else ''}, {_SLOPES[model]}, "
            "Eqs. 3-5"
        ),
        parameters=tuple(
            Parameter(
                name,
                float(value),
                float(sigma[i]),
                _UNITS.get(name, "1"),
                errors_by_part(by_part, i, inflation[i]) | ({MISFIT: float(misfit[i])} if misfit[i] > 0 else {}),
            )
            for i, (name, value) in enumerate(zip(names, [*parameters, p], strict=False))
        ),
        correlation=correlation(covariance),
        cost="weighted least squares of the local slopes",
        cost_value=chi2,
        r2=1 - chi2 / chi2_constant if chi2_constant > 0 else 0.0,
        verdict=verdict,
        fitted=shifted_fresnel(dataset, local.scale, slope, np.full(used.size, p), metal, local.lambda_n),
        lambda_n=local.lambda_n,
        theta_range=(
            float(dataset.theta_in[used].min()),
            float(dataset.theta_in[used].max()),
            float(dataset.theta_out[used].min()),
            float(dataset.theta_out[used].max()),
        ),
        wavelength_range=(float(dataset.wavelengths[0]), float(dataset.wavelengths[-1])),
        clamped_points=int(shift_is_clamped(slope, dataset.wavelengths, local.lambda_n).sum()),
        engine=engine,
        independent=of_residuals.independent,
    )


def slope_and_derivative(model: str, directions: Directions, parameters: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Slopes of the shift [...], 1/um, and their derivatives [parameters, ...], of a model of `SLOPE_MODELS`.

    Raises `OutOfRange` for a negative sharpness.
    """
    own = [float(value) for value in parameters]
    if model == "constant-slope":
        return np.full(directions.cos_m.shape, own[0]), np.ones((1, *directions.cos_m.shape))
    if model == "global-two-component":
        return two_component_slope(directions, *own), two_component_slope_derivative(directions, *own)[1]
    return cosine_slope_derivative(np.degrees(_theta_m(directions)), *own)


def _theta_m(directions: Directions) -> FloatArray:
    """Radians."""
    return np.asarray(np.arccos(np.clip(directions.cos_m, -1, 1)))


def search_slopes(
    model: str, slopes: FloatArray, weight: FloatArray, seen: Directions, engine: Engine
) -> tuple[FloatArray, float]:
    """Best parameters of a model of `SLOPE_MODELS`, and their chi-square: the sum of `weight` x squared residual.

    `slopes`, `weight` and the directions `seen` are [points].
    """
    if model == "constant-slope":
        constant = float(weight @ slopes / weight.sum())
        return np.array([constant]), float(weight @ (slopes - constant) ** 2)
    theta = _theta_m(seen)
    start = _on_the_grid(slopes, weight, theta)
    if model == "global" and engine == "fast":
        return _refine(slopes, weight, theta, start[1])
    problem = slope_problem(model, slopes, weight, seen)
    everything = np.ones(len(_NAMES[model]), dtype=bool)
    if model == "global":
        end = minimise(problem, start, everything, engine)
        return end.parameters, end.cost
    starts = [np.concatenate([start, np.zeros(3)]), *_two_component_starts(slopes, weight, seen)]
    ends = [minimise(problem, each, everything, "fast") for each in starts]
    best = min(ends, key=lambda end: end.cost)
    if engine == "lmfit":
        best = minimise(problem, best.parameters, everything, engine)
    return best.parameters, best.cost


def _two_component_starts(slopes: FloatArray, weight: FloatArray, seen: Directions) -> list[FloatArray]:
    """The best shape of each kappa, h and t_y solved for."""
    shapes = two_component_shapes(seen, _SHAPES)
    around = shapes - (shapes @ weight / weight.sum())[:, None]
    size, along = around**2 @ weight, around @ (weight * slopes)
    h = np.divide(along, size, out=np.zeros_like(size), where=size > 0)
    t_y = (slopes @ weight - h * (shapes @ weight)) / weight.sum()
    gained = h * along
    best = [np.flatnonzero(of)[np.argmax(gained[of])] for of in (_SHAPES[:, 1] == k for k in np.unique(_SHAPES[:, 1]))]
    return [np.array([h[i], _SHAPES[i, 0], t_y[i], *_SHAPES[i, 1:]]) for i in best]


def slope_problem(model: str, slopes: FloatArray, weight: FloatArray, seen: Directions) -> SumOfSquares:
    """Weighted squares of what a model leaves of `slopes` [points], for an engine to minimise."""
    root = np.sqrt(weight)
    lower = {"w": W_BOUNDS[0], "kappa": -5.0, "sharpness": 0.0, "threshold": -3.0}
    upper = {"w": W_BOUNDS[1], "kappa": 5.0, "sharpness": 100.0, "threshold": 3.0}

    def linearised(parameters: FloatArray) -> tuple[FloatArray, FloatArray]:
        value, jacobian = slope_and_derivative(model, seen, parameters)
        return root * (value - slopes), root * jacobian

    return SumOfSquares(
        lambda parameters: linearised(parameters)[0],
        linearised,
        lower=np.array([lower.get(name, -np.inf) for name in _NAMES[model]]),
        upper=np.array([upper.get(name, np.inf) for name in _NAMES[model]]),
    )


def _profile(slopes: FloatArray, weight: FloatArray, theta: FloatArray, w: FloatArray) -> tuple[FloatArray, ...]:
    """m0, c and chi-square, each [w], of the best m0 + c (1 - cos(w theta)) / w^2; `theta` [points] in radians."""
    # 2 sin^2(x / 2) is 1 - cos(x) without its cancellation
    basis = 2 * (np.sin(0.5 * w[:, None] * theta) / w[:, None]) ** 2
    total = weight.sum()
    middle = (basis @ weight) / total
    around = basis - middle[:, None]
    mean = (slopes @ weight) / total
    size = (around**2) @ weight
    # all directions at one theta_m: any c will do
    c = np.divide(around @ (weight * (slopes - mean)), size, out=np.zeros_like(size), where=size > 0)
    chi2 = ((slopes - mean - c[:, None] * around) ** 2) @ weight
    return mean - c * middle, c, chi2


def _grid() -> FloatArray:
    return np.arange(W_BOUNDS[0], W_BOUNDS[1] + 0.5 * _W_STEP, _W_STEP)


def _cosine_at(slopes: FloatArray, weight: FloatArray, theta: FloatArray, w: float) -> tuple[FloatArray, float]:
    """h, w, t_y and chi-square of the best cosine of this w."""
    m0, c, chi2 = (float(value[0]) for value in _profile(slopes, weight, theta, np.array([w])))
    h = -c / w**2
    return np.array([h, w, m0 - h]), chi2


def _on_the_grid(slopes: FloatArray, weight: FloatArray, theta: FloatArray) -> FloatArray:
    """h, w and t_y of the best cosine on a grid over w."""
    grid = _grid()
    best = float(grid[np.argmin(_profile(slopes, weight, theta, grid)[2])])
    return _cosine_at(slopes, weight, theta, best)[0]


def _refine(slopes: FloatArray, weight: FloatArray, theta: FloatArray, near: float) -> tuple[FloatArray, float]:
    """The best cosine within a step of the grid from the w `near`."""
    refined = scipy.optimize.minimize_scalar(
        lambda w: _cosine_at(slopes, weight, theta, float(w))[1],
        bounds=(max(near - _W_STEP, W_BOUNDS[0]), min(near + _W_STEP, W_BOUNDS[1])),
        method="bounded",
        options={"xatol": 1e-9},
    )
    return _cosine_at(slopes, weight, theta, float(refined.x))


def _other_minima(
    slopes: FloatArray, weight: FloatArray, seen: Directions, best: float, chi2: float
) -> tuple[float, ...]:
    """Other w whose minimum is as good within the noise: chi-square, divided by its reduced best, up by less than 9.21.

    That is exceeded once in a hundred times by a chi-square of two degrees of freedom.
    """
    theta = _theta_m(seen)
    grid = _grid()
    costs = _profile(slopes, weight, theta, grid)[2]
    inner = (costs[1:-1] < costs[:-2]) & (costs[1:-1] < costs[2:])
    limit = chi2 + 9.21 * max(chi2 / (slopes.size - 3), 1.0)
    ends = [_refine(slopes, weight, theta, float(w)) for w in grid[1:-1][inner & (costs[1:-1] < 1.05 * limit)]]
    return tuple(float(end[1]) for end, cost in ends if cost < limit and abs(end[1] - best) > _W_STEP)


def _structure(dataset: Dataset, local: LocalFit, gain: FloatArray, residual: FloatArray) -> Structure:
    """Whether what is left of the slopes, measured minus model [used], is noise; `gain` as of `local_gain`."""
    used = local.reliable
    errors = []
    for source in dataset.sources:
        effect = (gain * source.values)[used]
        total = effect.sum(axis=1) if source.shared_by_wavelengths else np.linalg.norm(effect, axis=1)
        groups = None if source.groups is None else source.groups[used]
        errors.append(ErrorSource(source.name, source.part, total[:, None], groups, True))
    return structure(
        residual[:, None],
        np.ones((residual.size, 1), dtype=bool),
        tuple(errors),
        dataset.theta_in[used],
        dataset.theta_out[used],
    )
