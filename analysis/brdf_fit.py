"""Cook-Torrance, and Cook-Torrance times the shift, fitted to a whole dataset (section 6.2.1 of the paper).

The cost is that of Löw et al. 2012: sum of [ln(1 + cos(theta_in) f_model) - ln(1 + cos(theta_in) f_measured)]^2
over points and wavelengths, without a sin(theta_in) weight, minimised by lmfit's Levenberg-Marquardt. The model
is read through the instrument's aperture (`analysis.models.measured_cook_torrance`), else a narrow lobe would come
out too rough. Levenberg-Marquardt alone misses narrow lobes, so it starts from the best of a scan over alpha and w.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from analysis.directions import Aperture, Directions, in_plane, round_aperture, through_aperture
from analysis.errors import FitError
from analysis.fresnel import Conductor, fresnel_conductor, load_conductor
from analysis.identify import LARGEST_RESIDUAL_RATIO, Evidence, judge, lobe_width
from analysis.models import LAMBDA_N, cosine_slope, measured_cook_torrance, microfacet, shift_is_clamped, theta_m
from analysis.noise import flag_sentences
from analysis.propagation import correlation, covariance_by_part, errors_by_part, errors_of_data
from analysis.results import ModelFit, Parameter
from drivers.arrays import BoolArray, FloatArray
from goniometer.angular import SAME_INCIDENCE, incidence_groups
from goniometer.dataset import Dataset
from goniometer.uncertainty import ErrorSource, combined, everywhere

DARKEST = -0.99
"""Where cos(theta_in) f of a noisy measurement is cut off, so that ln(1 + cos(theta_in) f) exists."""

LEAST_POINTS = 5
"""Points that a fit must have."""

_ALPHAS = np.geomspace(0.002, 1.0, 32)
_WS = np.arange(0.5, 10.01, 0.5)
_SCAN_WAVELENGTHS = 8
_LARGEST_W = 12.0
_EVALUATIONS = 500
_STEP = 1e-4
_NAMES = ("alpha", "h", "w")
_UNITS = ("1", "1/um", "1")


@dataclass(frozen=True)
class _View:
    """All that the model needs to know of the directions, computed once for many parameters."""

    cos_in: FloatArray
    """[points, 1]"""
    directions: Directions
    """[points, nodes] through the aperture."""
    theta_m: FloatArray
    """[points, nodes] degrees."""
    aperture: Aperture
    fresnel: FloatArray
    """[points, wavelengths] at the centre of the aperture."""
    wavelengths: FloatArray
    """[wavelengths] nm."""

    def log_model(self, alpha: float, h: float, w: float) -> FloatArray:
        """[points, wavelengths] ln(1 + cos(theta_in) f), f as `measured_cook_torrance`."""
        slope = cosine_slope(self.theta_m, h, w) if h != 0 else None
        brdf = microfacet(self.directions, self.wavelengths, alpha, self.fresnel, slope, weights=self.aperture.weights)
        return np.asarray(np.log1p(self.cos_in * brdf))


@dataclass(frozen=True)
class _Data:
    """The measurement as the cost sees it, without the points that are not usable."""

    dataset: Dataset
    points: BoolArray
    """[all points] which are fitted; everything below has only these."""
    theta_in: FloatArray
    theta_out: FloatArray
    log_measured: FloatArray
    """[points, wavelengths] 0 where there is no value."""
    root_weight: FloatArray
    """[points, wavelengths] 0 where there is no value."""
    log_derivative: FloatArray
    """[points, wavelengths] of ln(1 + cos(theta_in) f) by f: turns an uncertainty of f into one of the residual."""
    conductor: Conductor
    n: FloatArray
    k: FloatArray

    def view(
        self, theta_in: FloatArray, theta_out: FloatArray, aperture: Aperture, wavelengths: slice = slice(None)
    ) -> _View:
        """The directions at some wavelengths, or slightly different directions, to differentiate by angle."""
        directions = through_aperture(theta_in, theta_out, aperture)
        centre = in_plane(theta_in, theta_out)
        return _View(
            cos_in=np.cos(np.radians(theta_in))[:, None],
            directions=directions,
            theta_m=theta_m(directions),
            aperture=aperture,
            fresnel=fresnel_conductor(centre.cos_d[:, None], self.n[wavelengths], self.k[wavelengths]),
            wavelengths=self.dataset.wavelengths[wavelengths],
        )


def cook_torrance_fit(dataset: Dataset, conductor: Conductor | None = None, weighted: bool = False) -> ModelFit:
    """Fit alpha of Cook-Torrance (Eq. 6); `conductor` is aluminium unless given.

    With `weighted` every residual is divided by its standard uncertainty from the counts (`dataset.u_counts`); the
    result's `cost` says which. Points that are not usable (`dataset.usable`) are left out. The standard error passes
    all errors of the measurement through the estimator, each shared as it is shared, and is multiplied by the ratio
    of the residuals to their combined standard uncertainty where that is above two (Birge ratio); systematic errors
    leave residuals too, so they count in it. r2 is that of ln(1 + cos(theta_in) f). Raises `OutOfRange` for
    wavelengths beyond the conductor's table and `FitError` if fewer than five points are left or the optimiser gives
    up.
    """
    data = _data(dataset, conductor or load_conductor(), weighted)
    start = _scan(data, False)
    view = data.view(data.theta_in, data.theta_out, _aperture(dataset, start[0]))
    parameters, cost = _minimise(data, view, start, free=1)
    return _result("cook-torrance", data, view, parameters, cost, 1, weighted, shift_determined=None)


def shift_fit(dataset: Dataset, conductor: Conductor | None = None, weighted: bool = False) -> ModelFit:
    """Fit alpha, h and w of Cook-Torrance times the shift (Eq. 7); arguments and errors as `cook_torrance_fit`.

    Where the data do not determine w, because h or w is within three standard errors of zero or w ran to 12,
    w is fixed at 0, which makes the slope the constant h; its standard error is then infinite, its correlations
    are zero, and the verdict says so.
    """
    data = _data(dataset, conductor or load_conductor(), weighted)
    start = _scan(data, True)
    view = data.view(data.theta_in, data.theta_out, _aperture(dataset, start[0]))
    # the grid of alpha is too coarse for a narrow lobe to tell w, so w is scanned again at the best alpha; with w
    # held the fit is always well posed, and whether w can be let go is seen from there
    parameters, _ = _minimise(data, view, start, free=2)
    parameters, cost = _minimise(data, view, _scan(data, True, np.array(parameters[:1])), free=2)
    determined = _shift_is_determined(data, view, parameters)
    if determined:
        parameters, cost = _minimise(data, view, parameters, free=3)
        determined = _shift_is_determined(data, view, parameters)
    if not determined:
        parameters, cost = _minimise(data, view, (parameters[0], parameters[1], 0.0), free=2)
    free = 3 if determined else 2
    return _result("cook-torrance-shift", data, view, parameters, cost, free, weighted, shift_determined=determined)


def _shift_is_determined(data: _Data, view: _View, parameters: tuple[float, float, float]) -> bool:
    """Whether both h and w are more than three standard errors from zero, and w is within its bound."""
    sigma = np.sqrt(np.diag(sum(_covariances(data, view, parameters, 3).values())))
    return bool(abs(parameters[1]) > 3 * sigma[1] and 3 * sigma[2] < parameters[2] < 0.999 * _LARGEST_W)


def _data(dataset: Dataset, conductor: Conductor, weighted: bool) -> _Data:
    n, k = conductor.index(dataset.wavelengths)
    valid = np.isfinite(dataset.brdf) & np.isfinite(dataset.u_counts) & (dataset.u_counts > 0)
    points = valid.any(axis=1) & dataset.usable
    if points.sum() < LEAST_POINTS:
        raise FitError(
            f"Only {points.sum()} of {points.size} points of {dataset.sample} have values and uncertainties and are "
            f"usable; a fit needs at least {LEAST_POINTS}. {' '.join(flag_sentences(dataset))}".rstrip()
        )
    valid, theta_in = valid[points], dataset.theta_in[points]
    cos_in = np.cos(np.radians(theta_in))[:, None]
    seen = np.maximum(cos_in * np.where(valid, dataset.brdf[points], 0.0), DARKEST)
    log_derivative = cos_in / (1 + seen)
    weight = valid.astype(float)
    if weighted:
        weight[valid] = 1 / (log_derivative * dataset.u_counts[points])[valid]
    return _Data(
        dataset=dataset,
        points=points,
        theta_in=theta_in,
        theta_out=dataset.theta_out[points],
        log_measured=np.log1p(seen),
        root_weight=weight,
        log_derivative=log_derivative,
        conductor=conductor,
        n=n,
        k=k,
    )


def _aperture(dataset: Dataset, alpha: float) -> Aperture:
    """A rule as fine as the lobe needs.

    At grazing incidence a lobe is narrower sideways by cos(theta_in). At 80 degrees and through 1 degree the default
    rule errs by 15 % for alpha = 0.0045, by 3e-4 for 0.02 and by 6e-8 for 0.05; the fine one by 1e-4 at worst.
    """
    if lobe_width(alpha) < 6 * dataset.aperture:
        return round_aperture(dataset.aperture, rings=16, spokes=40)
    return round_aperture(dataset.aperture)


def _scan(data: _Data, with_shift: bool, alphas: FloatArray = _ALPHAS) -> tuple[float, float, float]:
    """alpha, h and w of the lowest cost on a grid of `alphas` and w, at a few wavelengths.

    h is solved for at each node, with the logarithm made linear at the measurement.
    """
    step = max(1, data.n.size // _SCAN_WAVELENGTHS)
    some = slice(step // 2, None, step)
    view = data.view(data.theta_in, data.theta_out, round_aperture(data.dataset.aperture), some)
    log_measured, weight = data.log_measured[:, some], data.root_weight[:, some]
    residual_weight = weight * np.exp(-log_measured)
    x = (view.wavelengths - LAMBDA_N) * 1e-3
    centre = np.radians(0.5 * np.abs(data.theta_out - data.theta_in))
    cosines = np.cos(_WS[:, None] * centre) if with_shift else np.zeros((1, centre.size))

    best, lowest = (float(alphas[0]), 0.0, 0.0), math.inf
    for alpha in alphas:
        plain = np.expm1(view.log_model(alpha, 0.0, 0.0))
        missing = residual_weight * (np.expm1(log_measured) - plain)
        tilted = residual_weight * plain * x
        size = cosines**2 @ np.sum(tilted**2, axis=-1)
        h = np.divide(cosines @ np.sum(tilted * missing, axis=-1), size, out=np.zeros_like(size), where=size > 0)
        model = np.log1p(plain * np.maximum(1 + (h[:, None] * cosines)[..., None] * x, 0.0))
        costs = np.sum((weight * (model - log_measured)) ** 2, axis=(1, 2))
        node = int(np.argmin(costs))
        if costs[node] < lowest:
            lowest = float(costs[node])
            best = (float(alpha), float(h[node]), float(_WS[node]) if with_shift else 0.0)
    return best


def _minimise(
    data: _Data, view: _View, start: tuple[float, float, float], free: int
) -> tuple[tuple[float, float, float], float]:
    """Best alpha, h, w and their cost; the first `free` of (log alpha, h, w) vary, w between 0 and 12."""
    import lmfit  # noqa: PLC0415  (takes most of a second)

    valid = data.root_weight > 0
    weight, measured = data.root_weight[valid], data.log_measured[valid]

    def residual(parameters: lmfit.Parameters) -> FloatArray:
        alpha, h, w = math.exp(parameters["log_alpha"].value), parameters["h"].value, parameters["w"].value
        return np.asarray(weight * (view.log_model(alpha, h, w)[valid] - measured))

    parameters = lmfit.Parameters()
    parameters.add("log_alpha", value=math.log(start[0]))
    parameters.add("h", value=start[1] if free == 1 or start[1] != 0 else 1e-3, vary=free >= 2)
    parameters.add("w", value=start[2], vary=free >= 3, min=0.0, max=_LARGEST_W)
    result = lmfit.minimize(residual, parameters, method="leastsq", calc_covar=False, max_nfev=_EVALUATIONS)
    # beyond the codes that lmfit calls success, MINPACK's 6 to 8 say that rounding stops any further descent
    if result.aborted or result.ier not in {1, 2, 3, 4, 6, 7, 8}:
        raise FitError(f"The fit to {data.dataset.sample} did not converge: {result.message}")
    best = result.params
    return (math.exp(best["log_alpha"].value), best["h"].value, best["w"].value), float(result.chisqr)


def _jacobian(view: _View, parameters: tuple[float, float, float], free: int) -> FloatArray:
    """[free, points, wavelengths] derivative of the log model by (log alpha, h, w), by central differences."""
    alpha, h, w = parameters
    steps = [(math.exp(_STEP), 0.0, 0.0), (1.0, _STEP, 0.0), (1.0, 0.0, _STEP)][:free]
    return np.stack(
        [
            (view.log_model(alpha * a, h + dh, w + dw) - view.log_model(alpha / a, h - dh, w - dw)) / (2 * _STEP)
            for a, dh, dw in steps
        ]
    )


def _errors(data: _Data, aperture: Aperture, parameters: tuple[float, float, float]) -> tuple[ErrorSource, ...]:
    """What one standard uncertainty of every source does to the residuals.

    The angles' part of the dataset is replaced by what the model says: it knows, through the aperture, how a lobe
    changes between two measured directions.
    """
    of_dataset = errors_of_data(data.dataset, data.points, data.log_derivative)
    return (
        *(source for source in of_dataset if source.part != "angle"),
        *_angle_errors(data, aperture, parameters),
    )


def _angle_errors(data: _Data, aperture: Aperture, parameters: tuple[float, float, float]) -> tuple[ErrorSource, ...]:
    """Errors of the stages' positions and zeros; each moves the true direction away from the stated one.

    The detector stage sets theta_in + theta_out: its error changes theta_out alone, while an error e of the sample
    stage changes theta_in by e, and with it the irradiance, and theta_out by -e. When the reference panel stood at
    this theta_in the stage had another error; of it only the irradiance matters, as the panel is nearly Lambertian.
    A zero's error is the same for the panel and the sample, so the irradiance cancels in their ratio.
    """
    dataset = data.dataset
    step = max(1e-3 * dataset.aperture, 1e-5)
    incidence = incidence_groups(data.theta_in, SAME_INCIDENCE)
    # a dataset knows how often the stage came back to an incident angle; without that, once
    visits = {source.name: source.groups for source in dataset.sources}.get("angle: sample stage")
    visit = incidence if visits is None else visits[data.points]
    shared = everywhere(data.theta_in.size)
    view = data.view(data.theta_in, data.theta_out, aperture)

    def derivative(d_in: float, d_out: float) -> FloatArray:
        """Of the log model at the stated irradiance, per degree."""
        ahead = data.view(data.theta_in + d_in * step, data.theta_out + d_out * step, aperture)
        behind = data.view(data.theta_in - d_in * step, data.theta_out - d_out * step, aperture)
        ahead, behind = (replace(moved, cos_in=view.cos_in) for moved in (ahead, behind))
        return np.asarray((ahead.log_model(*parameters) - behind.log_model(*parameters)) / (2 * step))

    by_detector, by_sample = derivative(0.0, 1.0), derivative(1.0, -1.0)
    # d ln(1 + x) = x / (1 + x) dx / x; the relative error of the irradiance is -tan(theta_in) times that of the angle
    share = -np.expm1(-view.log_model(*parameters))
    irradiance = -share * np.tan(np.radians(data.theta_in))[:, None] * np.pi / 180
    return tuple(
        ErrorSource(f"angle: {name}", "angle", size * effect, groups, shared_by_wavelengths=True)
        for name, effect, groups, size in (
            ("detector stage", by_detector, None, dataset.u_angle),
            ("sample stage", by_sample + irradiance, visit, dataset.u_angle),
            ("sample stage at the reference", irradiance, incidence, dataset.u_angle),
            ("detector zero", by_detector, shared, dataset.u_zero),
            ("sample zero", by_sample, shared, dataset.u_zero),
        )
    )


def _covariances(data: _Data, view: _View, parameters: tuple[float, float, float], free: int) -> dict[str, FloatArray]:
    """[free, free] covariance of (alpha, h, w) by part of the budget; infinite for what is undetermined."""
    weighted = _jacobian(view, parameters, free) * data.root_weight
    flat = weighted.reshape(free, -1)
    size = np.linalg.norm(flat, axis=1)
    normal = (flat / np.where(size > 0, size, 1.0)[:, None]) @ (flat / np.where(size > 0, size, 1.0)[:, None]).T
    if np.any(size == 0) or np.linalg.cond(normal) > 1e12:
        return {"random": np.full((free, free), math.inf)}
    gain = (np.linalg.solve(normal, flat / size[:, None]) / size[:, None]).reshape(weighted.shape) * data.root_weight
    gain[0] *= parameters[0]
    return covariance_by_part(gain, _errors(data, view.aperture, parameters))


def _result(
    model: str,
    data: _Data,
    view: _View,
    parameters: tuple[float, float, float],
    cost: float,
    free: int,
    weighted: bool,
    shift_determined: bool | None,
) -> ModelFit:
    dataset = data.dataset
    with_shift = shift_determined is not None
    by_part = _covariances(data, view, parameters, free)
    shown = 3 if with_shift else 1
    valid = data.root_weight > 0
    residual = (view.log_model(*parameters) - data.log_measured)[valid]
    errors = _errors(data, view.aperture, parameters)
    expected = combined(errors, valid.shape)[valid]
    around = data.log_measured[valid] - data.log_measured[valid].mean()
    residual_ratio = float(np.sqrt(np.mean((residual / expected) ** 2)))
    # residuals beyond the uncertainty are errors of the model; the parameters then stand for less than it says
    inflation = residual_ratio if residual_ratio > LARGEST_RESIDUAL_RATIO else 1.0
    covariance = np.diag(np.full(shown, math.inf))
    covariance[:free, :free] = inflation**2 * sum(by_part.values())
    sigma = np.sqrt(np.diag(covariance))
    alpha, h, w = parameters
    slope = cosine_slope(theta_m(in_plane(dataset.theta_in, dataset.theta_out)), h, w)
    shares = [errors_by_part(by_part, i, inflation) if i < free else {} for i in range(shown)]
    verdict = judge(
        Evidence(
            dataset=dataset,
            fitted=data.points,
            alpha=alpha,
            u_alpha=float(sigma[0]),
            u_alpha_from_angles=shares[0].get("angle", 0.0),
            residual_ratio=residual_ratio,
            scanned_alphas=(float(_ALPHAS[0]), float(_ALPHAS[-1])),
            h=h if with_shift else None,
            u_h=float(sigma[1]) if with_shift else math.inf,
            shift_determined=shift_determined is not False,
        )
    )
    return ModelFit(
        model=model,
        equation=(
            "f = shift F G D / (4 cos_i cos_o), m = h cos(w theta_m), Eq. 7"
            if with_shift
            else "f = F G D / (4 cos_i cos_o), Eq. 6"
        ),
        parameters=tuple(
            Parameter(_NAMES[i], parameters[i], float(sigma[i]), _UNITS[i], shares[i]) for i in range(shown)
        ),
        correlation=correlation(covariance),
        cost="loew, each residual divided by its standard uncertainty from the counts" if weighted else "loew",
        cost_value=cost,
        r2=float(1 - np.sum(residual**2) / np.sum(around**2)),
        verdict=verdict,
        fitted=measured_cook_torrance(
            dataset.theta_in, dataset.theta_out, dataset.wavelengths, alpha, data.conductor, view.aperture, h, w
        ),
        lambda_n=LAMBDA_N,
        theta_range=(
            float(data.theta_in.min()),
            float(data.theta_in.max()),
            float(data.theta_out.min()),
            float(data.theta_out.max()),
        ),
        wavelength_range=(float(dataset.wavelengths[0]), float(dataset.wavelengths[-1])),
        clamped_points=int(shift_is_clamped(slope, dataset.wavelengths).sum()),
    )
