"""One fit of one difficult measurement, held against the truth.

A run is a pure function of regime, level, method and seed. From the seed come the errors of the measurement and a
starting point from which an engine goes downhill by itself: whether it ends where the fit did, or lower, tells what a
start is worth, and whether the fit's own scan for one has missed a valley.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from analysis.choices import BRDF_MODELS
from analysis.errors import AnalysisError
from analysis.fits.brdf_fit import form_of
from analysis.fits.brdf_problem import problem, to_search
from analysis.fits.by_name import fit_models, local_fit_for
from analysis.fits.global_fit import slope_problem
from analysis.fits.least_squares import SumOfSquares, minimise
from analysis.fits.loew import MIRROR_LOBE, grazing_weighs_less, loew_data
from analysis.reflectance.directions import in_plane
from analysis.reflectance.distributions import lobe_width
from analysis.reflectance.fresnel import load_conductor
from analysis.reflectance.microfacet import Form, Quantity, aperture_for, view
from analysis.results import LocalFit, ModelFit
from simulators.choices import METHODS
from simulators.materials.specimens import Specimen, slopes
from simulators.stability.regimes import REGIMES, Case, case

WRONG = 5.0
"""Standard errors beyond which a fitted parameter is wrong."""

COVERAGE_FACTOR = 1.96
"""Of a 95 % interval of a normal distribution."""

REACHED = 1e-3
"""Relative difference of two costs below which they are of one minimum."""

_QUANTITIES = {
    quantity.name: quantity
    for quantity in (*Form(None, "two-component").quantities, Quantity("p", "1", -math.inf, math.inf, 0.3, 0.0))
}
"""What is known of every parameter."""


class Job(NamedTuple):
    """Which run."""

    regime: str
    level: str
    method: str
    seed: int


@dataclass(frozen=True)
class Estimate:
    """What a fit says of a parameter, and what is true."""

    value: float
    u: float
    """Stated standard error; infinite where the fit says that the data do not tell."""
    true: float


@dataclass(frozen=True)
class Run:
    """What one fit of one measurement came to."""

    job: Job
    right: float
    """Whether everything with a truth came out as near to it as is of use, 0 or 1; of a local fit the share of its
    reliable spectra. NaN where nothing has a truth, 0 where nothing was fitted."""
    trusted: bool
    """Whether the verdict is good; of a local fit, whether it has no doubts about all spectra together."""
    silent: bool
    """Whether it is wrong by more than five standard errors under a good verdict, or has not a word on a measurement
    that the model cannot describe."""
    z: dict[str, float]
    """(Fitted - true) / standard error of every parameter that a good verdict vouches for; of a local fit, of its worst
    reliable spectrum."""
    bias: dict[str, float]
    """Fitted - true of every parameter that has a truth; of a local fit the mean over its reliable spectra, 1/um."""
    covered: float
    """Share of the 95 % intervals that hold the truth; NaN where the verdict vouches for none."""
    start: str
    """Where the random start ended: "reached" the fit, "missed" it, or "lower"; empty where none was tried."""
    reasons: tuple[str, ...]
    """What the verdict says, or why nothing was fitted."""
    estimates: dict[str, Estimate]
    """Of every parameter that has a truth, whatever the verdict; of a local fit, of its worst reliable spectrum."""


def run(job: Job) -> Run:
    """Make the measurement of `job`, fit it, and compare."""
    regime, method = REGIMES[job.regime], METHODS[job.method]
    level = next(level for level in regime.levels if level.name == job.level)
    made = case(regime, level, method.model, job.seed)
    try:
        local = local_fit_for(made.dataset, (method.model,), engine=method.engine)
        if method.model == "local":
            return _of_spectra(job, made, local)
        (fit,) = fit_models(made.dataset, local, (method.model,), engine=method.engine)
    except AnalysisError as error:
        nothing: dict[str, float] = {}
        return Run(job, 0.0, False, False, nothing, nothing, math.nan, "", (str(error),), {})
    return _of_model(job, made, local, fit)


def _of_spectra(job: Job, made: Case, local: LocalFit) -> Run:
    assert isinstance(made.specimen, Specimen)  # as every regime of the local fit has one
    used = local.reliable
    truth = slopes(made.specimen, made.dataset.theta_in, made.dataset.theta_out)[used]
    off = local.slope[used] - truth
    z = off / local.u_slope[used]
    trusted = bool(used.any()) and not local.doubts
    useful = _QUANTITIES["h"].known_to + _QUANTITIES["h"].known_to_share * np.abs(truth)
    estimates, worst = {}, 0.0
    if used.any():
        place = int(np.argmax(np.abs(z)))
        worst = float(z[place])
        of_worst = local.slope[used][place], local.u_slope[used][place], truth[place]
        estimates["slope"] = Estimate(*map(float, of_worst))
    return Run(
        job,
        right=float(np.mean(np.abs(off) <= useful)) if used.any() else 0.0,
        trusted=trusted,
        silent=trusted and abs(worst) > WRONG,
        z={"slope": worst} if trusted else {},
        bias={"slope": float(off.mean())} if used.any() else {},
        covered=float(np.mean(np.abs(z) <= COVERAGE_FACTOR)) if trusted else math.nan,
        start="",
        reasons=local.doubts,
        estimates=estimates,
    )


def _of_model(job: Job, made: Case, local: LocalFit, fit: ModelFit) -> Run:
    verdict = fit.verdict
    known = [parameter for parameter in fit.parameters if parameter.name in made.truth]
    bias = {parameter.name: parameter.value - made.truth[parameter.name] for parameter in known}
    near = [abs(off) <= _QUANTITIES[name].useful(made.truth[name]) for name, off in bias.items()]
    z = {
        parameter.name: bias[parameter.name] / parameter.standard_error
        for parameter in known
        if verdict.trusted and parameter.name not in verdict.undetermined
    }
    wrong = any(not abs(each) <= WRONG for each in z.values())
    wordless = made.undescribed and not verdict.reasons
    return Run(
        job,
        right=float(all(near)) if near else math.nan,
        trusted=verdict.trusted,
        silent=verdict.trusted and (wrong or wordless),
        z=z,
        bias=bias,
        covered=float(np.mean([abs(each) <= COVERAGE_FACTOR for each in z.values()])) if z else math.nan,
        start=_random_start(job, made, local, fit),
        reasons=verdict.reasons,
        estimates={p.name: Estimate(p.value, p.standard_error, made.truth[p.name]) for p in known},
    )


def _random_start(job: Job, made: Case, local: LocalFit, fit: ModelFit) -> str:
    """Where going downhill from a random start ends; nothing where the fit minimises more than one sum."""
    random = np.random.default_rng([job.seed, 2])
    names = [parameter.name for parameter in fit.parameters if parameter.name != "p"]
    # with w held at 0, or with the slopes of the spectra beside the cost, the fit was to another minimum
    if fit.model == "two-component" or not all(math.isfinite(p.standard_error) for p in fit.parameters):
        return ""
    start = np.array([random.uniform(*_RANGES[name]) for name in names])
    if fit.model in BRDF_MODELS:
        start[0] = 0.01 ** random.uniform(0, 1)
        posed, start = _posed(made, fit), to_search(start)
    else:
        used = local.reliable
        seen = in_plane(made.dataset.theta_in[used], made.dataset.theta_out[used])
        posed = slope_problem(fit.model, local.slope[used], local.u_slope[used] ** -2, seen)
    cost = minimise(posed, start, np.ones(start.size, dtype=bool), METHODS[job.method].engine).cost
    if cost < (1 - REACHED) * fit.cost_value:
        return "lower"
    return "reached" if cost <= (1 + REACHED) * fit.cost_value else "missed"


_RANGES: dict[str, tuple[float, float]] = {
    "alpha": (0.01, 1.0),
    "eta": (1.1, 2.5),
    "h": (-3.0, 3.0),
    "w": (0.1, 12.0),
    "t_y": (-2.0, 2.0),
    "kappa": (0.0, 1.5),
    "sharpness": (0.0, 10.0),
    "threshold": (-1.0, 1.0),
}
"""Between which a random start lies, alpha by its logarithm."""


def _posed(made: Case, fit: ModelFit) -> SumOfSquares:
    """The cost that a microfacet model was fitted with."""
    alpha = fit.value("alpha")
    data = loew_data(made.dataset)
    if lobe_width(alpha) < MIRROR_LOBE:
        data = grazing_weighs_less(data)
    form = form_of(fit.model, None if fit.albedo is not None else load_conductor(), "ggx")
    rule = aperture_for(alpha, made.dataset.aperture)
    seen = view(form, data.theta_in, data.theta_out, made.dataset.wavelengths, rule)
    return problem(seen, data)
