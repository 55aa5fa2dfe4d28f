"""Eq. 2 fitted to every spectrum on its own.

f(lambda) = a (1 + m x) F_n^p with x = (lambda - lambda_n) / 1000 in um and F_n = F / F(lambda_n) at the incident
angle. The scale a is free: dividing by the one sample at lambda_n instead would hand its noise to the slope.
For a given p the model is linear in a and a m, so only p is searched (variable projection; Golub & Pereyra
1973, with Kaufman's 1975 step), for all spectra at once. That is the engine "fast"; "lmfit" is the library's
Levenberg-Marquardt in a, m and p from one start, spectrum by spectrum as in the paper, to hold it against.
"""

from typing import NamedTuple

import numpy as np

from analysis.choices import Engine
from analysis.errors import FitError
from analysis.fits.local_lmfit import fit_each
from analysis.fits.local_misfit import doubts_of_metal, local_misfit
from analysis.fits.propagation import variance_of_each_point
from analysis.reflectance.fresnel import Conductor, load_conductor
from analysis.reflectance.models import LAMBDA_N, normalised_fresnel, shift
from analysis.results import LocalFit
from drivers.arrays import BoolArray, FloatArray
from goniometer.datasets.dataset import Dataset

EXPONENT_BOUNDS = (-5.0, 15.0)
"""Between which p is searched."""

LEAST_WAVELENGTHS = 5
"""Valid wavelengths that a spectrum must have: three parameters and something left to judge them by."""

_STARTS = np.linspace(*EXPONENT_BOUNDS, 9)
_ITERATIONS = 80
_TOLERANCE = 1e-8
_ROUGHLY = 1e-4
_AT_ONCE = 100

_LEAST_LEFT = 1e-13
"""A column that the others replace but for this share says nothing of its parameter in double precision."""

_ROUNDING = 1e-13
"""Share of a sum that may be lost in rounding."""


