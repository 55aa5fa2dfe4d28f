"""Both engines end in the same minimum, and the scans start in the right valley."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.optimize import least_squares

from analysis.choices import Distribution
from analysis.fits.brdf_fit import brdf_fit
from analysis.fits.brdf_problem import from_search, linearise, problem, to_search, weighted_residual
from analysis.fits.global_fit import global_fit
from analysis.fits.least_squares import SumOfSquares, minimise
from analysis.fits.local_fit import local_fit
from analysis.fits.loew import loew_data
from analysis.reflectance.directions import Directions, in_plane, round_aperture
from analysis.reflectance.fresnel import load_conductor
from analysis.reflectance.microfacet import Form, Shift, view
from analysis.reflectance.models import cook_torrance, dielectric
from drivers.arrays import FloatArray
from goniometer.datasets.dataset import Dataset

Measure = Callable[..., Dataset]
FEW = {"incident": (10, 40, 70), "wavelength_step": 23.0}


@pytest.fixture(scope="module")
def rough(measure: Measure) -> Dataset:
    """Sample 2 of the bench, three incident angles of it."""
    return measure(0.28, 1.5, 2.6, **FEW)


@pytest.fixture(scope="module")
def patch(measure: Measure) -> Dataset:
    """A red dielectric, rough and shifted."""

    def brdf(seen: Directions, nm: FloatArray) -> FloatArray:
        return dielectric(seen, nm, 0.25, 1.5, 0.3 + 0.2 * np.tanh((nm - 590) / 40), 1.2, 2.5)

    return measure(0.25, brdf=brdf, **FEW)


@pytest.mark.parametrize("model", ["cook-torrance", "cook-torrance-shift"])
@pytest.mark.parametrize("distribution", ["ggx", "beckmann"])
def test_lmfit_and_our_own_descent_find_the_same_metal(rough: Dataset, model: str, distribution: Distribution) -> None:
    fast, slow = (brdf_fit(rough, model, None, engine, distribution) for engine in ("fast", "lmfit"))
    assert (fast.engine, slow.engine) == ("fast", "lmfit")
    assert fast.cost_value == pytest.approx(slow.cost_value, rel=1e-7)
    for ours, theirs in zip(fast.parameters, slow.parameters, strict=True):
        assert ours.value == pytest.approx(theirs.value, rel=1e-4)
        # a hundredth of what is known of it
        assert abs(ours.value - theirs.value) < 0.01 * ours.standard_error


def test_lmfit_and_our_own_descent_find_the_same_dielectric(patch: Dataset) -> None:
    fast, slow = (brdf_fit(patch, "dielectric-shift", engine=engine) for engine in ("fast", "lmfit"))
    assert fast.cost_value == pytest.approx(slow.cost_value, rel=1e-7)
    for ours, theirs in zip(fast.parameters, slow.parameters, strict=True):
        assert abs(ours.value - theirs.value) < 0.01 * ours.standard_error
    assert fast.albedo is not None
    assert slow.albedo is not None
    np.testing.assert_allclose(fast.albedo.values, slow.albedo.values, atol=1e-6)


def test_lmfit_and_our_own_search_find_the_same_slopes(rough: Dataset) -> None:
    fast, slow = (local_fit(rough, engine=engine) for engine in ("fast", "lmfit"))
    np.testing.assert_allclose(fast.slope, slow.slope, atol=1e-7)
    cosines = [global_fit(rough, fast, engine=engine) for engine in ("fast", "lmfit")]
    for ours, theirs in zip(cosines[0].parameters, cosines[1].parameters, strict=True):
        assert abs(ours.value - theirs.value) < 0.01 * ours.standard_error


@pytest.mark.parametrize("shift", ["none", "cosine", "two-component"])
@pytest.mark.parametrize("metal", [True, False])
def test_the_derivatives_that_the_descent_goes_by_are_those_of_the_cost(
    patch: Dataset, shift: Shift, metal: bool
) -> None:
    form = Form(load_conductor() if metal else None, shift)
    data = loew_data(patch)
    seen = view(form, data.theta_in, data.theta_out, patch.wavelengths, round_aperture(1.0))
    point = np.array([0.25, *([] if metal else [1.5]), *[1.1, 2.4, 0.2, 0.3, 1.5, 0.1][: len(form.quantities)]])
    point = point[: len(form.quantities)]
    near, searched = linearise(seen, data, point), to_search(point)
    # with the albedo refitted at every step; what variable projection leaves out is of the order of the residual
    gradient = np.einsum("kpw,pw->k", near.jacobian, near.residual)
    for i in range(point.size):
        step = np.zeros(point.size)
        step[i] = 1e-5
        ahead, behind = (
            float(np.sum(weighted_residual(seen, data, from_search(searched + side * step))[0] ** 2)) / 2
            for side in (1, -1)
        )
        assert gradient[i] == pytest.approx((ahead - behind) / 2e-5, rel=1e-5, abs=1e-7)


def test_a_minimum_that_scipy_finds_with_bounds_is_found() -> None:
    """Rosenbrock's valley with its minimum outside the bounds."""

    def residual(x: FloatArray) -> FloatArray:
        return np.array([10 * (x[1] - x[0] ** 2), 1 - x[0]])

    def linearised(x: FloatArray) -> tuple[FloatArray, FloatArray]:
        return residual(x), np.array([[-20 * x[0], -1.0], [10.0, 0.0]])

    low, high = np.array([-2.0, -1.0]), np.array([0.8, 3.0])
    end = minimise(SumOfSquares(residual, linearised, low, high), np.array([-1.5, 2.0]), np.ones(2, dtype=bool), "fast")
    theirs = least_squares(residual, [-1.5, 2.0], bounds=(low, high), xtol=1e-12, ftol=1e-12, gtol=1e-12)
    assert end.converged
    np.testing.assert_allclose(end.parameters, theirs.x, atol=1e-4)
    assert end.cost == pytest.approx(2 * theirs.cost, rel=1e-6)


