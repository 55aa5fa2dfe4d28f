"""The interpolation is judged by dense textbook formulas, by leaving points out for real, and by known materials."""

import dataclasses

import colour
import numpy as np
import pytest
from scipy.optimize import approx_fprime
from scipy.special import gamma, kv

from analysis.colour import xyz_weights
from analysis.reflectance.directions import in_plane
from analysis.reflectance.fresnel import load_conductor
from analysis.reflectance.models import cook_torrance
from drivers.arrays import FloatArray
from goniometer.datasets.between import interpolate
from goniometer.datasets.dataset import Dataset, Flag
from goniometer.errors import CalibrationError
from goniometer.interpolation.interpolant import Shape, condition, latent, learn, predict, predict_values
from goniometer.interpolation.kernel import (
    Scales,
    _free,
    _negative_log_likelihood,
    _scales,
    coordinates,
    covariance,
    fit_scales,
    matern,
    variance,
)
from goniometer.interpolation.lobe import Bump, Lobe, _cosine_brdf, _slopes, fit_lobe
from goniometer.plans.colour_error import band_colours, colour_slopes
from goniometer.uncertainty import ErrorSource

BANDS = np.array([450.0, 550.0, 650.0, 800.0])
THETA_IN = (0.0, 20.0, 40.0, 60.0)
LOBE = Lobe(1.0, 0.1, 2.0, -3.0, 0.2, (Bump(-2.0, 12.0, 2.0, 3.0),), -2.5, 7.0)
SCALES = Scales(1.3, 50.0, 35.0, 0.4, 0.7)


def directions(count: int, seed: int = 0) -> tuple[FloatArray, FloatArray]:
    random = np.random.default_rng(seed)
    theta_in = random.choice(THETA_IN, count)
    theta_out = random.uniform(-80, 80, count)
    return theta_in, np.where(np.abs(theta_in + theta_out) < 5, theta_out + 11, theta_out)


def spread_out():
    """Ten directions at each of `THETA_IN`: both ends, evenly between, and near the mirror direction."""
    return np.concatenate([[-80.0, -55, -32, -8, 16, 45, 80, t - 4, t, t + 7] for t in THETA_IN])


def metal(theta_in, theta_out, alpha=0.15, wavelengths=BANDS):
    brdf = cook_torrance(in_plane(theta_in, theta_out), wavelengths, alpha, load_conductor(), 0.9, 4.0)
    return brdf * np.cos(np.radians(theta_in))[:, None]


def textbook_covariance(a, b):
    """By the general Matern formula and explicit reflections, entry by entry."""

    def smooth(x):
        r = np.sqrt(5) * abs(x)
        return 1.0 if r == 0 else 2 ** (1 - 2.5) / gamma(2.5) * r**2.5 * kv(2.5, r)

    def place(theta_in, theta_out):
        h = (theta_out - theta_in) / 2 - LOBE.tilt
        u = np.arcsinh(h / LOBE.half_width)
        u += 0.5 * (np.arcsinh((h - 12.0) / 2.0) + np.arcsinh((h + 12.0) / 2.0))
        return u / SCALES.warp + h / SCALES.cap, (theta_out + theta_in) / 2 / SCALES.along

    K = np.empty((len(a[0]), len(b[0])))
    for i, p in enumerate(zip(*a, strict=True)):
        for j, q in enumerate(zip(*b, strict=True)):
            (u, d), (v, e) = place(*p), place(*q)
            same = smooth(u - v) * smooth(d - e)
            reflected = sum(smooth(u - s * v) * smooth(d - t * e) for s in (1, -1) for t in (1, -1))
            K[i, j] = SCALES.amplitude**2 * ((1 - SCALES.symmetry) * same + SCALES.symmetry * reflected)
    return K


