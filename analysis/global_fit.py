"""The global model: one cosine for the slopes of all directions (Eqs. 3 to 5).

m(theta_m) = h cos(w theta_m) + t_y is singular at small w, where h and t_y only appear as their sum. The search
uses m0 + c (1 - cos(w theta_m)) / w^2 instead, which stays well conditioned, and goes through w on a grid.
"""

from dataclasses import replace

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.stats import f as f_distribution

from analysis.errors import FitError
from analysis.fresnel import Conductor, load_conductor
from analysis.local_fit import local_gain, shifted_fresnel
from analysis.models import cosine_slope, shift_is_clamped
from analysis.noise import flag_sentences
from analysis.propagation import correlation, covariance_by_part, errors_by_part, variance_of_each_point
from analysis.results import LocalFit, ModelFit, Parameter, Verdict
from drivers.arrays import FloatArray
from goniometer.dataset import Dataset

W_BOUNDS = (0.1, 12.0)
"""Between which w is searched."""

_W_STEP = 0.1
_SIGNIFICANCE = 0.01


def global_fit(dataset: Dataset, local: LocalFit, conductor: Conductor | None = None) -> ModelFit:
    """Fit Eq. 5 to the reliable slopes of `local`, and one exponent p to its exponents (Eq. 3).

    Both are weighted by the local uncertainties, of all errors: with the noise alone, the few brightest directions
    would decide, whose errors are anything but noise. Standard errors come from the measurement, errors that points
    or wavelengths share included; where the slopes (or exponents) scatter more than their uncertainty, by a reduced
    chi-square above one, they are inflated by its root (Birge ratio) and the verdict says so. The verdict
    rests on an F-test of the cosine against a constant slope. It is a model of normalised spectra: `fitted`
    takes its scale at lambda_n from `local`, point by point. r2 is that of the slopes, weighted.
    Raises `FitError` for fewer than five reliable slopes.
    """
    conductor = conductor or load_conductor()
    used = local.reliable
    count = int(used.sum())
    if count < 5:
        raise FitError(
            f"Only {count} of {used.size} spectra of {dataset.sample} have a reliable slope; "
            "the global model needs at least 5."
        )
    theta_m = 0.5 * np.abs(dataset.theta_out - dataset.theta_in)
    slopes, weight, theta = local.slope[used], local.u_slope[used] ** -2, np.radians(theta_m[used])
    h, w, t_y, chi2 = _search(slopes, weight, theta)

    gain_of_slope, gain_of_exponent = local_gain(dataset, local, conductor)
    u_exponent = np.sqrt(variance_of_each_point(gain_of_exponent, dataset.sources))[used]
    share = u_exponent**-2 / np.sum(u_exponent**-2)
    p = float(share @ local.exponent[used])

    estimator = _estimator(theta, weight, h, w)
    gain = np.zeros((4, *dataset.brdf.shape))
    gain[:3, used] = estimator[:, :, None] * gain_of_slope[used]
    gain[3, used] = share[:, None] * gain_of_exponent[used]
    by_part = covariance_by_part(gain, dataset.sources)
    covariance = sum(by_part.values())
    scatter = np.sqrt(max(chi2 / (count - 3), 1.0))
    scatter_p = np.sqrt(max(float(np.sum(((local.exponent[used] - p) / u_exponent) ** 2)) / (count - 1), 1.0))
    inflation = np.array([scatter, scatter, scatter, scatter_p])
    covariance = covariance * np.outer(inflation, inflation)
    standard_errors = np.sqrt(np.diag(covariance))

    # at its lower bound w is not determined, whatever its linear error says
    determined = w > W_BOUNDS[0] * 1.001 and abs(h) > 3 * standard_errors[0] and w > 3 * standard_errors[1]
    constant = float(weight @ slopes / weight.sum())
    chi2_constant = float(weight @ (slopes - constant) ** 2)
    verdict = _verdict(
        chi2, chi2_constant, count, used.size, w, bool(determined), float(theta.max()), scatter, scatter_p
    )
    verdict = replace(verdict, reasons=verdict.reasons + flag_sentences(dataset))

    slope = cosine_slope(theta_m, h, w, t_y)
    return ModelFit(
        model="global",
        equation="f / f(lambda_n) = (1 + m (lambda - lambda_n)) F_n^p, m = h cos(w theta_m) + t_y, Eqs. 3-5",
        parameters=tuple(
            Parameter(name, float(value), float(error), unit, errors_by_part(by_part, i, float(inflation[i])))
            for i, (name, value, error, unit) in enumerate(
                zip(("h", "w", "t_y", "p"), (h, w, t_y, p), standard_errors, ("1/um", "1", "1/um", "1"), strict=True)
            )
        ),
        correlation=correlation(covariance),
        cost="weighted least squares of the local slopes",
        cost_value=chi2,
        r2=1 - chi2 / chi2_constant if chi2_constant > 0 else 0.0,
        verdict=verdict,
        fitted=shifted_fresnel(dataset, local.scale, slope, np.full(used.size, p), conductor, local.lambda_n),
        lambda_n=local.lambda_n,
        theta_range=(
            float(dataset.theta_in[used].min()),
            float(dataset.theta_in[used].max()),
            float(dataset.theta_out[used].min()),
            float(dataset.theta_out[used].max()),
        ),
        wavelength_range=(float(dataset.wavelengths[0]), float(dataset.wavelengths[-1])),
        clamped_points=int(shift_is_clamped(slope, dataset.wavelengths, local.lambda_n).sum()),
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


def _search(slopes: FloatArray, weight: FloatArray, theta: FloatArray) -> tuple[float, float, float, float]:
    """h, w, t_y and chi-square of the best cosine: a grid over w, then a bounded refinement around its best."""
    grid = np.arange(W_BOUNDS[0], W_BOUNDS[1] + 0.5 * _W_STEP, _W_STEP)
    best = float(grid[np.argmin(_profile(slopes, weight, theta, grid)[2])])
    bounds = max(best - _W_STEP, W_BOUNDS[0]), min(best + _W_STEP, W_BOUNDS[1])
    refined = minimize_scalar(
        lambda w: float(_profile(slopes, weight, theta, np.array([w]))[2][0]),
        bounds=bounds,
        method="bounded",
        options={"xatol": 1e-9},
    )
    w = float(refined.x)
    m0, c, chi2 = (float(value[0]) for value in _profile(slopes, weight, theta, np.array([w])))
    h = -c / w**2
    return h, w, m0 - h, chi2


def _estimator(theta: FloatArray, weight: FloatArray, h: float, w: float) -> FloatArray:
    """[3, points] derivative of h, w and t_y by each slope at the solution, by a QR decomposition."""
    jacobian = np.stack([np.cos(w * theta), -h * theta * np.sin(w * theta), np.ones_like(theta)], axis=-1)
    root = np.sqrt(weight)
    return np.asarray(np.linalg.pinv(jacobian * root[:, None], rcond=1e-14) * root)


def _verdict(
    chi2: float,
    chi2_constant: float,
    count: int,
    total: int,
    w: float,
    determined: bool,
    theta_range: float,
    scatter: float,
    scatter_p: float,
) -> Verdict:
    """Whether the cosine beats a constant slope, and what else has to be said."""
    f_value = ((chi2_constant - chi2) / 2) / (chi2 / (count - 3)) if chi2 > 0 else np.inf
    # w is free only under the cosine; the search tries about this many independent ones, each a chance to fool it
    trials = max(1.0, W_BOUNDS[1] * theta_range / np.pi)
    probability = min(1.0, trials * float(f_distribution.sf(f_value, 2, count - 3)))
    against, notes = [], []
    if probability > _SIGNIFICANCE:
        against.append(
            f"The slopes are explained as well by a constant (F-test, p = {probability:.2g}), so h and w mean nothing."
        )
    elif not determined:
        against.append(
            f"h and w = {w:.2g} are not told from zero: the slopes are as good as a parabola in theta_m, of which "
            "h + t_y and h w^2 are determined and nothing else."
        )
    if w >= W_BOUNDS[1] * 0.999:
        against.append(f"w stopped at its upper bound of {W_BOUNDS[1]:g}: the slopes vary faster than was searched.")
    if count < total:
        notes.append(f"{total - count} of {total} spectra have no reliable slope and were left out.")
    if scatter > 1:
        notes.append(
            f"The slopes scatter {scatter:.3g} times as much as their combined standard uncertainty; "
            "the standard errors of h, w and t_y are inflated by this factor (Birge ratio)."
        )
    if scatter_p > 1:
        notes.append(
            f"The exponents scatter {scatter_p:.3g} times as much as their combined standard uncertainty; "
            "the standard error of p is inflated by this factor (Birge ratio)."
        )
    return Verdict(not against, (*against, *notes))
