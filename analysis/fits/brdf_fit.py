"""Microfacet models fitted to a whole dataset (section 6.2 of the paper): conductors, dielectrics, with any shift.

The cost is that of Löw et al. 2012 (`analysis.fits.loew`). A model is read through the instrument's aperture
(`analysis.reflectance.microfacet`), else a narrow lobe would come out too rough. Where to start is found by scans
(`analysis.fits.brdf_start`), whichever engine then goes downhill.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from analysis.choices import BRDF_MODELS, Distribution, Engine, Weight
from analysis.errors import FitError
from analysis.fits.brdf_errors import Pulled, albedo_uncertainty, parameter_covariances, parameter_gain, residual_errors
from analysis.fits.brdf_problem import from_search, linearise, log_model, problem, to_search
from analysis.fits.brdf_start import SCANNED_ALPHAS, find_starts
from analysis.fits.brdf_two_component import find_two_components
from analysis.fits.identify import LARGEST_RESIDUAL_RATIO, Evidence, judge
from analysis.fits.least_squares import Minimum, minimise
from analysis.fits.loew import MIRROR_LOBE, LoewData, grazing_weighs_less, loew_data
from analysis.fits.misfit import MISFIT, excess, moved_by
from analysis.fits.propagation import correlation, errors_by_part
from analysis.fits.structure import structure
from analysis.reflectance.directions import in_plane
from analysis.reflectance.distributions import lobe_width
from analysis.reflectance.fresnel import Conductor, load_conductor
from analysis.reflectance.microfacet import LARGEST_W, Form, Shift, View, aperture_for, slope_of, view
from analysis.reflectance.models import LAMBDA_N, shift_is_clamped
from analysis.reflectance.two_component import TWO_COMPONENTS
from analysis.results import Albedo, ModelFit, Parameter
from drivers.arrays import BoolArray, FloatArray
from goniometer.datasets.angular import SAME_INCIDENCE, incidence_groups
from goniometer.datasets.dataset import Dataset
from goniometer.uncertainty import combined

_SHIFTS: dict[str, Shift] = {
    "cook-torrance": "none",
    "cook-torrance-shift": "cosine",
    "two-component": "two-component",
    "dielectric": "none",
    "dielectric-shift": "cosine",
    "dielectric-two-component": "two-component",
}

_EQUATIONS: dict[str, str] = {
    "cook-torrance": "f = F G D / (4 cos_i cos_o), Eq. 6",
    "cook-torrance-shift": "f = shift F G D / (4 cos_i cos_o), m = h cos(w theta_m), Eq. 7",
    "two-component": f"f = shift F G D / (4 cos_i cos_o), m = {TWO_COMPONENTS}",
    "dielectric": "f = r_d / pi + F G D / (4 cos_i cos_o), Eq. 8 without shift",
    "dielectric-shift": "f = r_d / pi + shift F G D / (4 cos_i cos_o), m = h cos(w theta_m), Eq. 8",
    "dielectric-two-component": f"f = r_d / pi + shift F G D / (4 cos_i cos_o), m = {TWO_COMPONENTS}",
}


@dataclass(frozen=True)
class _Found:
    """Where the fit ended."""

    parameters: FloatArray
    """[parameters]"""
    free: int
    """How many of them, from the first, the data determine; the others are fixed."""
    minimum: Minimum
    covariances: dict[str, FloatArray]
    """[free, free] by part of the budget."""
    scatter: float | None = None
    """Birge ratio of the local slopes where these determine the shift; None where the cost alone does."""
    pulled: Pulled | None = None
    """These slopes."""


def form_of(model: str, conductor: Conductor | None, distribution: Distribution) -> Form:
    """What the name of a model, one of `BRDF_MODELS`, stands for; `conductor` is None for a dielectric."""
    return Form(conductor, _SHIFTS[model], distribution)


def brdf_fit(
    dataset: Dataset,
    model: str = "cook-torrance-shift",
    conductor: Conductor | None = None,
    engine: Engine = "fast",
    distribution: Distribution = "ggx",
    weight: Weight = "none",
) -> ModelFit:
    """Fit `model`, one of `BRDF_MODELS`, to `dataset`.

    `conductor` is aluminium unless given; dielectrics need none, for they have a refractive index eta and a diffuse
    albedo to be fitted. `weight` says how the terms of the cost are weighed, and the result's `cost` says it too; for
    a lobe narrower than a degree, grazing angles weigh less. Points that are not usable (`dataset.usable`) are left
    out. Where the data do not determine w of a cosine, because h or w is within three standard errors of zero or w ran
    to its bound, w is fixed at 0, which makes the slope the constant h.

    The standard errors pass all errors of the measurement through the estimator, each shared as it is shared. Where the
    residuals are structured, they have a part more for what the model does not describe (`analysis.fits.misfit`); where
    not, they are multiplied by the ratio of the residuals to their combined standard uncertainty if that is above two
    (Birge ratio); systematic errors leave residuals too, so they count in it. The albedo's are multiplied in any case.
    r2 is that of ln(1 + cos(theta_in) f). Raises `OutOfRange` for wavelengths beyond the conductor's table and
    `FitError` for an unknown model or if fewer than five points are left.
    """
    if model not in _SHIFTS:
        raise FitError(f'There is no microfacet model "{model}"; there are {", ".join(BRDF_MODELS)}.')
    form = form_of(model, None if model.startswith("dielectric") else conductor or load_conductor(), distribution)
    data = loew_data(dataset, weight)
    # a metal's two components are searched for from its cosine on
    pulled = form.shift == "two-component" and form.conductor is not None
    starts = find_starts(replace(form, shift="cosine") if pulled else form, data)
    seen = replace(starts.view, form=form)
    start = starts.parameters[0]
    if lobe_width(float(start[0]), distribution) < MIRROR_LOBE:
        data = grazing_weighs_less(data)
    if pulled:
        found = _search_two_components(form, data, seen, start, engine)
        return _result(model, form, data, seen, found, (), engine)
    return _result(model, form, data, seen, _search(form, data, seen, start, engine), starts.parameters[1:], engine)


def _search_two_components(form: Form, data: LoewData, seen: View, cosine: FloatArray, engine: Engine) -> _Found:
    """Descend from the `cosine` and the local slopes."""
    end, pull = find_two_components(form, data, seen, cosine, engine)
    parameters = from_search(end.parameters)
    pulled = None if pull is None else pull.linearised(form, data, parameters)
    covariances = _covariances(seen, data, parameters, parameters.size, pulled)
    scatter = None if pull is None else pull.scatter(form, parameters)
    return _Found(parameters, parameters.size, end, covariances, scatter, pulled)


def _search(form: Form, data: LoewData, seen: View, start: FloatArray, engine: Engine) -> _Found:
    """Descend with everything free; without w where a cosine's does not show."""
    everything = np.ones(start.size, dtype=bool)
    end = minimise(problem(seen, data), to_search(start), everything, engine)
    parameters = from_search(end.parameters)
    covariances = _covariances(seen, data, parameters, start.size)
    if form.shift != "cosine" or _cosine_is_determined(parameters, covariances):
        return _Found(parameters, start.size, end, covariances)
    without_w: BoolArray = np.arange(start.size) < start.size - 1
    end = minimise(problem(seen, data), to_search(np.append(parameters[:-1], 0.0)), without_w, engine)
    parameters = from_search(end.parameters)
    return _Found(parameters, start.size - 1, end, _covariances(seen, data, parameters, start.size - 1))


