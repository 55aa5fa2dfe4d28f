"""Any of the models by name, each compared with the simpler one that it contains."""

import math
from dataclasses import replace

import numpy as np

from analysis.choices import BRDF_MODELS, MODELS, Distribution, Engine, Weight
from analysis.colour import colour_differences, has_colour
from analysis.errors import FitError
from analysis.fits.brdf_fit import brdf_fit, form_of
from analysis.fits.brdf_two_component import local_slopes
from analysis.fits.global_fit import SLOPE_MODELS, global_fit, search_slopes, slope_and_derivative
from analysis.fits.local_fit import LEAST_WAVELENGTHS, local_fit
from analysis.fits.stored_fit import StoredFit
from analysis.reflectance.directions import Directions
from analysis.reflectance.fresnel import Conductor, load_conductor
from analysis.reflectance.microfacet import slope_of
from analysis.results import Comparison, LocalFit, ModelFit, Verdict
from analysis.wording import words
from drivers.arrays import FloatArray
from goniometer.datasets.dataset import Dataset

SIMPLER = {
    "global": "constant-slope",
    "global-two-component": "global",
    "cook-torrance-shift": "cook-torrance",
    "two-component": "cook-torrance-shift",
    "dielectric-shift": "dielectric",
    "dielectric-two-component": "dielectric-shift",
}
"""The model that each contains, and against which it has to prove itself."""

STRONG_EVIDENCE = 10.0
"""Fall of the Bayesian information criterion that is very strong evidence (Kass & Raftery 1995)."""


def fit_models(
    dataset: Dataset,
    local: LocalFit,
    models: tuple[str, ...],
    conductor: Conductor | None = None,
    engine: Engine = "fast",
    distribution: Distribution = "ggx",
    weight: Weight = "none",
) -> tuple[ModelFit, ...]:
    """Fit `models`, names of `MODELS` but "local", to `dataset`; `local` is its local fit.

    Each is compared with the simpler model that it contains, which is fitted too where it is not among `models`. One
    that is no better by the Bayesian information criterion is not trusted, and neither is a model of a metal whose
    colour the spectra do not have (`local.doubts`). `conductor`, `distribution` and `weight` as in
    `analysis.fits.brdf_fit`. Raises `FitError` for an unknown model and what the fits raise.
    """
    unknown = [model for model in models if model not in MODELS or model == "local"]
    if unknown:
        raise FitError(f'There is no model "{unknown[0]}" of all spectra; there are {", ".join(MODELS[1:])}.')
    found: dict[str, ModelFit] = {}

    def fitted(model: str) -> ModelFit:
        if model not in found:
            if model in BRDF_MODELS:
                fit = brdf_fit(dataset, model, conductor, engine, distribution, weight)
                found[model] = fit if fit.albedo is not None else _doubted(fit, local.doubts)
            else:
                found[model] = global_fit(dataset, local, conductor, engine, model)
        return found[model]

    return tuple(
        compared(fitted(model), fitted(SIMPLER[model]), dataset, conductor) if model in SIMPLER else fitted(model)
        for model in models
    )


def local_fit_for(
    dataset: Dataset, models: tuple[str, ...], conductor: Conductor | None = None, engine: Engine = "fast"
) -> LocalFit:
    """The local fit for `models`: without Fresnel term (section 5.6) where all of them are of a dielectric.

    Raises `FitError` for data of a few colours, of which no model here can be told, and what `local_fit` raises.
    """
    if dataset.wavelengths.size < LEAST_WAVELENGTHS:
        raise FitError(
            f"{dataset.sample} was {words(dataset).done} at {dataset.wavelengths.size} "
            f"{'wavelength' if dataset.wavelengths.size == 1 else 'wavelengths'}; "
            f"a model of spectra needs at least {LEAST_WAVELENGTHS}."
        )
    of_dielectric = bool(models) and all(model.startswith("dielectric") for model in models)
    return local_fit(dataset, conductor, engine=engine, fresnel=not of_dielectric)


