"""The global fit finds the best cosine, says how sure it is, and when there is none."""

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from analysis.errors import FitError
from analysis.fits.global_fit import global_fit
from analysis.fits.local_fit import local_fit, shifted_fresnel
from analysis.reflectance.fresnel import load_conductor
from analysis.reflectance.models import cosine_slope
from drivers.arrays import FloatArray
from goniometer.datasets.dataset import Dataset
from goniometer.uncertainty import ErrorSource, everywhere

THETA_IN, THETA_OUT = (g.ravel() for g in np.meshgrid(np.arange(0.0, 81, 10), np.arange(-80.0, 81, 5), indexing="ij"))


def made(h: float, w: float, t_y: float, p: float, seed: int = 0, shared: float = 0.0, scatter: float = 0.0) -> Dataset:
    """Spectra of Eqs. 3 to 5 with 1 % noise, `shared` relative noise of the reference, and slopes that `scatter`."""
    random = np.random.default_rng(seed)
    wavelengths = np.arange(382.0, 998.0, 9.2)
    shape = (THETA_IN.size, wavelengths.size)
    empty = Dataset(
        sample="made",
        theta_in=THETA_IN,
        theta_out=THETA_OUT,
        wavelengths=wavelengths,
        brdf=np.ones(shape),
        sources=(),
        flags=np.zeros(THETA_IN.size, dtype=np.uint16),
        u_angle=0.005,
        u_zero=0.01,
        aperture=1.0,
    )
    slope = cosine_slope(0.5 * np.abs(THETA_OUT - THETA_IN), h, w, t_y) + scatter * random.normal(size=THETA_IN.size)
    scale = 10 ** random.uniform(-2, 1, THETA_IN.size)
    clean = shifted_fresnel(empty, scale, slope, np.full(THETA_IN.size, p), load_conductor(), 600.0)
    group = np.unique(THETA_IN, return_inverse=True)[1]
    u_random, u_reference = 0.01 * np.abs(clean), np.sqrt(0.5) * shared * np.abs(clean)
    brdf = clean + u_random * random.normal(size=shape)
    of_one_angle, of_all = random.normal(size=(group.max() + 1, wavelengths.size)), random.normal(size=wavelengths.size)
    brdf = brdf + u_reference * (of_one_angle[group] + of_all)
    sources = (
        ErrorSource("random: counts", "random", u_random, None, False),
        ErrorSource("random: counts of the reference", "random", u_reference, group, False),
        ErrorSource("dark: reference", "dark", u_reference, everywhere(THETA_IN.size), False),
    )
    return replace(empty, brdf=brdf, sources=sources)


@pytest.mark.parametrize("truth", [(1.6, 2.3, 0.1), (1.2, 3.4, -0.2), (-0.8, 1.2, 0.5), (0.9, 4.5, 0.0)])
def test_the_cosine_of_the_slopes_is_recovered(truth: tuple[float, float, float]) -> None:
    dataset = made(*truth, p=1.3)
    fit = global_fit(dataset, local_fit(dataset))
    assert fit.verdict.trusted
    for name, value in zip(("h", "w", "t_y", "p"), (*truth, 1.3), strict=True):
        assert abs(fit.value(name) - value) < 4 * fit.standard_error(name)
        assert fit.standard_error(name) < 0.1


def test_no_start_of_another_optimiser_finds_a_better_cosine() -> None:
    dataset = made(1.2, 3.4, 0.1, p=1.0, scatter=0.3)
    local = local_fit(dataset)
    fit = global_fit(dataset, local)
    theta = np.radians(0.5 * np.abs(THETA_OUT - THETA_IN))
    random = np.random.default_rng(1)

    def residual(x: FloatArray) -> FloatArray:
        return (x[0] * np.cos(x[1] * theta) + x[2] - local.slope) / local.u_slope

    lowest = np.inf
    for _ in range(60):
        start = random.uniform([-3, 0.1, -2], [3, 12, 2])
        other = least_squares(residual, start, bounds=([-np.inf, 0.1, -np.inf], [np.inf, 12, np.inf]))
        lowest = min(lowest, 2 * other.cost)
    assert fit.cost_value <= lowest * (1 + 1e-7)


