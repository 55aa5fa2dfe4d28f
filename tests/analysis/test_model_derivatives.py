"""What the fits follow downhill is the derivative of the model that they evaluate.

Every analytic derivative is compared with the complex step of the value's own function: Im f(p + i e) / e, exact to
rounding for a step of 1e-30 because nothing is subtracted (Squire & Trapp 1998).
"""

from collections.abc import Callable
from typing import Any, get_args

import numpy as np
import pytest

from analysis.choices import Distribution
from analysis.reflectance.directions import Directions, in_plane, round_aperture, through_aperture
from analysis.reflectance.distributions import lobe, lobe_derivative
from analysis.reflectance.fresnel import fresnel_dielectric, fresnel_dielectric_derivative, load_conductor
from analysis.reflectance.models import (
    constant,
    cook_torrance,
    cook_torrance_derivative,
    cosine_slope,
    cosine_slope_derivative,
    dielectric,
    dielectric_derivative,
    microfacet,
    microfacet_derivative,
    theta_m,
)
from analysis.reflectance.two_component import mixed_slope, two_component_slope, two_component_slope_derivative
from drivers.arrays import FloatArray

STEP = 1e-30
WAVELENGTHS = np.linspace(380.0, 990, 7)
_RNG = np.random.default_rng(20)
THETA_IN, THETA_OUT = _RNG.uniform(0, 82, 60), _RNG.uniform(-84, 84, 60)
THETA_OUT[:20] = THETA_IN[:20] + _RNG.normal(0, 1, 20)
DIRECTIONS = in_plane(THETA_IN, THETA_OUT)
APERTURE = round_aperture(1.0)
NODES = through_aperture(THETA_IN, THETA_OUT, APERTURE)
ALUMINIUM = load_conductor()
DISTRIBUTIONS = get_args(Distribution)
ALPHAS = (0.003, 0.05, 0.3, 1.2)


def _by_complex_step(value: Callable[..., FloatArray], parameters: tuple[Any, ...]) -> FloatArray:
    rows = []
    for i, parameter in enumerate(parameters):
        moved: list[Any] = list(parameters)
        moved[i] = parameter + 1j * STEP
        rows.append(np.imag(value(*moved)) / STEP)
    return np.stack(np.broadcast_arrays(*rows))


def _check(
    value: Callable[..., FloatArray],
    derivative: Callable[..., tuple[FloatArray, FloatArray]],
    parameters: tuple[Any, ...],
) -> None:
    found, jacobian = derivative(*parameters)
    np.testing.assert_allclose(found, value(*parameters), rtol=1e-14, atol=1e-300)
    expected = _by_complex_step(value, parameters)
    # where a derivative passes through zero, rounding is measured by what stands around it
    around = np.abs(expected).max(axis=tuple(range(1, expected.ndim)), keepdims=True)
    assert jacobian.shape == expected.shape
    assert np.all(np.abs(jacobian - expected) <= 1e-8 * np.abs(expected) + 1e-13 * around)


@pytest.mark.parametrize("distribution", DISTRIBUTIONS)
@pytest.mark.parametrize("alpha", ALPHAS)
def test_a_fit_of_roughness_goes_downhill(distribution: Distribution, alpha: float) -> None:
    def derivative(alpha: float) -> tuple[FloatArray, FloatArray]:
        value, by_alpha = lobe_derivative(NODES, alpha, distribution)
        return value, by_alpha[None]

    _check(lambda alpha: lobe(NODES, alpha, distribution), derivative, (alpha,))


@pytest.mark.parametrize("eta", [1.0, 1.05, 1.5, 3.0])
def test_a_fit_of_the_refractive_index_goes_downhill(eta: float) -> None:
    def derivative(eta: float) -> tuple[FloatArray, FloatArray]:
        value, by_eta = fresnel_dielectric_derivative(DIRECTIONS.cos_d, eta)
        return value, by_eta[None]

    _check(lambda eta: fresnel_dielectric(DIRECTIONS.cos_d, eta), derivative, (eta,))


@pytest.mark.parametrize("distribution", DISTRIBUTIONS)
@pytest.mark.parametrize("alpha", ALPHAS)
@pytest.mark.parametrize("h", [0.0, 1.2, -2.9], ids=["no shift", "shift", "clamped"])
def test_a_fit_of_a_metal_goes_downhill(distribution: Distribution, alpha: float, h: float) -> None:
    # at h = 0 the value leaves the shift out and does not see a complex w, which has no effect there
    _check(
        lambda a, h, w: cook_torrance(DIRECTIONS, WAVELENGTHS, a, ALUMINIUM, h, w, distribution),
        lambda a, h, w: cook_torrance_derivative(DIRECTIONS, WAVELENGTHS, a, ALUMINIUM, h, w, distribution),
        (alpha, h, 3.4),
    )