def test_what_is_held_stays_and_a_fit_that_cannot_end_says_so(rough: Dataset) -> None:
    form, data = Form(load_conductor(), "cosine"), loew_data(rough)
    seen = view(form, data.theta_in, data.theta_out, rough.wavelengths, round_aperture(1.0))
    start = to_search(np.array([0.3, 0.5, 2.0]))
    for engine in ("fast", "lmfit"):
        end = minimise(problem(seen, data), start, np.array([True, False, False]), engine)
        np.testing.assert_array_equal(end.parameters[1:], [0.5, 2.0])
        assert end.cost < float(np.sum(problem(seen, data).residual(start) ** 2))

    def endless(x: FloatArray) -> tuple[FloatArray, FloatArray]:
        return np.exp(-x), -np.exp(-x)[None]

    far = SumOfSquares(lambda x: endless(x)[0], endless, np.array([-np.inf]), np.array([np.inf]))
    assert not minimise(far, np.zeros(1), np.ones(1, dtype=bool), "fast").converged


def test_an_independent_search_over_the_whole_range_finds_no_better_lobe(measure: Measure) -> None:
    dataset = measure(0.05, -1.2, 7.0, noise=1e-2, **FEW)
    fit = brdf_fit(dataset)
    cos_in = np.cos(np.radians(dataset.theta_in))[:, None]
    lowest = np.inf
    # without our aperture, scans or engine; it costs more through neglecting the aperture, never less by 2 %
    directions = in_plane(dataset.theta_in, dataset.theta_out)
    for alpha in np.linspace(0.045, 0.056, 12):
        for h in (-1.4, -1.2, -1.0):
            for w in (5.0, 7.0, 9.0):
                model = cook_torrance(directions, dataset.wavelengths, alpha, load_conductor(), h, w)
                cost = np.sum((np.log1p(cos_in * model) - np.log1p(cos_in * dataset.brdf)) ** 2)
                lowest = min(lowest, float(cost))
    assert fit.cost_value < lowest