@pytest.mark.slow
@pytest.mark.parametrize("shared", [0.0, 0.02])
def test_stated_errors_are_the_scatter_of_repeated_measurements(shared: float) -> None:
    # `shared` noise of the reference moves the slopes of many points together: stated errors that forget
    # this are too small by a factor of two here
    truth = {"h": 1.5, "w": 2.6, "t_y": 0.1, "p": 1.2}
    z = []
    for seed in range(60):
        dataset = made(**truth, seed=seed, shared=shared)
        fit = global_fit(dataset, local_fit(dataset))
        z.append([(fit.value(name) - value) / fit.standard_error(name) for name, value in truth.items()])
    spread = np.std(z, axis=0)
    assert np.all((spread > 0.7) & (spread < 1.35)), spread


def test_slopes_that_do_not_depend_on_theta_m_are_not_trusted_to_have_a_cosine() -> None:
    untrusted = 0
    for seed in range(8):
        dataset = made(0.0, 1.0, 0.4, p=1.0, seed=seed)
        fit = global_fit(dataset, local_fit(dataset))
        untrusted += not fit.verdict.trusted and any("constant" in reason for reason in fit.verdict.reasons)
    assert untrusted == 8


def test_two_cosines_that_the_directions_cannot_tell_apart_are_both_named() -> None:
    dataset = made(0.6, 8.0, 0.1, p=1.0)
    local = local_fit(dataset)
    # theta_m is a multiple of 20 degrees, where cos(8 theta_m) = cos(10 theta_m)
    regular = np.isclose((THETA_OUT - THETA_IN) % 40, 0)
    fit = global_fit(dataset, replace(local, reliable=local.reliable & regular))
    assert not fit.verdict.trusted
    (reason,) = (reason for reason in fit.verdict.reasons if "minima are as good" in reason)
    found = {round(fit.value("w")), *(int(w) for w in re.findall(r"w = (\d+)", reason))}
    assert {8, 10} <= found
    assert "minima" not in " ".join(global_fit(dataset, local).verdict.reasons)


def test_scatter_beyond_the_noise_widens_the_errors_and_is_said() -> None:
    quiet, scattered = made(1.5, 2.6, 0.1, p=1.0), made(1.5, 2.6, 0.1, p=1.0, scatter=0.3)
    calm, wide = (global_fit(dataset, local_fit(dataset)) for dataset in (quiet, scattered))
    assert wide.standard_error("h") > 3 * calm.standard_error("h")
    assert wide.verdict.trusted
    assert any("Birge" in reason for reason in wide.verdict.reasons)


def test_a_parabola_says_that_h_and_t_y_are_not_separable() -> None:
    dataset = made(-200.0, 0.05, 200.5, p=1.0)
    fit = global_fit(dataset, local_fit(dataset))
    assert not fit.verdict.trusted
    assert any("parabola" in reason for reason in fit.verdict.reasons)
    assert np.all(np.isfinite(fit.fitted))


def test_too_few_slopes_are_refused() -> None:
    dataset = made(1.5, 2.6, 0.1, p=1.0)
    local = local_fit(dataset)
    few = replace(local, reliable=local.reliable & (np.arange(THETA_IN.size) < 3))
    with pytest.raises(FitError, match="Only 3 of"):
        global_fit(dataset, few)


def test_colour_of_a_bench_sample_is_described(measure: Callable[..., Dataset]) -> None:
    dataset = measure(0.364, 1.6, 2.3)
    fit = global_fit(dataset, local_fit(dataset))
    assert fit.verdict.trusted
    assert fit.value("h") == pytest.approx(1.6, abs=0.05)
    assert fit.value("w") == pytest.approx(2.3, abs=0.05)
    assert fit.r2 > 0.98