def _covariances(
    seen: View, data: LoewData, parameters: FloatArray, free: int, pulled: Pulled | None = None
) -> dict[str, FloatArray]:
    near = linearise(seen, data, parameters)
    aperture = aperture_for(float(parameters[0]), data.dataset.aperture)
    return parameter_covariances(
        near, data, parameters, free, residual_errors(data, seen, aperture, parameters, near.albedo), pulled
    )


def _cosine_is_determined(parameters: FloatArray, covariances: dict[str, FloatArray]) -> bool:
    """Whether both h and w are more than three standard errors from zero, and w is within its bound."""
    u_h, u_w = np.sqrt(np.diag(np.sum(list(covariances.values()), axis=0)))[-2:]
    h, w = parameters[-2:]
    return bool(abs(h) > 3 * u_h and 3 * u_w < w < 0.999 * LARGEST_W)


def _result(
    model: str,
    form: Form,
    data: LoewData,
    seen: View,
    found: _Found,
    others: tuple[FloatArray, ...],
    engine: Engine,
) -> ModelFit:
    dataset, parameters, count = data.dataset, found.parameters, found.parameters.size
    near = linearise(seen, data, parameters)
    aperture = aperture_for(float(parameters[0]), dataset.aperture)
    errors = residual_errors(data, seen, aperture, parameters, near.albedo)
    residual = log_model(seen, parameters, near.albedo) - data.log_measured
    valid = data.valid
    around = data.log_measured[valid] - data.log_measured[valid].mean()
    r2 = float(1 - np.sum(residual[valid] ** 2) / np.sum(around**2))
    stated = combined(errors, valid.shape)
    ratio = float(np.sqrt(np.mean((residual[valid] / stated[valid]) ** 2)))
    of_residuals = structure(residual, valid, errors, data.theta_in, data.theta_out)
    # residuals beyond the uncertainty are errors of the model; the parameters then stand for less than it says
    birge = ratio if ratio > LARGEST_RESIDUAL_RATIO else 1.0
    inflation = np.full(count, 1.0 if of_residuals.structured else birge)
    if found.scatter is not None:
        inflation[form.first_of_shift :] = found.scatter
    covariance = np.diag(np.full(count, math.inf))
    together = np.sum(list(found.covariances.values()), axis=0)
    covariance[: found.free, : found.free] = np.outer(inflation, inflation)[: found.free, : found.free] * together
    misfit = np.zeros(count)
    if of_residuals.structured:
        gain, _ = parameter_gain(near, data, parameters, found.free, found.pulled)
        misfit[: found.free] = moved_by(
            gain,
            np.where(valid, excess(residual, stated), 0.0),
            incidence_groups(data.theta_in, SAME_INCIDENCE),
        )
        covariance += np.diag(misfit**2)
    sigma = np.sqrt(np.diag(covariance))
    shares = [
        errors_by_part(found.covariances, i, inflation[i]) | ({MISFIT: float(misfit[i])} if misfit[i] > 0 else {})
        if math.isfinite(sigma[i])
        else {}
        for i in range(count)
    ]
    verdict = judge(
        Evidence(
            dataset=dataset,
            fitted=data.points,
            distribution=form.distribution,
            quantities=form.quantities,
            values=parameters,
            u=sigma,
            u_alpha_from_angles=shares[0].get("angle", 0.0),
            residual_ratio=ratio,
            r2=r2,
            scanned_alphas=(float(SCANNED_ALPHAS[0]), float(SCANNED_ALPHAS[-1])),
            w_fixed=found.free < count,
            others=others,
            not_converged="" if found.minimum.converged else found.minimum.message,
            structure=of_residuals,
        )
    )
    everywhere = view(form, dataset.theta_in, dataset.theta_out, dataset.wavelengths, aperture)
    slope = slope_of(form, in_plane(dataset.theta_in, dataset.theta_out), parameters)
    albedo = None
    if near.albedo is not None:
        u_albedo = birge * albedo_uncertainty(near, data, parameters, found.free, errors)
        albedo = Albedo(dataset.wavelengths, near.albedo, u_albedo)
    return ModelFit(
        model=model,
        equation=_EQUATIONS[model],
        parameters=tuple(
            Parameter(quantity.name, float(parameters[i]), float(sigma[i]), quantity.unit, shares[i])
            for i, quantity in enumerate(form.quantities)
        ),
        correlation=correlation(covariance),
        cost=data.cost if found.scatter is None else f"{data.cost}, minimised with the chi-square of the local slopes",
        cost_value=found.minimum.cost,
        r2=r2,
        verdict=verdict,
        fitted=np.expm1(log_model(everywhere, parameters, near.albedo)) / everywhere.cos_in,
        lambda_n=LAMBDA_N,
        theta_range=(
            float(data.theta_in.min()),
            float(data.theta_in.max()),
            float(data.theta_out.min()),
            float(data.theta_out.max()),
        ),
        wavelength_range=(float(dataset.wavelengths[0]), float(dataset.wavelengths[-1])),
        clamped_points=int(shift_is_clamped(slope, dataset.wavelengths).sum()),
        engine=engine,
        distribution=form.distribution,
        albedo=albedo,
        independent=of_residuals.independent,
    )
