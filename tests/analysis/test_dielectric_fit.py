"""Dielectrics: surface and diffuse albedo come apart, and what was measured says how well."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from analysis.fits.brdf_fit import brdf_fit
from analysis.reflectance.microfacet import best_albedo
from analysis.reflectance.models import dielectric
from drivers.arrays import FloatArray
from goniometer.datasets.dataset import Dataset

Measure = Callable[..., Dataset]
TRUTH = {"alpha": 0.25, "eta": 1.5, "h": 1.2, "w": 2.5}


def red(wavelengths: FloatArray) -> FloatArray:
    """Reflectance of a red patch."""
    return np.asarray(0.3 + 0.2 * np.tanh((wavelengths - 590) / 40))


def patch(measure: Measure, seed: int, **errors: float) -> Dataset:
    """A rough red dielectric, three incident angles of it."""
    return measure(
        0.25,
        seed=seed,
        brdf=lambda seen, nm: dielectric(seen, nm, 0.25, 1.5, red(nm), 1.2, 2.5),
        incident=(10, 40, 70),
        wavelength_step=23.0,
        **errors,
    )


def test_index_roughness_shift_and_albedo_are_recovered_within_what_is_stated(measure: Measure) -> None:
    z, z_albedo = [], []
    for seed in range(8):
        fit = brdf_fit(patch(measure, seed), "dielectric-shift")
        assert fit.verdict.trusted, fit.verdict
        z.append([(fit.value(name) - value) / fit.standard_error(name) for name, value in TRUTH.items()])
        assert fit.albedo is not None
        z_albedo.append((fit.albedo.values - red(fit.albedo.wavelengths)) / fit.albedo.u)
    # of 8 x 4 normal numbers the root mean square lies within 0.6 and 1.45 in more than 99 % of all cases
    assert 0.6 < np.sqrt(np.mean(np.square(z))) < 1.45, z
    assert 0.6 < np.sqrt(np.mean(np.square(z_albedo))) < 1.45


def test_a_systematic_error_widens_what_is_stated_of_the_albedo(measure: Measure) -> None:
    quiet, wrong = (brdf_fit(patch(measure, 1, systematic=s), "dielectric-shift").albedo for s in (False, True))
    assert quiet is not None
    assert wrong is not None
    # the certificate is known to 0.5 %, the drift and the directions of the panel to a little less
    assert np.all(wrong.u > 0.005 * wrong.values)
    assert np.all(wrong.u > 3 * quiet.u)
    assert np.all(np.abs(wrong.values - red(wrong.wavelengths)) < 4 * wrong.u)


def test_the_albedo_beside_a_surface_is_the_best_that_is_not_negative() -> None:
    random = np.random.default_rng(3)
    cos_in = np.cos(np.radians(random.uniform(0, 80, 60)))[:, None]
    surface = cos_in * random.uniform(0, 2, (60, 5))
    true = np.array([0.9, 0.3, 0.02, 0.0, -0.2])  # what noise and a wrong surface may pretend
    log_measured = np.log1p(surface + cos_in / np.pi * true + 0.01 * random.normal(size=surface.shape))
    weight = random.uniform(0.5, 2, surface.shape)
    weight[random.uniform(size=surface.shape) < 0.1] = 0
    found = best_albedo(surface, cos_in, log_measured, weight)
    for i, albedo in enumerate(found):

        def cost(r: float, i: int = i) -> float:
            value = np.log1p(surface[:, i] + cos_in[:, 0] / np.pi * r)
            return float(np.sum((weight[:, i] * (value - log_measured[:, i])) ** 2))

        theirs = minimize_scalar(cost, bounds=(0, 2), method="bounded", options={"xatol": 1e-12})
        assert albedo == pytest.approx(float(theirs.x), abs=1e-6)
    assert found[-1] == 0


def test_without_a_shift_the_albedo_takes_its_colour_as_in_the_paper(measure: Measure) -> None:
    # 6.2.2: Cook-Torrance makes up for the shift that it lacks with a diffuse albedo tinted towards red
    plain = brdf_fit(patch(measure, 2), "dielectric")
    assert plain.albedo is not None
    tint = plain.albedo.values / red(plain.albedo.wavelengths)
    assert tint[-5:].mean() > 1.02 * tint[:5].mean()
    assert any("structured over" in reason for reason in plain.verdict.reasons)
