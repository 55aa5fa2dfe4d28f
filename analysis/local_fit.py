"""Eq. 2 fitted to every spectrum on its own.

f(lambda) = a (1 + m x) F_n^p with x = (lambda - lambda_n) / 1000 in um and F_n = F / F(lambda_n) at the incident
angle. The scale a is free: dividing by the one sample at lambda_n instead would hand its noise to the slope.
For a given p the model is linear in a and a m, so only p is searched (variable projection; Golub & Pereyra
1973, with Kaufman's 1975 step), for all spectra at once. That is the engine "fast"; "lmfit" is the library's
Levenberg-Marquardt in a, m and p from one start, spectrum by spectrum as in the paper, to hold it against.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.errors import FitError
from analysis.fresnel import Conductor, load_conductor
from analysis.least_squares import Engine
from analysis.models import LAMBDA_N, normalised_fresnel, shift
from analysis.propagation import variance_of_each_point
from analysis.results import LocalFit
from drivers.arrays import BoolArray, FloatArray
from goniometer.dataset import Dataset

EXPONENT_BOUNDS = (-5.0, 15.0)
"""Between which p is searched."""

LEAST_WAVELENGTHS = 5
"""Valid wavelengths that a spectrum must have: three parameters and something left to judge them by."""

_STARTS = np.linspace(*EXPONENT_BOUNDS, 9)
_ITERATIONS = 80
_TOLERANCE = 1e-8
_ROUGHLY = 1e-4
_AT_ONCE = 64


class _Spectra(NamedTuple):
    """What the fit reads; wavelengths last."""

    values: FloatArray
    """[points, wavelengths] BRDF, 1/sr; 0 where there is none."""
    root_weight: FloatArray
    """[points, wavelengths] one over the standard uncertainty from the counts; 0 where there is no value."""
    x: FloatArray
    """[wavelengths] distance to lambda_n, um."""
    log_fresnel: FloatArray
    """[points, wavelengths] logarithm of F / F(lambda_n) at the incident angle."""

    target: FloatArray
    """[points, wavelengths] values times root_weight."""

    def take(self, points: BoolArray | NDArray[np.intp]) -> "_Spectra":
        if points.dtype == np.bool_ and points.all():
            return self
        values, root_weight, log_fresnel, target = (
            part[points] for part in (self.values, self.root_weight, self.log_fresnel, self.target)
        )
        return _Spectra(values, root_weight, self.x, log_fresnel, target)

    def binned(self, count: int) -> "_Spectra":
        """The same averaged over neighbours to about `count` wavelengths: a good estimate costs little there."""
        edges = np.arange(0, self.x.size, max(1, self.x.size // count))
        members = np.diff(np.append(edges, self.x.size))
        weight = np.add.reduceat(self.root_weight**2, edges, axis=1)
        root_weight = np.sqrt(weight)
        safe = np.where(weight > 0, weight, 1.0)
        values = np.add.reduceat(self.target * self.root_weight, edges, axis=1) / safe
        log_fresnel = np.add.reduceat(self.log_fresnel, edges, axis=1) / members
        x = np.add.reduceat(self.x, edges) / members
        return _Spectra(values, root_weight, x, log_fresnel, values * root_weight)


class _State(NamedTuple):
    """Best linear parameters for given exponents; [points] but for the columns."""

    scale: FloatArray
    tilt: FloatArray
    """a m, 1/(sr um)."""
    columns: FloatArray
    """[points, 3, wavelengths] derivatives of the weighted model by a, a m and p."""


def local_fit(
    dataset: Dataset,
    conductor: Conductor | None = None,
    lambda_n: float = LAMBDA_N,
    engine: Engine = "fast",
    fresnel: bool = True,
) -> LocalFit:
    """Fit Eq. 2 to every spectrum of `dataset`, weighted by the noise of its counts (`dataset.u_counts`).

    `conductor` is aluminium unless given; without `fresnel` the exponent p is held at 0, as for a dielectric whose
    reflectance knows no wavelength (section 5.6), and the conductor is not asked. The uncertainty of the slope follows
    from all errors of the measurement by the delta method, those that wavelengths share included. A spectrum with
    fewer than five valid wavelengths gets NaN. Unreliable are points that are not usable (`dataset.usable`), those
    whose median signal is below its noise, and those whose exponent stopped at a bound (-5, 15) or did not settle.
    Both engines find the same: slopes agree to 1e-7 of 1/um where the spectrum determines them.
    Raises `OutOfRange` for wavelengths that the conductor does not cover, `FitError` if no spectrum is valid.
    """
    spectra = _spectra(dataset, (conductor or load_conductor()) if fresnel else None, lambda_n)
    enough = np.count_nonzero(spectra.root_weight, axis=1) >= LEAST_WAVELENGTHS
    if not enough.any():
        raise FitError(
            f"No spectrum of {dataset.sample} has {LEAST_WAVELENGTHS} wavelengths with a value and an uncertainty "
            "from its counts above zero; check the calibration."
        )
    fitted_spectra = spectra.take(enough)
    if not fresnel:
        exponent, settled = np.zeros(int(enough.sum())), np.ones(int(enough.sum()), dtype=bool)
        state = _state(fitted_spectra, exponent)
    elif engine == "fast":
        exponent, settled = _search_exponent(fitted_spectra)
        state = _state(fitted_spectra, exponent)
    else:
        exponent, state, settled = _by_lmfit(fitted_spectra)
    slope = _ratio(state.tilt, state.scale)
    gain = np.zeros(dataset.brdf.shape)
    gain[enough] = _slope_and_exponent_gain(fitted_spectra, state, slope, fresnel)[0] * fitted_spectra.root_weight
    u_slope = np.sqrt(variance_of_each_point(gain, dataset.sources))[enough]

    fitted = _model(state.scale, slope, exponent, fitted_spectra)
    noise = np.where(fitted_spectra.root_weight > 0, fitted * fitted_spectra.root_weight, np.nan)
    low, high = EXPONENT_BOUNDS
    reliable = (
        settled
        & (np.nanmedian(noise, axis=1) >= 1)
        & (exponent > low)
        & (exponent < high)
        & np.isfinite(u_slope)
        & dataset.usable[enough]
    )

    def at_all_points(values: FloatArray) -> FloatArray:
        result = np.full((enough.size, *values.shape[1:]), np.nan)
        result[enough] = values
        return result

    everywhere = np.zeros(enough.size, dtype=bool)
    everywhere[enough] = reliable
    return LocalFit(
        slope=at_all_points(slope),
        u_slope=at_all_points(u_slope),
        exponent=at_all_points(exponent),
        scale=at_all_points(state.scale),
        r2=at_all_points(_r2(fitted_spectra, fitted)),
        reliable=everywhere,
        fitted=at_all_points(fitted),
        lambda_n=lambda_n,
        fresnel=fresnel,
    )


def local_exponents(dataset: Dataset, conductor: Conductor | None = None, lambda_n: float = LAMBDA_N) -> FloatArray:
    """[points] the exponents p of `local_fit` alone, without all that is made of them."""
    return _search_exponent(_spectra(dataset, conductor or load_conductor(), lambda_n))[0]


def local_gain(dataset: Dataset, local: LocalFit, conductor: Conductor | None) -> FloatArray:
    """[2, points, wavelengths] derivative of slope (1/um) and exponent by each BRDF value, at the fit's solution.

    `conductor` is that of the fit, None for one without Fresnel term. Zero where a value was not used, and at points
    that are not reliable. This is what passes errors that
    points share on to whatever is made of the slopes.
    """
    used = local.reliable
    spectra = _spectra(dataset, conductor, local.lambda_n).take(used)
    gain = np.zeros((2, *dataset.brdf.shape))
    state = _state(spectra, local.exponent[used])
    gain[:, used] = _slope_and_exponent_gain(spectra, state, local.slope[used], local.fresnel) * spectra.root_weight
    return gain


def shifted_fresnel(
    dataset: Dataset,
    scale: FloatArray,
    slope: FloatArray,
    exponent: FloatArray,
    conductor: Conductor | None,
    lambda_n: float,
) -> FloatArray:
    """[points, wavelengths] a shift F_n^p (Eq. 3) for `scale`, `slope` (1/um) and `exponent`, all [points].

    Without a `conductor` F_n is one.

    Unlike a local fit it is a model to be evaluated, so a negative shift is clamped at zero.
    """
    power = np.exp(exponent[:, None] * _spectra(dataset, conductor, lambda_n).log_fresnel)
    return np.asarray(scale[:, None] * shift(slope, dataset.wavelengths, lambda_n) * power)


def _spectra(dataset: Dataset, conductor: Conductor | None, lambda_n: float) -> _Spectra:
    log_fresnel = np.zeros(dataset.brdf.shape)
    if conductor is not None:
        # many points share an incident angle
        angles, of_point = np.unique(dataset.theta_in, return_inverse=True)
        log_fresnel = np.log(normalised_fresnel(angles, dataset.wavelengths, conductor, lambda_n))[of_point]
    u = dataset.u_counts
    valid = np.isfinite(dataset.brdf) & np.isfinite(u) & (u > 0)
    values = np.where(valid, dataset.brdf, 0.0)
    root_weight = np.where(valid, 1 / np.where(valid, u, 1.0), 0.0)
    return _Spectra(
        values=values,
        root_weight=root_weight,
        x=(dataset.wavelengths - lambda_n) * 1e-3,
        log_fresnel=log_fresnel,
        target=values * root_weight,
    )


def _ratio(numerator: FloatArray, denominator: FloatArray) -> FloatArray:
    """Element-wise ratio, NaN where the denominator is zero."""
    return np.asarray(np.divide(numerator, denominator, out=np.full_like(numerator, np.nan), where=denominator != 0))


def _model(scale: FloatArray, slope: FloatArray, exponent: FloatArray, spectra: _Spectra) -> FloatArray:
    power = np.exp(exponent[:, None] * spectra.log_fresnel)
    return np.asarray(scale[:, None] * (1 + slope[:, None] * spectra.x) * power)


class _Normal(NamedTuple):
    """Normal matrices of the two linear columns, each [points]."""

    aa: FloatArray
    ab: FloatArray
    bb: FloatArray

    def solve(self, a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Coefficients of the two columns, in closed form."""
        determinant = self.aa * self.bb - self.ab**2
        return (self.bb * a - self.ab * b) / determinant, (self.aa * b - self.ab * a) / determinant