def textbook_doubt(theta_in, theta_out):
    """What each parameter of the lobe changes, by central differences of the lobe itself; [points, parameters]."""

    def level(lobe):
        return np.log(1e-4 + lobe.cosine_brdf(theta_in, theta_out))

    def change(vary, off):
        return off * (level(vary(1e-4)) - level(vary(-1e-4))) / 2e-4

    def main(name, relative=False):
        old = getattr(LOBE, name)
        return lambda x: dataclasses.replace(LOBE, **{name: old * np.exp(x) if relative else old + x})

    def bump(name, relative=False):
        old = getattr(LOBE.bumps[0], name)
        new = (lambda x: old * np.exp(x)) if relative else (lambda x: old + x)
        return lambda x: dataclasses.replace(LOBE, bumps=(dataclasses.replace(LOBE.bumps[0], **{name: new(x)}),))

    columns = [
        change(main("log_height"), 1.0),
        change(main("alpha", relative=True), 0.3),
        change(main("gamma"), 0.7),
        change(main("log_floor"), 1.0),
        change(main("tilt"), 0.3),
        change(main("log_retro"), 1.0),
        change(main("retro_width", relative=True), 0.3),
        change(bump("log_height"), 0.7),
        change(bump("centre"), 0.3 * LOBE.bumps[0].width),
        change(bump("width", relative=True), 0.3),
        change(bump("exponent", relative=True), 0.5),
    ]
    return np.stack(columns, axis=1)


def test_the_covariance_is_the_matern_of_smoothness_five_halves_with_its_reflections():
    a, b = directions(12), directions(9, seed=1)
    at, other = coordinates(*a, LOBE), coordinates(*b, LOBE)
    assert covariance(at, other, SCALES) == pytest.approx(textbook_covariance(a, b), rel=1e-9)
    assert variance(at, SCALES) == pytest.approx(np.diag(textbook_covariance(a, a)), rel=1e-9)
    assert matern(np.array([0.0, 1.0])) == pytest.approx([1.0, 0.5239941], rel=1e-6)


def test_the_prediction_is_that_of_a_gaussian_process_by_the_dense_formula():
    a, b = directions(30), directions(8, seed=1)
    values = metal(*a)
    noise = 0.01 * values
    process = condition(Shape(LOBE, SCALES, 1e-4), *a, values, noise)
    told = predict(process, *b)
    F, G = textbook_doubt(*a), textbook_doubt(*b)
    K = textbook_covariance(a, a) + F @ F.T
    K += np.diag(0.01**2 * np.median(values / (1e-4 + values), axis=1) ** 2)
    k, prior = textbook_covariance(a, b) + F @ G.T, np.diag(textbook_covariance(b, b) + G @ G.T)
    left = np.log(1e-4 + values) - np.log(1e-4 + LOBE.cosine_brdf(*a))[:, None]
    expected = np.log(1e-4 + LOBE.cosine_brdf(*b))[:, None] + k.T @ np.linalg.inv(K) @ left
    assert told.latent == pytest.approx(expected, rel=1e-3, abs=1e-3)
    assert told.sigma**2 == pytest.approx(prior - np.diag(k.T @ np.linalg.inv(K) @ k), rel=1e-2, abs=1e-5)


def test_the_leave_one_out_scores_are_those_of_leaving_points_out_for_real():
    a = directions(25)
    values = metal(*a)
    shape = Shape(LOBE, SCALES, 1e-4)
    process = condition(shape, *a, values, 0.02 * values)
    for i in (0, 7, 20):
        rest = np.arange(25) != i
        without = condition(shape, a[0][rest], a[1][rest], values[rest], 0.02 * values[rest])
        told = predict(without, a[0][i : i + 1], a[1][i : i + 1])
        variance_there = told.sigma[0] ** 2 + process.noise[i] ** 2
        z2 = (latent(values[i : i + 1], 1e-4) - told.latent) ** 2 / variance_there / np.diag(process.spread)
        assert process.scores[i] == pytest.approx(z2.mean(), rel=2e-3)


