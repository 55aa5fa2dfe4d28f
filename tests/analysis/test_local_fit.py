"""The local fit finds what lmfit finds, and knows how well."""

from collections.abc import Callable
from dataclasses import replace

import lmfit
import numpy as np
import pytest

from analysis.errors import FitError, OutOfRange
from analysis.fits.local_fit import local_fit, local_gain
from analysis.reflectance.fresnel import fresnel_conductor, load_conductor
from goniometer.datasets.dataset import Dataset, Flag
from goniometer.uncertainty import ErrorSource


def made(slope: np.ndarray, exponent: np.ndarray, scale: np.ndarray, noise: float, seed: int = 3) -> Dataset:
    """Spectra of Eq. 2 with relative noise, all at 40 degrees."""
    random = np.random.default_rng(seed)
    wavelengths = np.arange(382.0, 998.0, 4.6)
    n, k = load_conductor().index(np.append(wavelengths, 600.0))
    fresnel = fresnel_conductor(np.array(np.cos(np.radians(40.0))), n, k)
    ratio = fresnel[:-1] / fresnel[-1]
    brdf = scale[:, None] * (1 + slope[:, None] * (wavelengths - 600) * 1e-3) * ratio ** exponent[:, None]
    u = noise * np.abs(brdf) * (1 + 0.5 * np.sin(wavelengths / 40))
    points = slope.size
    return Dataset(
        sample="made",
        theta_in=np.full(points, 40.0),
        theta_out=np.linspace(-60, 60, points),
        wavelengths=wavelengths,
        brdf=brdf + u * random.normal(size=brdf.shape),
        sources=(
            ErrorSource("random: counts", "random", 0.8 * u, None, False),
            ErrorSource("dark", "dark", 0.6 * u, np.zeros(points, dtype=np.intp), False),
        ),
        flags=np.zeros(points, dtype=np.uint16),
        u_angle=0.005,
        u_zero=0.01,
        aperture=1.0,
    )


def by_lmfit(dataset: Dataset, point: int) -> tuple[float, float, float, float]:
    """Slope, its standard error, exponent and scale of one spectrum."""
    n, k = load_conductor().index(np.append(dataset.wavelengths, 600.0))
    fresnel = fresnel_conductor(np.cos(np.radians(dataset.theta_in[point])), n, k)
    ratio, x = fresnel[:-1] / fresnel[-1], (dataset.wavelengths - 600) * 1e-3
    valid = np.isfinite(dataset.brdf[point])

    def residual(p: lmfit.Parameters) -> np.ndarray:
        model = p["a"].value * (1 + p["m"].value * x) * ratio ** p["p"].value
        return ((dataset.brdf[point] - model) / dataset.u_counts[point])[valid]

    parameters = lmfit.create_params(a=float(np.nanmedian(dataset.brdf[point])), m=0.0, p=1.0)
    tight = {"ftol": 1e-15, "xtol": 1e-15, "gtol": 1e-15}
    result = lmfit.minimize(residual, parameters, scale_covar=False, **tight)
    best = result.params
    return best["m"].value, best["m"].stderr, best["p"].value, best["a"].value


def test_slopes_and_their_errors_equal_those_of_lmfit_spectrum_by_spectrum() -> None:
    random = np.random.default_rng(1)
    dataset = made(random.uniform(-2, 2, 25), random.uniform(-1, 4, 25), 10 ** random.uniform(-3, 2, 25), 0.01)
    brdf = dataset.brdf.copy()
    brdf[3, 20:40] = np.nan
    dataset = replace(dataset, brdf=brdf)
    fit = local_fit(dataset)
    assert fit.reliable.all()
    for point in range(25):
        slope, error, exponent, scale = by_lmfit(dataset, point)
        assert fit.slope[point] == pytest.approx(slope, abs=1e-6)
        assert fit.u_slope[point] == pytest.approx(error, rel=1e-3)
        assert fit.exponent[point] == pytest.approx(exponent, abs=1e-5)
        assert fit.scale[point] == pytest.approx(scale, rel=1e-6)


def test_stated_uncertainty_of_the_slope_is_the_scatter_of_repeated_measurements() -> None:
    many = np.ones(600)
    fit = local_fit(made(1.5 * many, 2 * many, 0.3 * many, 0.02))
    z = (fit.slope - 1.5) / fit.u_slope
    assert z.mean() == pytest.approx(0, abs=4 / np.sqrt(600))
    assert z.std() == pytest.approx(1, abs=4 / np.sqrt(1200))