def compared(fit: ModelFit, simpler: ModelFit, dataset: Dataset, conductor: Conductor | None = None) -> ModelFit:
    """`fit` with its comparison to a simpler model of the same cost, and a verdict that knows of it.

    The Bayesian information criterion is n ln(cost / n) + k ln(n) (Schwarz 1978) with k parameters and n independent
    residuals, as which the residuals of `fit` count by their autocorrelation: that of all residuals would call every
    trifle significant where neighbours repeat each other. The two components of a metal (`conductor`, aluminium unless
    given) are fitted to the slopes of the spectra as well, so what is left of these counts in the same way, beside the
    least that any cosine leaves. Raises `OutOfRange` beyond the conductor's table.
    """
    n = max(fit.independent, 2.0)
    more = len(fit.parameters) - len(simpler.parameters)
    bic = n * math.log(simpler.cost_value / fit.cost_value) - more * math.log(n) if fit.cost_value > 0 else math.inf
    slopes = None
    if fit.model == "two-component":
        slopes = local_slopes(dataset, dataset.usable, conductor or load_conductor())
    if slopes is not None:
        _, of_cosine = search_slopes("global", slopes.values, slopes.root_weight**2, slopes.directions, "fast")
        of_fit = slopes.chi_square(fitted_slope(fit, slopes.directions))
        bic += min(n, float(slopes.values.size)) * math.log(of_cosine / of_fit)
    gained = _mean_difference(dataset, simpler.fitted) - _mean_difference(dataset, fit.fitted)
    comparison = Comparison(simpler.model, bic, gained)
    evidence = f"BIC {_fall(bic, 3)}, mean dE00 {_fall(gained, 2)}"
    verdict = fit.verdict
    if not bic > STRONG_EVIDENCE:
        against = f"The simpler model {simpler.model} explains the data as well ({evidence}; a BIC by 10 would do)."
        verdict = replace(verdict, trusted=False, reasons=(*_against(verdict), against, *_notes(verdict)))
    elif gained < 0:
        note = f"The simpler model {simpler.model} costs more but has the smaller colour difference ({evidence})."
        verdict = replace(verdict, reasons=(*verdict.reasons, note))
    return replace(fit, comparison=comparison, verdict=verdict)


def _doubted(fit: ModelFit, doubts: tuple[str, ...]) -> ModelFit:
    """`fit`, not trusted where there are doubts about all spectra."""
    if not doubts:
        return fit
    verdict = fit.verdict
    reasons = (*_against(verdict), *doubts, *_notes(verdict))
    return replace(fit, verdict=replace(verdict, trusted=False, reasons=reasons))


def _fall(amount: float, digits: int) -> str:
    """By how much something falls or rises, in words.

    >>> _fall(12.345, 3), _fall(-0.062, 2)
    ('falls by 12.3', 'rises by 0.062')
    """
    if math.isnan(amount):
        return "is not known"
    return f"{'falls' if amount >= 0 else 'rises'} by {abs(amount):.{digits}g}"


def fitted_slope(fit: ModelFit | StoredFit, directions: Directions) -> FloatArray:
    """[...] slope of the shift that a fit gives at `directions` [...], 1/um; zero for a model without shift."""
    parameters = np.array([parameter.value for parameter in fit.parameters if parameter.name != "p"])
    if fit.model in SLOPE_MODELS:
        return slope_and_derivative(fit.model, directions, parameters)[0]
    form = form_of(fit.model, None if fit.albedo is not None else load_conductor(), fit.distribution or "ggx")
    return slope_of(form, directions, parameters)


def _against(verdict: Verdict) -> tuple[str, ...]:
    return () if verdict.trusted else verdict.reasons


def _notes(verdict: Verdict) -> tuple[str, ...]:
    return verdict.reasons if verdict.trusted else ()


def _mean_difference(dataset: Dataset, fitted: FloatArray) -> float:
    """Mean absolute CIEDE2000 to the measurement; NaN where the wavelengths have no colour."""
    if not has_colour(dataset.wavelengths):
        return math.nan
    differences = colour_differences(dataset.brdf, fitted, dataset.wavelengths, dataset.theta_in).absolute
    usable = differences[np.isfinite(differences)]
    return float(usable.mean()) if usable.size else math.nan