@pytest.mark.parametrize("distribution", DISTRIBUTIONS)
@pytest.mark.parametrize("alpha", ALPHAS)
def test_a_fit_of_a_dielectric_goes_downhill(distribution: Distribution, alpha: float) -> None:
    r_d = np.linspace(0.1, 0.8, WAVELENGTHS.size)
    _check(
        lambda a, eta, h, w: dielectric(DIRECTIONS, WAVELENGTHS, a, eta, r_d, h, w, distribution),
        lambda a, eta, h, w: dielectric_derivative(DIRECTIONS, WAVELENGTHS, a, eta, r_d, h, w, distribution),
        (alpha, 1.5, 1.2, 2.7),
    )


@pytest.mark.parametrize("distribution", DISTRIBUTIONS)
@pytest.mark.parametrize("alpha", ALPHAS)
def test_a_fit_through_the_aperture_goes_downhill(distribution: Distribution, alpha: float) -> None:
    cos_d = DIRECTIONS.cos_d[:, None]

    def value(alpha: float, eta: float, *shift: float) -> FloatArray:
        slope = two_component_slope(NODES, *shift)
        fresnel = fresnel_dielectric(cos_d, eta)
        return microfacet(NODES, WAVELENGTHS, alpha, fresnel, slope, distribution, APERTURE.weights)

    def derivative(alpha: float, eta: float, *shift: float) -> tuple[FloatArray, FloatArray]:
        fresnel, by_eta = fresnel_dielectric_derivative(cos_d, eta)
        slope = two_component_slope_derivative(NODES, *shift)
        return microfacet_derivative(
            NODES, WAVELENGTHS, alpha, (fresnel, by_eta[None]), slope, distribution, APERTURE.weights
        )

    _check(value, derivative, (alpha, 1.5, 1.2, 3.0, 0.1, 0.6, 2.0, 0.2))


def test_a_model_without_a_shift_has_no_derivatives_by_one() -> None:
    fresnel = np.ones((THETA_IN.size, 1))
    _check(
        lambda alpha: microfacet(NODES, WAVELENGTHS, alpha, fresnel, weights=APERTURE.weights),
        lambda alpha: microfacet_derivative(
            NODES, WAVELENGTHS, alpha, constant(fresnel), constant(np.zeros_like(NODES.cos_m)), weights=APERTURE.weights
        ),
        (0.2,),
    )


@pytest.mark.parametrize("sharpness", [0.0, 1e-4, 1e-3, 0.8, 40.0, 3e3])
@pytest.mark.parametrize("kappa", [0.0, 1.3])
def test_a_fit_of_two_components_goes_downhill(sharpness: float, kappa: float) -> None:
    def value(*p: Any) -> FloatArray:
        return two_component_slope(DIRECTIONS, *p)

    parameters = (1.2, 2.2, 0.1, kappa, sharpness, 0.3)
    _check(value, lambda *p: two_component_slope_derivative(DIRECTIONS, *p), parameters)


def test_slopes_given_with_their_share_are_linear() -> None:
    share = np.linspace(0, 1, 11)
    jacobian = _by_complex_step(lambda *m: mixed_slope(share, *m), (0.8, -0.5))
    np.testing.assert_allclose(jacobian, [1 - share, share])


def test_a_fit_of_one_cosine_goes_downhill() -> None:
    angle = theta_m(DIRECTIONS)
    _check(lambda *p: cosine_slope(angle, *p), lambda *p: cosine_slope_derivative(angle, *p), (1.2, 3.4, 0.2))


def test_directions_of_any_shape_keep_it() -> None:
    grid = Directions(*(cosine.reshape(3, 4, 5) for cosine in DIRECTIONS))
    value, jacobian = cook_torrance_derivative(grid, WAVELENGTHS, 0.2, ALUMINIUM, 1.2, 3.4)
    assert value.shape == (3, 4, 5, 7)
    assert jacobian.shape == (3, 3, 4, 5, 7)
    flat = cook_torrance_derivative(DIRECTIONS, WAVELENGTHS, 0.2, ALUMINIUM, 1.2, 3.4)[1]
    np.testing.assert_array_equal(jacobian.reshape(3, 60, 7), flat)