def test_an_error_that_wavelengths_share_moves_the_slope_as_its_uncertainty_says() -> None:
    # a certificate that is wrong by 2 %/um tilts every spectrum by 0.02 /um, whatever its own slope is
    dataset = made(np.array([0.0, 1.0]), np.array([1.0, 1.0]), np.ones(2), 1e-6)
    tilt = 0.02 * (dataset.wavelengths - 600) * 1e-3 * dataset.brdf
    scale = 0.1 * dataset.brdf  # and an error of the scale leaves them alone
    shared = tuple(
        ErrorSource(name, "reference", values, np.zeros(2, dtype=np.intp), True)
        for name, values in (("tilt", tilt), ("scale", scale))
    )
    fit = local_fit(replace(dataset, sources=dataset.sources + shared))
    tilted = local_fit(replace(dataset, brdf=dataset.brdf + tilt, sources=dataset.sources + shared))
    assert fit.u_slope[0] == pytest.approx(0.02, rel=1e-3)
    np.testing.assert_allclose(fit.u_slope, np.abs(tilted.slope - fit.slope), rtol=0.02)


def test_noise_free_spectra_are_reproduced() -> None:
    slope, exponent = np.array([-2.0, -0.5, 0, 1.4]), np.array([1.0, 3.0, 0.5, 6])
    fit = local_fit(made(slope, exponent, np.array([0.01, 1, 30, 0.3]), 1e-9))
    np.testing.assert_allclose(fit.slope, slope, atol=1e-7)
    np.testing.assert_allclose(fit.exponent, exponent, atol=1e-6)
    np.testing.assert_allclose(fit.r2, 1, atol=1e-9)


def test_spectra_that_cannot_be_trusted_are_masked() -> None:
    dataset = made(np.ones(6), np.array([1.0, 1, 1, 1, 20, 1]), np.ones(6), 0.01)
    brdf, noise, flags = dataset.brdf.copy(), dataset.u_counts.copy(), dataset.flags.copy()
    noise[1] = 3.0  # signal below the noise
    brdf[2, 3:] = np.nan  # hardly anything left
    flags[3] = Flag.SATURATED
    sources = (ErrorSource("random: counts", "random", noise, None, False),)
    fit = local_fit(replace(dataset, brdf=brdf, sources=sources, flags=flags))
    np.testing.assert_array_equal(fit.reliable, [True, False, False, False, False, True])
    assert fit.exponent[4] == 15
    assert np.isnan(fit.slope[2])


def test_pure_noise_is_survived_and_masked() -> None:
    dataset = made(np.zeros(200), np.ones(200), np.ones(200), 0.01)
    noise = np.random.default_rng(5).normal(size=dataset.brdf.shape)
    sources = (ErrorSource("random: counts", "random", np.ones_like(noise), None, False),)
    fit = local_fit(replace(dataset, brdf=noise, sources=sources))
    assert not fit.reliable.any()


def test_gain_is_how_the_slope_answers_to_each_value() -> None:
    dataset = made(np.array([1.2, -0.7, 0.3]), np.array([1.0, 2, 1.5]), np.array([1.0, 0.1, 5]), 0.01)
    fit = local_fit(dataset)
    gain = local_gain(dataset, fit, load_conductor())
    change = 1e-5 * dataset.brdf * np.random.default_rng(2).normal(size=dataset.brdf.shape)
    moved = local_fit(replace(dataset, brdf=dataset.brdf + change))
    np.testing.assert_allclose(moved.slope - fit.slope, (gain[0] * change).sum(axis=1), rtol=0.05)


def test_a_dataset_without_uncertainties_is_refused() -> None:
    dataset = made(np.ones(3), np.ones(3), np.ones(3), 0.01)
    with pytest.raises(FitError, match="uncertainty"):
        local_fit(replace(dataset, sources=()))


def test_wavelengths_beyond_the_metal_are_refused(measure: Callable[..., Dataset]) -> None:
    dataset = measure(0.3, incident=(0,))
    with pytest.raises(OutOfRange):
        local_fit(replace(dataset, wavelengths=dataset.wavelengths + 100))