def test_the_gradient_of_the_likelihood_is_its_derivative():
    a = directions(20)
    at = coordinates(*a, LOBE)
    residual, noise = np.random.default_rng(1).normal(size=20), np.full(20, 0.05)
    doubt = textbook_doubt(*a)

    def cost(x):
        return _negative_log_likelihood(at, residual, noise, doubt, _scales(x))[0]

    x = _free(SCALES)
    _, gradient = _negative_log_likelihood(at, residual, noise, doubt, _scales(x))
    assert gradient == pytest.approx(approx_fprime(x, cost, 1e-6), rel=1e-3, abs=1e-3)


def test_the_slopes_of_the_lobes_are_their_derivatives():
    theta_in, theta_out = directions(40)
    parameters = np.array([1.0, -1.5, 2.3, -4.0, 0.7, -3.0, 1.5, 0.5, 20.0, 1.0, 1.2, -1.0, -30.0, 2.0, 0.8])
    steps = 1e-6 * np.maximum(1, np.abs(parameters)) * np.eye(parameters.size)
    up, down = ([_cosine_brdf(parameters + s * step, theta_in, theta_out) for step in steps] for s in (1, -1))
    differences = np.transpose((np.array(up) - down) / (2 * np.diag(steps)[:, None]))
    wrong = np.abs(_slopes(parameters, theta_in, theta_out) - differences)
    assert np.all(wrong < 1e-7 * np.abs(differences).max(axis=0))


@pytest.mark.parametrize("alpha", [0.02, 0.1, 0.35])
def test_roughness_and_tilt_are_found_from_few_points_of_all_incident_angles(alpha):
    theta_in = np.repeat(THETA_IN, 9)
    theta_out = np.clip(theta_in + np.tile([-70.0, -30, -8, -2, 0, 1, 4, 12, 25], 4), -84, 84)
    values = metal(theta_in - 0.3, theta_out + 0.3, alpha).mean(axis=1)  # a normal that leans by 0.3 degrees
    lobe = fit_lobe(theta_in, theta_out, np.log(1e-4 + values), np.full(values.size, 1e-3), 1e-4)
    assert lobe.alpha == pytest.approx(alpha, rel=0.15)
    assert lobe.tilt == pytest.approx(-0.3, abs=0.05)


def test_a_retro_reflection_is_found_beside_the_lobe():
    theta_in = np.repeat(THETA_IN, 10)
    theta_out = spread_out()
    away = ((theta_in + theta_out) / 2 / 6.0) ** 2
    retro = 0.3 * (1 + (2**0.25 - 1) * away) ** -4 * np.cos(np.radians(theta_in))
    values = metal(theta_in, theta_out).mean(axis=1) + retro
    lobe = fit_lobe(theta_in, theta_out, np.log(1e-4 + values), np.full(values.size, 1e-3), 1e-4)
    assert np.exp(lobe.log_retro) == pytest.approx(0.3, rel=0.1)
    assert lobe.retro_width == pytest.approx(6.0, rel=0.1)


def test_values_between_points_are_right_within_their_uncertainty():
    random = np.random.default_rng(2)
    theta_in = np.repeat(THETA_IN, 10)
    theta_out = spread_out()
    values = metal(theta_in, theta_out)
    noisy = values * (1 + 0.003 * random.normal(size=values.shape))
    process = condition(learn(theta_in, theta_out, noisy, 0.003 * values), theta_in, theta_out, noisy, 0.003 * values)
    at = np.repeat(THETA_IN, 60), np.tile(np.linspace(-70, 80, 60), 4)
    read, u = predict_values(process, *at)
    truth = metal(*at)
    assert np.sqrt(np.mean(((read - truth) / u) ** 2)) < 1.8
    assert np.sqrt(np.mean((np.log1p(read) - np.log1p(truth)) ** 2)) < 0.004