class _Spectra(NamedTuple):
    """What the fit reads; wavelengths last."""

    weight: FloatArray
    """[points, wavelengths] one over the squared standard uncertainty from the counts; 0 where there is no value."""
    weighted: FloatArray
    """[points, wavelengths] BRDF, 1/sr, times weight."""
    log_fresnel: FloatArray
    """[points, wavelengths] logarithm of F / F(lambda_n) at the incident angle."""
    x: FloatArray
    """[wavelengths] distance to lambda_n, um."""

    def take(self, points: BoolArray | slice) -> "_Spectra":
        if not isinstance(points, slice) and points.all():
            return self
        return _Spectra(self.weight[points], self.weighted[points], self.log_fresnel[points], self.x)

    def binned(self, count: int) -> "_Spectra":
        """The same averaged over neighbours to about `count` wavelengths: a good estimate costs little there."""
        edges = np.arange(0, self.x.size, max(1, self.x.size // count))
        members = np.diff(np.append(edges, self.x.size))
        weight, weighted, log_fresnel = (np.add.reduceat(part, edges, axis=1) for part in self[:3])
        return _Spectra(weight, weighted, log_fresnel / members, np.add.reduceat(self.x, edges) / members)


class _Normal(NamedTuple):
    """Normal equations of a, a m and p at given exponents, where a and a m are the best ones; each [..., points].

    The columns are the weighted derivatives of the model: F_n^p, x F_n^p and (a + a m x) ln(F_n) F_n^p.
    """

    scale: FloatArray
    """a, 1/sr."""
    tilt: FloatArray
    """a m, 1/(sr um)."""
    aa: FloatArray
    """Product of the first column with itself; the next two likewise."""
    ab: FloatArray
    bb: FloatArray
    size: FloatArray
    """Product of the third column with itself."""
    along: FloatArray
    """How much of the first column"""
    across: FloatArray
    """and of the second best replaces the third,"""
    left: FloatArray
    """and the squared length of what they leave of it."""
    gradient: FloatArray
    """Product of the third column with the residual, measured minus model."""
    explained: FloatArray
    """Squared length of the model, by which the sum of squares falls."""

    @property
    def slope(self) -> FloatArray:
        """[points] m, 1/um; NaN where the scale is zero."""
        return _ratio(self.tilt, self.scale)


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
    from all errors of the measurement by the delta method, those that wavelengths share included, and from what Eq. 2
    does not describe of the spectrum (`analysis.fits.misfit`). A spectrum with
    fewer than five valid wavelengths gets NaN. Unreliable are points that are not usable (`dataset.usable`), those
    whose median signal is below its noise, and those whose exponent stopped at a bound (-5, 15) or did not settle.
    Both engines find the same: slopes agree to 1e-7 of 1/um where the spectrum determines them.
    Raises `OutOfRange` for wavelengths that the conductor does not cover, `FitError` if no spectrum is valid.
    """
    metal = (conductor or load_conductor()) if fresnel else None
    spectra = _spectra(dataset, metal, lambda_n)
    enough = np.count_nonzero(spectra.weight, axis=1) >= LEAST_WAVELENGTHS
    if not enough.any():
        raise FitError(
            f"No spectrum of {dataset.sample} has {LEAST_WAVELENGTHS} wavelengths with a value and an uncertainty "
            "from its counts above zero; check the calibration."
        )
    spectra = spectra.take(enough)
    by_lmfit = fresnel and engine == "lmfit"
    if by_lmfit:
        scale, slope, exponent, settled = fit_each(
            spectra.weight, spectra.weighted, spectra.log_fresnel, spectra.x, EXPONENT_BOUNDS
        )
    elif fresnel:
        exponent, settled = _search_exponent(spectra)
    else:
        exponent, settled = np.zeros(int(enough.sum())), np.ones(int(enough.sum()), dtype=bool)
    power = _power(spectra, exponent)
    normal = _normal(spectra, power)
    if by_lmfit:
        normal = normal._replace(scale=scale, tilt=scale * slope)
    fitted = _line(normal.scale, normal.tilt, spectra.x)
    fitted *= power
    gain = np.zeros(dataset.brdf.shape)
    gain[enough] = _gain_of_slope(spectra, power, normal, fresnel)
    u_slope = np.sqrt(variance_of_each_point(gain, dataset.sources))
    u_exponent = np.zeros(enough.size)
    if fresnel:
        gain[enough] = _gain(spectra, power, _exponent_gain(normal))
        u_exponent = np.sqrt(variance_of_each_point(gain, dataset.sources))

    low, high = EXPONENT_BOUNDS
    reliable = (
        settled
        & _above_noise(spectra, fitted)
        & (exponent > low)
        & (exponent < high)
        & np.isfinite(u_slope[enough])
        & dataset.usable[enough]
    )

    def at_all_points(values: FloatArray) -> FloatArray:
        result = np.full((enough.size, *values.shape[1:]), np.nan)
        result[enough] = values
        return result

    everywhere = np.zeros(enough.size, dtype=bool)
    everywhere[enough] = reliable
    r2 = at_all_points(_r2(dataset.brdf[enough], spectra.weight > 0, fitted))
    fitted = at_all_points(fitted)
    a, m, p = (at_all_points(values) for values in (normal.scale, normal.slope, exponent))
    misfit = local_misfit(dataset, fitted, (a, m, p), metal, lambda_n)
    return LocalFit(
        slope=m,
        u_slope=np.where(enough, np.hypot(u_slope, misfit[0]), np.nan),
        exponent=p,
        u_exponent=np.where(enough, np.hypot(u_exponent, misfit[1]), np.nan),
        scale=a,
        r2=r2,
        reliable=everywhere,
        fitted=fitted,
        lambda_n=lambda_n,
        misfit=misfit,
        doubts=doubts_of_metal(metal, p[everywhere], u_exponent[everywhere]),
        fresnel=fresnel,
    )


def local_exponents(dataset: Dataset, conductor: Conductor | None = None, lambda_n: float = LAMBDA_N) -> FloatArray:
    """[points] the exponents p of `local_fit` alone, without all that is made of them.

    Raises `OutOfRange` beyond the conductor's table.
    """
    return _search_exponent(_spectra(dataset, conductor or load_conductor(), lambda_n))[0]


def local_gain(dataset: Dataset, local: LocalFit, conductor: Conductor | None) -> FloatArray:
    """[2, points, wavelengths] derivative of slope (1/um) and exponent by each BRDF value, at the fit's solution.

    `conductor` is that of the fit, None for one without Fresnel term; `OutOfRange` is raised beyond its table. Zero
    where a value was not used, and at points that are not reliable. This is what passes errors that points share on to
    whatever is made of the slopes.
    """
    used = local.reliable
    spectra = _spectra(dataset, conductor, local.lambda_n).take(used)
    gain = np.zeros((2, *dataset.brdf.shape))
    power = _power(spectra, local.exponent[used])
    normal = _normal(spectra, power)
    gain[0, used] = _gain_of_slope(spectra, power, normal, local.fresnel)
    if local.fresnel:
        gain[1, used] = _gain(spectra, power, _exponent_gain(normal))
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

    Without a `conductor` F_n is one; beyond the table of one `OutOfRange` is raised. Unlike a local fit it is a model
    to be evaluated, so a negative shift is clamped at zero.
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
    weight = np.square(u)
    with np.errstate(divide="ignore", invalid="ignore"):
        np.divide(1, weight, out=weight)
        weighted = weight * dataset.brdf
    # a NaN of either has become one here; a zero uncertainty is an infinite weight, an infinite one a weight of zero
    invalid = ~np.isfinite(weighted)
    weight[invalid], weighted[invalid] = 0.0, 0.0
    return _Spectra(weight, weighted, log_fresnel, (dataset.wavelengths - lambda_n) * 1e-3)


def _ratio(numerator: FloatArray, denominator: FloatArray) -> FloatArray:
    """Element-wise ratio, NaN where the denominator is zero."""
    return np.asarray(np.divide(numerator, denominator, out=np.full_like(numerator, np.nan), where=denominator != 0))


def _line(level: FloatArray, rise: FloatArray, x: FloatArray) -> FloatArray:
    """[points, wavelengths] level + rise x."""
    return np.asarray(np.stack([level, rise], axis=1) @ np.stack([np.ones_like(x), x]))


def _power(spectra: _Spectra, exponent: FloatArray) -> FloatArray:
    """[..., points, wavelengths] F_n^p for `exponent` [..., points]."""
    power = exponent[..., None] * spectra.log_fresnel
    return np.asarray(np.exp(power, out=power))


def _normal(spectra: _Spectra, power: FloatArray) -> _Normal:
    """The normal equations where F_n^p is `power`.

    All are sums over wavelengths of weight F_n^2p ln(F_n)^j x^i and of weighted value F_n^p ln(F_n)^j x^i. What is lost
    in rounding is an exponent of about 1e-13, since the third column is a small part of the spectrum.
    """
    powers = np.stack([np.ones_like(spectra.x), spectra.x, spectra.x**2], axis=1)
    part = spectra.weighted * power
    y_0, y_1 = np.moveaxis(part @ powers[:, :2], -1, 0)
    part *= spectra.log_fresnel
    y_l0, y_l1 = np.moveaxis(part @ powers[:, :2], -1, 0)
    np.multiply(power, power, out=part)
    part *= spectra.weight
    aa, ab, bb = np.moveaxis(part @ powers, -1, 0)
    part *= spectra.log_fresnel
    l_0, l_1, l_2 = np.moveaxis(part @ powers, -1, 0)
    part *= spectra.log_fresnel
    ll_0, ll_1, ll_2 = np.moveaxis(part @ powers, -1, 0)

    determinant = aa * bb - ab**2
    scale, tilt = (bb * y_0 - ab * y_1) / determinant, (aa * y_1 - ab * y_0) / determinant
    with_first, with_second = scale * l_0 + tilt * l_1, scale * l_1 + tilt * l_2
    size = scale**2 * ll_0 + 2 * scale * tilt * ll_1 + tilt**2 * ll_2
    along = (bb * with_first - ab * with_second) / determinant
    across = (aa * with_second - ab * with_first) / determinant
    return _Normal(
        scale=scale,
        tilt=tilt,
        aa=aa,
        ab=ab,
        bb=bb,
        size=size,
        along=along,
        across=across,
        left=size - along * with_first - across * with_second,
        gradient=scale * (y_l0 - with_first) + tilt * (y_l1 - with_second),
        explained=scale * y_0 + tilt * y_1,
    )


def _exponent_gain(normal: _Normal) -> FloatArray:
    """[4, points] derivative of the exponent by the data as `_gain` takes it; NaN where they do not determine it."""
    determined = (1 - normal.ab**2 / (normal.aa * normal.bb)) * normal.left > _LEAST_LEFT * normal.size
    left = np.where(determined, normal.left, np.nan)
    return np.stack([-normal.along, -normal.across, normal.scale, normal.tilt]) / left


def _gain_of_slope(spectra: _Spectra, power: FloatArray, normal: _Normal, fresnel: bool) -> FloatArray:
    """[points, wavelengths] derivative of the slope by the data; without `fresnel` the exponent is held."""
    slope, nothing = normal.slope, np.zeros_like(normal.aa)
    determinant = normal.aa * normal.bb - normal.ab**2
    of_line = np.stack([-normal.ab - slope * normal.bb, normal.aa + slope * normal.ab, nothing, nothing]) / determinant
    if fresnel:
        of_line = of_line - (normal.across - slope * normal.along) * _exponent_gain(normal)
    return _gain(spectra, power, _ratio(of_line, np.broadcast_to(normal.scale, of_line.shape)))


def _gain(spectra: _Spectra, power: FloatArray, parts: FloatArray) -> FloatArray:
    """[points, wavelengths] weight F_n^p (k_0 + k_1 x + (k_2 + k_3 x) ln F_n) for `parts` k [4, points]."""
    gain = _line(parts[2], parts[3], spectra.x)
    gain *= spectra.log_fresnel
    gain += _line(parts[0], parts[1], spectra.x)
    gain *= power
    gain *= spectra.weight
    return gain


def _search_exponent(spectra: _Spectra) -> tuple[FloatArray, BoolArray]:
    """[points] best exponents within the bounds, and whether the search settled.

    On binned spectra from the best of nine exponents, so that a second minimum does not catch it, and from there on all
    wavelengths, a few spectra at a time, so that they stay in the processor's cache.
    """
    points = spectra.weight.shape[0]
    binned = spectra.binned(50)
    coarse = binned.binned(16)
    explained = _normal(coarse, _power(coarse, np.repeat(_STARTS[:, None], points, axis=1))).explained
    exponent, settled = _descend(binned, _STARTS[np.argmax(explained, axis=0)], _ROUGHLY)
    for first in range(0, points, _AT_ONCE):
        block = slice(first, first + _AT_ONCE)
        exponent[block], settled[block] = _descend(spectra.take(block), exponent[block], _TOLERANCE)
    return exponent, settled


def _descend(spectra: _Spectra, exponent: FloatArray, tolerance: float) -> tuple[FloatArray, BoolArray]:
    """Gauss-Newton steps from `exponent`, halved wherever they do not lower the cost; and whether they settled."""
    exponent = exponent.copy()
    settled = np.zeros(exponent.size, dtype=bool)
    explained, wanted = _profile(spectra, exponent)
    before = np.full(exponent.size, np.nan)
    for _ in range(_ITERATIONS):
        here = exponent[~settled]
        step = np.clip(here + wanted, *EXPONENT_BOUNDS) - here
        exponent[~settled] = here + step
        # steps shrink by about the same factor each time, so the next one is known before it is made
        going = np.abs(step) * np.fmin(np.abs(step / before), 1.0) >= tolerance
        if going.any():
            trial = _profile(spectra, here + step)
            # less than this is lost in rounding, so that such a step is taken as it is
            while np.any(worse := trial[0] < explained * (1 - _ROUNDING)):
                step = np.where(worse, 0.5 * step, step)
                trial = _profile(spectra, here + step)
            exponent[~settled] = here + step
            explained, wanted, before = trial[0][going], trial[1][going], step[going]
            spectra = spectra.take(going)
        settled[~settled] = ~going
        if settled.all():
            break
    return exponent, settled


def _profile(spectra: _Spectra, exponent: FloatArray) -> tuple[FloatArray, FloatArray]:
    """[points] what the best linear parameters explain for given exponents, and Kaufman's Gauss-Newton step of these.

    The residual has no part along the two linear columns, so the step is its part along what these leave of the third.
    """
    normal = _normal(spectra, _power(spectra, exponent))
    solvable = normal.left > _LEAST_LEFT * normal.size
    step = np.where(solvable, normal.gradient / np.where(solvable, normal.left, 1.0), 0.0)
    return normal.explained, np.nan_to_num(step)


def _above_noise(spectra: _Spectra, fitted: FloatArray) -> BoolArray:
    """[points] whether at least half of the fitted values are as large as their noise."""
    above = np.count_nonzero((fitted > 0) & (fitted**2 * spectra.weight >= 1), axis=1)
    return np.asarray(2 * above >= np.count_nonzero(spectra.weight, axis=1))


def _r2(values: FloatArray, valid: BoolArray, fitted: FloatArray) -> FloatArray:
    """[points] coefficient of determination over the valid wavelengths, unweighted; NaN for a constant spectrum."""
    values = values if valid.all() else np.where(valid, values, 0.0)
    around = values - (values.sum(axis=1) / np.count_nonzero(valid, axis=1))[:, None]
    around *= valid
    left = values - fitted
    left *= valid
    return 1 - _ratio(np.vecdot(left, left), np.vecdot(around, around))
