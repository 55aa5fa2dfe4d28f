"""What fits cost and how right they are: engines and derivatives, and how many wavelengths they need."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.choices import Engine
from analysis.colour import colour_differences, has_colour
from analysis.fits.brdf_fit import brdf_fit
from analysis.fits.brdf_problem import from_search, problem, to_search
from analysis.fits.brdf_start import find_starts
from analysis.fits.least_squares import SumOfSquares, minimise
from analysis.fits.local_fit import LEAST_WAVELENGTHS, local_fit
from analysis.fits.loew import loew_data
from analysis.reflectance.fresnel import Conductor
from analysis.reflectance.microfacet import Form, aperture_for, view
from analysis.reflectance.models import LAMBDA_N
from analysis.results import LocalFit
from analysis.tradeoff import Axis, Candidate, Chart, Use, race
from drivers.arrays import FloatArray
from goniometer.datasets.dataset import Dataset

COUNTS = (LEAST_WAVELENGTHS, 8, 16, 41, 101, 201)
"""Numbers of wavelengths that are tried besides all of them."""

COMPARED = (41,)
"""Those of them at which lmfit is tried, too."""

MOST = 401
"""More wavelengths than that are thinned out first."""

ALONE = 24
"""Spectra that are fitted one by one; the time for all follows in proportion."""

_USUAL = (0.3, 0.5, 2.0)
"""alpha, h in 1/um and w from which somebody would start who does not look for one."""

Tell = Callable[[str], None]
IndexArray = NDArray[np.intp]


@dataclass(frozen=True)
class Known:
    """What is right, where somebody knows: on the simulated bench."""

    parameters: FloatArray
    """alpha, h in 1/um, w."""
    brdf: FloatArray
    """[points, wavelengths] of the dataset, 1/sr."""
    slopes: FloatArray
    """[points] of the spectra, 1/um."""


def fit_charts(
    datasets: Sequence[Dataset], conductor: Conductor, known: Known | None, rounds: int, tell: Tell
) -> list[Chart]:
    """Cook-Torrance with shift and the local fit: time against error.

    `datasets` are measurements of one sample that differ by their noise, by turns for each round, or a single one.
    Without `known`, errors are those against the fit to all wavelengths together with its own standard errors, and
    colours are compared with the measurement. Raises `FitError` and `OutOfRange` as the fits do.
    """
    chosen = _spread(datasets[0].wavelengths.size, MOST)
    whole = [dataset.at_wavelengths(chosen) for dataset in datasets]
    if known is not None:
        known = replace(known, brdf=known.brdf[:, chosen])
    counts = [count for count in COUNTS if count < chosen.size]
    charts = _model_charts(whole, conductor, counts, known, rounds, tell)
    return [*charts, _local_chart(whole, conductor, counts, known, rounds, tell)]


def _model_charts(
    draws: list[Dataset], conductor: Conductor, counts: list[int], known: Known | None, rounds: int, tell: Tell
) -> list[Chart]:
    whole = draws[0]
    all_of_them = whole.wavelengths.size
    some = [count for count in COMPARED if count < all_of_them]
    candidates = [
        *_candidates(
            "scans for the start, then own derivatives",
            "fast engine",
            counts,
            draws,
            _fast,
            conductor,
            use=_use("cook-torrance-shift", "fast"),
        ),
        *(
            candidate
            for words, more, analytic in (("its numeric", "", False), ("our", ", analytic", True))
            for candidate in _candidates(
                f"scans for the start, then lmfit with {words} derivatives",
                "lmfit",
                some,
                draws,
                _by_lmfit,
                conductor,
                analytic,
                more=more,
                use=None if analytic else _use("cook-torrance-shift", "lmfit"),
            )
        ),
        *_candidates(
            f"lmfit with its numeric derivatives from alpha = {_USUAL[0]:g}, h = {_USUAL[1]:g} 1/µm, w = {_USUAL[2]:g}",
            "lmfit",
            [],
            draws,
            _from_usual_start,
            conductor,
            more=", one start",
        ),
    ]
    tell("Cook-Torrance with shift")
    reference = brdf_fit(whole, "cook-torrance-shift", conductor)
    finest = np.array([reference.value(name) for name in ("alpha", "h", "w")])
    own = np.array([reference.standard_error(name) for name in ("alpha", "h", "w")])
    own = np.where(np.isfinite(own), own, 0.0)
    truth, doubt = (finest, own) if known is None else (known.parameters, np.zeros(3))
    target = whole.brdf if known is None else known.brdf
    counted = np.abs(truth) > 0  # a mirror has neither h nor w

    def parameter_error(result: FloatArray) -> float:
        off = np.hypot(result - truth, doubt)[counted] / np.abs(truth[counted])
        return float(np.sqrt(np.mean(off**2)))

    def colour_error(result: FloatArray) -> float:
        fitted = _evaluated(whole, conductor, result)
        return float(np.nanmean(colour_differences(target, fitted, whole.wavelengths, whole.theta_in).absolute))

    run = race(candidates, rounds, tell)
    where = f"{whole.theta_in.size} spectra of {whole.sample}, up to {all_of_them} wavelengths"
    against = "the truth of the bench" if known else "the fit to all wavelengths, its own standard errors added"
    charts = [
        (
            "fit-parameters",
            "Fitting Cook-Torrance with shift: time against error of the parameters",
            f"{where}; from a cold start to alpha, h and w, without their standard errors. Error: root mean square of "
            f"the relative errors of the three against {against}.",
            Axis("relative error of alpha, h and w", ""),
            parameter_error,
        ),
        (
            "fit-colour",
            "The same fits: time against error of the colours",
            f"{where}. Error: mean dE00 of all fitted spectra against "
            f"{'the truth of the bench' if known else 'the measured ones, their noise included'}.",
            Axis("mean dE00", ""),
            colour_error,
        ),
    ]
    return [
        Chart(kind, title, caption, Axis("time of a fit", "s"), axis, tuple(timed.choice(error) for timed in run))
        for kind, title, caption, axis, error in (charts if has_colour(whole.wavelengths) else charts[:1])
    ]


def _local_chart(
    draws: list[Dataset], conductor: Conductor, counts: list[int], known: Known | None, rounds: int, tell: Tell
) -> Chart:
    whole = draws[0]
    spectra, all_of_them = whole.theta_in.size, whole.wavelengths.size
    rows = np.unique(np.linspace(0, spectra - 1, min(ALONE, spectra)).astype(int))
    few = [each.at_points(rows) for each in draws]
    candidates = [
        *_candidates(
            "all spectra at once", "all at once", counts, draws, local_fit, conductor, use=_use("local", "fast")
        ),
        *_candidates(
            f"lmfit spectrum by spectrum, timed on {rows.size} of the spectra",
            "lmfit, one by one",
            [count for count in COMPARED if count < all_of_them],
            few,
            local_fit,
            conductor,
            LAMBDA_N,
            "lmfit",
            share=rows.size / spectra,
            use=_use("local", "lmfit"),
        ),
    ]
    tell("local fit")
    finest = local_fit(whole, conductor)
    run = race(candidates, rounds, tell)
    truth, doubt = (finest.slope, finest.u_slope) if known is None else (known.slopes, np.zeros(spectra))

    def error(result: LocalFit) -> float:
        mine = np.arange(spectra) if result.slope.size == spectra else rows
        good = finest.reliable[mine] & np.isfinite(result.slope)
        off = np.hypot(result.slope - truth[mine], doubt[mine])[good]
        return float(np.sqrt(np.mean(off**2)))

    against = "that of the bench" if known else "the fit to all wavelengths, its own standard error added"
    return Chart(
        "fit-local",
        "The slope of every spectrum (local fit): time against error",
        f"{spectra} spectra of {whole.sample}, up to {whole.wavelengths.size} wavelengths. Error: root mean square "
        f"of the error of the slope of reliable spectra against {against}, what Eq. 2 simplifies included.",
        Axis("time for all spectra", "s"),
        Axis("error of a slope", "1/µm"),
        tuple(timed.choice(error) for timed in run),
    )


def _spread(count: int, most: int) -> IndexArray:
    """Indexes of at most `most` of `count` wavelengths, spread evenly and with both ends."""
    return np.unique(np.round(np.linspace(0, count - 1, min(most, count))).astype(int))


def _candidates(
    setting: str,
    family: str,
    counts: Sequence[int],
    draws: Sequence[Dataset],
    fit: Callable[..., Any],
    *how: object,
    more: str = "",
    share: float = 1.0,
    use: Use | None = None,
) -> list[Candidate]:
    """`fit` at each of `counts` wavelengths and at all: in round n that of the n-th of `draws`, by turns.

    `use` is how somebody fits so, but for the number of wavelengths.
    """
    every = draws[0].wavelengths.size

    def at(count: int) -> Callable[[int], Any]:
        fewer = [each.at_wavelengths(_spread(every, count)) for each in draws]
        return lambda number: fit(fewer[number % len(fewer)], *how)

    return [
        Candidate(f"{count} λ{more}", f"{setting}, {count} wavelengths", family, at(count), share, use)
        for count in [*counts, every]
    ]


def _use(model: str, engine: Engine) -> Use:
    return Use("fit", {"model": model, "engine": engine}, "A fit takes all wavelengths that its dataset has.")


def _fast(dataset: Dataset, conductor: Conductor) -> FloatArray:
    """alpha, h, w by the scans and the fast engine."""
    data = loew_data(dataset)
    starts = find_starts(Form(conductor, "cosine"), data)
    end = minimise(problem(starts.view, data), to_search(starts.parameters[0]), np.ones(3, dtype=bool), "fast")
    return from_search(end.parameters)


def _by_lmfit(dataset: Dataset, conductor: Conductor, analytic: bool) -> FloatArray:
    """The same, the descent by `lmfit` with numeric or with our derivatives."""
    data = loew_data(dataset)
    starts = find_starts(Form(conductor, "cosine"), data)
    posed = problem(starts.view, data)
    if not analytic:
        end = minimise(posed, to_search(starts.parameters[0]), np.ones(3, dtype=bool), "lmfit")
        return from_search(end.parameters)
    return from_search(_descend_with_derivatives(posed, to_search(starts.parameters[0])))


def _from_usual_start(dataset: Dataset, conductor: Conductor) -> FloatArray:
    """One descent by `lmfit`, without looking for a start."""
    data = loew_data(dataset)
    aperture = aperture_for(_USUAL[0], dataset.aperture)
    seen = view(Form(conductor, "cosine"), data.theta_in, data.theta_out, dataset.wavelengths, aperture)
    end = minimise(problem(seen, data), to_search(np.array(_USUAL)), np.ones(3, dtype=bool), "lmfit")
    return from_search(end.parameters)


def _descend_with_derivatives(posed: SumOfSquares, start: FloatArray) -> FloatArray:
    import lmfit  # noqa: PLC0415  (takes most of a second)

    names = [f"p{i}" for i in range(start.size)]
    wanted = lmfit.Parameters()
    for name, value, low, high in zip(names, start, posed.lower, posed.upper, strict=True):
        wanted.add(name, value=min(max(value, low + 1e-6), high - 1e-6), min=low, max=high)

    def values(parameters: "lmfit.Parameters") -> FloatArray:
        return np.array([parameters[name].value for name in names])

    found = lmfit.minimize(
        lambda parameters: posed.residual(values(parameters)),
        wanted,
        method="leastsq",
        calc_covar=False,
        Dfun=lambda parameters: posed.linearised(values(parameters))[1],
        col_deriv=True,
    )
    return values(found.params)


def _evaluated(dataset: Dataset, conductor: Conductor, parameters: FloatArray) -> FloatArray:
    """[points, wavelengths] of the model through the aperture, 1/sr."""
    aperture = aperture_for(float(parameters[0]), dataset.aperture)
    seen = view(Form(conductor, "cosine"), dataset.theta_in, dataset.theta_out, dataset.wavelengths, aperture)
    return np.asarray(seen.surface(parameters) / seen.cos_in)