def test_a_lopsided_sheet_is_not_taken_for_a_symmetric_one():
    random = np.random.default_rng(3)
    theta_in, theta_out = directions(90)
    at = coordinates(theta_in, theta_out, dataclasses.replace(LOBE, bumps=()))
    noise = np.full(90, 0.002)
    for ripple, symmetric in ((np.cos(at.linear / 8), True), (np.sin(at.linear / 8), False)):
        residual = 0.2 * ripple + noise * random.normal(size=90)
        assert (fit_scales(at, residual, noise, np.zeros((90, 1)), Scales(), steps=40).symmetry > 0.7) == symmetric


def test_small_colour_errors_are_those_of_ciede2000():
    values = np.array([[0.2, 0.21, 0.23, 0.3], [3.0, 2.9, 2.7, 2.0], [0.004, 0.004, 0.0041, 0.004]])
    weights = band_colours(4)
    white = colour.XYZ_to_xy(weights.sum(axis=0))
    for change in (np.array([1.0, 1, 1, 1]), np.array([1.0, 0, -1, 0]), np.array([0.0, 1, 0, 1])):
        step = 1e-3 * values * change
        before, after = (colour.XYZ_to_Lab(v @ weights, white) for v in (values, values + step))
        expected = colour.delta_E(before, after, method="CIE 2000")
        found = np.linalg.norm(np.einsum("pab,pb->pa", colour_slopes(values), step), axis=1)
        assert found == pytest.approx(expected, rel=0.12)


def test_band_colours_are_those_of_a_spectrum_that_is_linear_between_the_bands():
    grid = np.arange(400.0, 701.0)
    for spectrum in ([1.0, 1.0, 1.0], [0.2, 0.5, 0.9]):
        full = np.interp(grid, [450.0, 550.0, 650.0], spectrum) @ xyz_weights(grid)
        assert np.array([*spectrum, 7.0]) @ band_colours(4) == pytest.approx(full, rel=2e-3)
    assert np.array([1.0]) @ band_colours(1) == pytest.approx(np.ones(3) @ band_colours(3))


def dataset(theta_in, theta_out, wavelengths, missing=()):
    brdf = metal(theta_in, theta_out, wavelengths=wavelengths) / np.cos(np.radians(theta_in))[:, None]
    for point, wavelength in missing:
        brdf[point, wavelength] = np.nan
    source = ErrorSource("shot noise", "counts", 0.004 * np.nan_to_num(brdf), None, False)
    flags = np.zeros(theta_in.size, dtype=np.uint16)
    return Dataset("s", theta_in, theta_out, wavelengths, brdf, (source,), flags, 0.01, 0.01, 1.0)


def test_a_dataset_is_read_between_its_points_at_all_wavelengths_and_says_how_well():
    theta_in = np.repeat(THETA_IN, 10)
    theta_out = spread_out()
    wavelengths = np.linspace(400, 900, 26)
    data = dataset(theta_in, theta_out, wavelengths, missing=[(5, 3), (17, 3), (30, 20)])
    at = np.array([10.0, 25.0, 50.0]), np.array([15.0, 27.0, -30.0])
    found = interpolate(data, *at)
    truth = metal(*at, wavelengths=wavelengths) / np.cos(np.radians(at[0]))[:, None]
    assert found.brdf == pytest.approx(truth, rel=0.03)
    assert np.sqrt(np.mean(((found.brdf - truth) / found.u) ** 2)) < 2.5
    # a point that has no value tells nothing, but all others do
    assert np.all(found.u[:, 3] > 0)


def test_a_dataset_with_too_few_points_is_refused_in_one_sentence():
    data = dataset(np.zeros(6), np.linspace(10, 60, 6), np.array([500.0, 600.0]))
    with pytest.raises(CalibrationError, match="has 6 usable points; an interpolation needs 8"):
        interpolate(data, np.zeros(1), np.zeros(1))
    flagged = dataset(np.zeros(12), np.linspace(10, 60, 12), np.array([500.0, 600.0]))
    flags = flagged.flags.copy()
    flags[:6] = int(Flag.SATURATED)
    with pytest.raises(CalibrationError, match="has 6 usable points"):
        interpolate(dataclasses.replace(flagged, flags=flags), np.zeros(1), np.zeros(1))