def _linear(first: FloatArray, second: FloatArray, target: FloatArray) -> tuple[FloatArray, FloatArray, _Normal]:
    """Scale and tilt [points] that fit the weighted `target` best, and their normal equations."""
    normal = _Normal(_dot(first, first), _dot(first, second), _dot(second, second))
    return *normal.solve(_dot(first, target), _dot(second, target)), normal


def _dot(one: FloatArray, other: FloatArray) -> FloatArray:
    return np.asarray(np.vecdot(one, other))


def _columns(spectra: _Spectra, exponent: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Weighted derivatives of the model by a and a m, each [points, wavelengths]."""
    first = exponent[:, None] * spectra.log_fresnel
    np.exp(first, out=first)
    first *= spectra.root_weight
    return first, first * spectra.x


def _state(spectra: _Spectra, exponent: FloatArray) -> _State:
    """The best linear parameters for given exponents [points]."""
    first, second = _columns(spectra, exponent)
    scale, tilt, _ = _linear(first, second, spectra.target)
    return _at(spectra, exponent, scale, tilt)


def _at(spectra: _Spectra, exponent: FloatArray, scale: FloatArray, tilt: FloatArray) -> _State:
    """Any parameters [points]."""
    first, second = _columns(spectra, exponent)
    model = scale[:, None] * first + tilt[:, None] * second
    return _State(scale, tilt, np.stack([first, second, model * spectra.log_fresnel], axis=1))


def _profile(spectra: _Spectra, exponent: FloatArray) -> tuple[FloatArray, FloatArray]:
    """[points] cost of the best linear parameters for given exponents, and Kaufman's Gauss-Newton step of these.

    The residual has no part along the two linear columns, so the step is its part along what these leave of the third.
    """
    first, second = _columns(spectra, exponent)
    scale, tilt, normal = _linear(first, second, spectra.target)
    model = (scale[:, None] + tilt[:, None] * spectra.x) * first
    residual = spectra.target - model
    model *= spectra.log_fresnel
    with_first, with_second, size = _dot(first, model), _dot(second, model), _dot(model, model)
    along, across = normal.solve(with_first, with_second)
    left = size - along * with_first - across * with_second
    # a column that the others replace but for 1e-13 says nothing of p in double precision
    solvable = left > 1e-13 * size
    step = np.where(solvable, _dot(model, residual) / np.where(solvable, left, 1.0), 0.0)
    return _dot(residual, residual), np.nan_to_num(step)


def _inverse_normal(columns: FloatArray) -> FloatArray:
    """[points, n, n] inverse normal matrices, scaled to a unit diagonal first; NaN where singular."""
    normal = columns @ columns.transpose(0, 2, 1)
    size = np.sqrt(np.einsum("pii->pi", normal))
    solvable = np.all(size > 0, axis=1)
    size = np.where(solvable[:, None], size, 1.0)
    scaled = normal / (size[:, :, None] * size[:, None, :])
    # a correlation within 1e-13 of one is beyond double precision
    solvable &= np.linalg.det(scaled) > 1e-13
    scaled[~solvable] = np.eye(columns.shape[1])
    inverse = np.linalg.inv(scaled) / (size[:, :, None] * size[:, None, :])
    inverse[~solvable] = np.nan
    return np.asarray(inverse)


def _search_exponent(spectra: _Spectra) -> tuple[FloatArray, BoolArray]:
    """[points] best exponents within the bounds, and whether the search settled.

    On binned spectra from the best of nine exponents, so that a second minimum does not catch it, and from there on all
    wavelengths, a few spectra at a time, so that they stay in the processor's cache.
    """
    points = spectra.values.shape[0]
    binned = spectra.binned(50)
    coarse = binned.binned(16)
    costs = [_profile(coarse, np.full(points, p))[0] for p in _STARTS]
    exponent, settled = _descend(binned, _STARTS[np.argmin(costs, axis=0)], _ROUGHLY)
    for block in np.array_split(np.arange(points), max(1, round(points / _AT_ONCE))):
        exponent[block], settled[block] = _descend(spectra.take(block), exponent[block], _TOLERANCE)
    return exponent, settled


def _descend(spectra: _Spectra, exponent: FloatArray, tolerance: float) -> tuple[FloatArray, BoolArray]:
    """Gauss-Newton steps from `exponent`, halved wherever they do not lower the cost; and whether they settled."""
    exponent = exponent.copy()
    settled = np.zeros(exponent.size, dtype=bool)
    cost, wanted = _profile(spectra, exponent)
    before = np.full(exponent.size, np.nan)
    for _ in range(_ITERATIONS):
        here = exponent[~settled]
        step = np.clip(here + wanted, *EXPONENT_BOUNDS) - here
        exponent[~settled] = here + step
        # steps shrink by about the same factor each time, so the next one is known before it is made
        going = np.abs(step) * np.fmin(np.abs(step / before), 1.0) >= tolerance
        if going.any():
            trial = _profile(spectra, here + step)
            # the cost of a step below a millionth is lost in rounding, so such a step is taken as it is
            while np.any(worse := (trial[0] > cost) & (np.abs(step) > 1e-6)):
                step = np.where(worse, 0.5 * step, step)
                trial = _profile(spectra, here + step)
            exponent[~settled] = here + step
            cost, wanted, before = trial[0][going], trial[1][going], step[going]
            spectra = spectra.take(going)
        settled[~settled] = ~going
        if settled.all():
            break
    return exponent, settled


def _by_lmfit(spectra: _Spectra) -> tuple[FloatArray, _State, BoolArray]:
    """Exponents, state and whether it converged, of lmfit's Levenberg-Marquardt on each spectrum from m = 0, p = 1."""
    import lmfit  # noqa: PLC0415  (takes most of a second)

    low, high = EXPONENT_BOUNDS
    found = np.empty((3, spectra.values.shape[0]))
    converged = np.zeros(spectra.values.shape[0], dtype=bool)
    for point, (values, weight, logarithm) in enumerate(
        zip(spectra.values, spectra.root_weight, spectra.log_fresnel, strict=True)
    ):

        def residual(
            p: lmfit.Parameters, values: FloatArray = values, weight: FloatArray = weight, log_f: FloatArray = logarithm
        ) -> FloatArray:
            model = p["a"].value * (1 + p["m"].value * spectra.x) * np.exp(p["p"].value * log_f)
            return np.asarray(weight * (model - values))

        parameters = lmfit.Parameters()
        parameters.add("a", value=float(values @ weight**2 / (weight @ weight)))
        parameters.add("m", value=0.0)
        parameters.add("p", value=1.0, min=low, max=high)
        result = lmfit.minimize(residual, parameters, calc_covar=False, ftol=1e-15, xtol=1e-15, gtol=1e-15)
        found[:, point] = [result.params[name].value for name in ("a", "m", "p")]
        # MINPACK's 6 to 8 say that rounding stops any further descent, as these tolerances want it
        converged[point] = result.ier in {1, 2, 3, 4, 6, 7, 8}
    scale, slope, exponent = found
    return exponent, _at(spectra, exponent, scale, scale * slope), converged


def _slope_and_exponent_gain(spectra: _Spectra, state: _State, slope: FloatArray, fresnel: bool) -> FloatArray:
    """[2, points, wavelengths] derivative of slope and exponent by the weighted data; 0 of an exponent that is held."""
    columns = state.columns if fresnel else state.columns[:, :2]
    gain = _inverse_normal(columns) @ columns
    of_slope = _ratio(gain[:, 1] - slope[:, None] * gain[:, 0], np.broadcast_to(state.scale[:, None], gain[:, 0].shape))
    return np.stack([of_slope, gain[:, 2] if fresnel else np.zeros_like(of_slope)])


def _r2(spectra: _Spectra, fitted: FloatArray) -> FloatArray:
    """[points] coefficient of determination over the valid wavelengths, unweighted; NaN for a constant spectrum."""
    valid = spectra.root_weight > 0
    count = valid.sum(axis=1)
    mean = spectra.values.sum(axis=1) / count
    around = np.where(valid, spectra.values - mean[:, None], 0.0)
    left = np.where(valid, spectra.values - fitted, 0.0)
    return 1 - _ratio(np.sum(left**2, axis=1), np.sum(around**2, axis=1))
