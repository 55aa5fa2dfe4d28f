"""A fit says what the data do not tell, and whether a simpler model does as well."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from analysis.choices import Distribution
from analysis.errors import FitError
from analysis.fits.analyse import analyse
from analysis.fits.brdf_fit import brdf_fit
from analysis.fits.by_name import fit_models, fitted_slope
from analysis.fits.local_fit import local_fit
from analysis.fits.loew import loew_data
from analysis.reflectance.directions import Directions, in_plane
from analysis.reflectance.fresnel import fresnel_conductor, load_conductor
from analysis.reflectance.models import dielectric, microfacet
from analysis.reflectance.two_component import two_component_slope
from analysis.results import SampleAnalysis
from drivers.arrays import FloatArray
from goniometer.datasets.dataset import Dataset

Measure = Callable[..., Dataset]
TRUTH = {"h": 1.2, "w": 2.5, "t_y": 0.1, "kappa": 0.8, "sharpness": 2.0, "threshold": 0.2}
FEW = {"incident": (0, 20, 40, 60, 75), "wavelength_step": 23.0}


def two_component(seen: Directions, nm: FloatArray, distribution: Distribution = "ggx") -> FloatArray:
    """Aluminium of alpha 0.25 whose multiple reflections have a slope of their own."""
    fresnel = fresnel_conductor(seen.cos_d[..., None], *load_conductor().index(nm))
    return microfacet(seen, nm, 0.25, fresnel, two_component_slope(seen, *TRUTH.values()), distribution)


@pytest.fixture(scope="module")
def compensated(measure: Measure) -> SampleAnalysis:
    """Two components measured, with the errors that points and wavelengths share, and every model of a metal."""
    dataset = measure(0.25, brdf=two_component, systematic=True, seed=1, **FEW)
    return analyse(dataset, models=("global", "global-two-component", "cook-torrance-shift", "two-component"))


def test_two_components_are_recovered_where_one_cosine_fails(compensated: SampleAnalysis) -> None:
    for model in ("two-component", "global-two-component"):
        fit = compensated.model(model)
        assert fit.verdict.trusted, fit.verdict
        assert fit.comparison is not None
        assert fit.comparison.bic > 100
        assert fit.comparison.dE00 > 0.5
    fit = compensated.model("two-component")
    for name, value in TRUTH.items():
        assert abs(fit.value(name) - value) < 4 * fit.standard_error(name), name
    assert fit.verdict.reasons == ()


def test_structure_is_said_of_the_model_that_leaves_it_and_of_no_other(compensated: SampleAnalysis) -> None:
    said = {fit.model: " ".join(fit.verdict.reasons) for fit in compensated.models}
    assert "structured over wavelength" in said["cook-torrance-shift"]
    assert "theta_out" in said["cook-torrance-shift"]
    # errors that wavelengths and points share make neighbours agree as well, and are no structure
    assert "structured" not in said["two-component"]


def test_the_slope_of_a_fit_is_that_of_the_truth(compensated: SampleAnalysis) -> None:
    seen = in_plane(np.full(31, 40.0), np.linspace(-80, 80, 31))
    for model in ("two-component", "global-two-component"):
        slope = fitted_slope(compensated.model(model), seen)
        np.testing.assert_allclose(slope, two_component_slope(seen, *TRUTH.values()), atol=0.15)


def test_a_wrong_lobe_does_not_spoil_the_colours_of_two_components(measure: Measure) -> None:
    dataset = measure(0.25, brdf=partial(two_component, distribution="beckmann"), systematic=True, seed=1, **FEW)
    analysis = analyse(dataset, models=("cook-torrance-shift", "two-component"))
    # Beckmann's lobe leaves nothing far from the mirror direction that has a colour
    lit = dataset.brdf.mean(axis=1) > 1e-3
    seen = in_plane(dataset.theta_in[lit], dataset.theta_out[lit])
    truth = two_component_slope(seen, *TRUTH.values())
    cosine, both = (
        float(np.sqrt(np.mean((fitted_slope(analysis.model(model), seen) - truth) ** 2)))
        for model in ("cook-torrance-shift", "two-component")
    )
    # 1/um; what Beckmann's lobe has more or less than GGX's is several times the effect of a slope
    assert both < 0.05, (both, cosine)
    assert cosine > 0.3
    fit = analysis.model("two-component")
    assert fit.comparison is not None
    assert fit.comparison.bic > 100
    assert "local slopes" in fit.cost
    # at normal incidence this weight has no points, while their slopes are known
    weighted = brdf_fit(dataset, "two-component", weight="sine")
    assert weighted.value("kappa") == pytest.approx(TRUTH["kappa"], abs=0.1)


def test_a_second_component_that_is_not_there_is_not_trusted(measure: Measure) -> None:
    dataset = measure(0.25, 1.2, 2.5, **FEW)
    local = local_fit(dataset)
    fits = fit_models(dataset, local, ("cook-torrance-shift", "two-component", "global-two-component"))
    assert fits[0].verdict.trusted
    for fit in fits[1:]:
        assert not fit.verdict.trusted
        assert any("explains the data as well" in reason for reason in fit.verdict.reasons)
        assert "threshold" in fit.verdict.undetermined


def test_a_lobe_whose_middle_was_not_measured_is_an_extrapolation(measure: Measure) -> None:
    dataset = measure(0.1, wavelength_step=46.0, incident=(0, 30, 60))
    away = np.abs(dataset.theta_out - dataset.theta_in) > 12
    fit = brdf_fit(replace(dataset, flags=np.where(away, 0, 1).astype(np.uint16)), "cook-torrance")
    assert not fit.verdict.trusted
    assert any("extrapolation" in reason for reason in fit.verdict.reasons)


def test_the_wrong_kind_of_material_is_not_believed(measure: Measure) -> None:
    chalk = measure(0.3, brdf=lambda s, nm: dielectric(s, nm, 0.3, 1.5, np.full(nm.size, 0.8)), **FEW)
    metal = brdf_fit(chalk, "cook-torrance")
    assert not metal.verdict.trusted
    assert any("explains only" in reason for reason in metal.verdict.reasons)
    assert brdf_fit(chalk, "dielectric").verdict.trusted


def test_the_cost_says_how_its_terms_are_weighed(measure: Measure) -> None:
    dataset = measure(0.2, 1.0, 3.0, wavelength_step=46.0, incident=(0, 40, 70))
    cos_in, sin_in = (f(np.radians(dataset.theta_in))[:, None] for f in (np.cos, np.sin))
    fit = brdf_fit(dataset, weight="sine")
    assert fit.cost == "loew, terms weighted by sin(theta_in)"
    residual = np.log1p(cos_in * fit.fitted) - np.log1p(cos_in * dataset.brdf)
    assert fit.cost_value == pytest.approx(np.sum(sin_in * residual**2), rel=1e-9)
    assert np.count_nonzero(loew_data(dataset, "sine").points) < dataset.theta_in.size  # sin(0) = 0
    assert fit.value("alpha") == pytest.approx(0.2, rel=2e-3)


def test_grazing_angles_of_a_mirror_weigh_less_and_a_grazing_fault_does_less_harm(measure: Measure) -> None:
    mirror = measure(0.0045, rule=(16, 40), wavelength_step=46.0, incident=(0, 20, 40, 80))
    fit = brdf_fit(mirror, "cook-torrance")
    assert "cos(theta_in)^2" in fit.cost
    assert "cos" not in brdf_fit(measure(0.2, wavelength_step=46.0, incident=(0, 40)), "cook-torrance").cost
    # as the paper's instrument, which reads too little of its mirror at grazing angles
    grazing = np.where(mirror.theta_in > 75, 0.5, 1.0)[:, None]
    spoilt = brdf_fit(replace(mirror, brdf=mirror.brdf * grazing), "cook-torrance")
    cos_in = np.cos(np.radians(mirror.theta_in))[:, None]
    residual = np.log1p(cos_in * spoilt.fitted) - np.log1p(cos_in * mirror.brdf * grazing)
    assert spoilt.cost_value == pytest.approx(np.sum((cos_in * residual) ** 2), rel=1e-9)
    assert spoilt.value("alpha") == pytest.approx(0.0045, rel=0.02)


def test_an_unknown_model_is_refused_with_the_known_ones(measure: Measure) -> None:
    dataset = measure(0.3, wavelength_step=46.0, incident=(0,))
    with pytest.raises(FitError, match="dielectric-shift"):
        fit_models(dataset, local_fit(dataset), ("lambert",))
    with pytest.raises(FitError, match="two-component"):
        brdf_fit(dataset, "lambert")
