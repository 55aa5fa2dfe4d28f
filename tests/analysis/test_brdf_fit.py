"""Cook-Torrance and its shift are recovered through aperture, noise and stage errors, or said not to be."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from analysis.choices import Distribution, Engine
from analysis.errors import FitError, OutOfRange
from analysis.fits.brdf_fit import brdf_fit
from analysis.reflectance.distributions import lobe_width, ndf
from goniometer.datasets.dataset import Dataset, Flag

Measure = Callable[..., Dataset]
SAMPLES = {
    1: (0.364, 1.6, 2.3),
    2: (0.280, 1.5, 2.6),
    3: (0.209, 1.35, 3.0),
    4: (0.180, 1.2, 3.4),
    5: (0.113, 0.9, 4.5),
}


def z_scores(dataset: Dataset, truth: tuple[float, float, float]) -> list[float]:
    fit = brdf_fit(dataset)
    return [(p.value - value) / p.standard_error for p, value in zip(fit.parameters, truth, strict=True)]


@pytest.mark.parametrize("sample", SAMPLES)
def test_the_samples_of_the_bench_are_recovered_and_trusted(measure: Measure, sample: int) -> None:
    dataset = measure(*SAMPLES[sample], seed=sample)
    fit = brdf_fit(dataset)
    assert fit.verdict.trusted
    assert fit.verdict.reasons == ()
    assert fit.r2 > 0.999
    assert np.all(np.abs(z_scores(dataset, SAMPLES[sample])) < 4)
    plain = brdf_fit(dataset, "cook-torrance")
    assert plain.verdict.trusted
    assert plain.cost_value > 10 * fit.cost_value
    assert any("does not describe everything" in reason for reason in plain.verdict.reasons)


@pytest.mark.slow
@pytest.mark.parametrize(("sample", "noise"), [(1, 1e-3), (4, 3e-3), (4, 1e-2)])
def test_stated_errors_are_the_scatter_of_repeated_measurements(measure: Measure, sample: int, noise: float) -> None:
    truth = SAMPLES[sample]
    z = np.array([z_scores(measure(*truth, seed=seed, noise=noise), truth) for seed in range(30)])
    assert np.all(np.abs(z) < 4)
    spread = np.sqrt(np.mean(z**2, axis=0))
    # the root mean square of 30 z-scores lies within 0.65 and 1.35 in more than 99 % of all cases
    assert np.all((spread > 0.65) & (spread < 1.35)), spread


@pytest.mark.parametrize("sample", [1, 4])
def test_stated_errors_are_honest_where_points_and_wavelengths_share_their_errors(
    measure: Measure, sample: int
) -> None:
    # few points and wavelengths do: what all of them share does not average out over more
    truth, z, forgetful = SAMPLES[sample], [], []
    for seed in range(25):
        dataset = measure(*truth, seed=seed, systematic=True, incident=(10, 40, 70), wavelength_step=23.0)
        z.append(z_scores(dataset, truth))
        of_counts = tuple(source for source in dataset.sources if not source.shared_by_wavelengths)
        unaware = brdf_fit(replace(dataset, sources=of_counts, u_zero=0.0))
        # but for what it notices in its residuals
        stated = [
            np.hypot.reduce([u for part, u in p.error_by_part.items() if part != "model"]) for p in unaware.parameters
        ]
        forgetful.append([(p.value - t) / u for p, t, u in zip(unaware.parameters, truth, stated, strict=True)])
    spread = np.sqrt(np.mean(np.square(z), axis=0))
    # the root mean square of 25 z-scores lies within 0.6 and 1.4 in more than 99 % of all cases
    assert np.all((spread > 0.6) & (spread < 1.4)), spread
    # whoever counts the noise alone states errors that are several times too small
    assert np.all(np.sqrt(np.mean(np.square(forgetful), axis=0)) > 2.5)


def test_errors_of_the_zeros_are_as_large_as_stated_though_all_points_share_them(measure: Measure) -> None:
    z = []
    for seed in range(20):
        # ten times the usual zero errors and hardly any noise, so that nothing else matters
        dataset = measure(
            *SAMPLES[4], seed=seed, noise=1e-5, reference=0.0, incident=(10, 40, 70), wavelength_step=46.0
        )
        sample, detector = np.random.default_rng(seed).normal(0, 0.1, 2)
        theta_in, theta_out = dataset.theta_in - sample, dataset.theta_out + sample - detector
        z.append(z_scores(replace(dataset, theta_in=theta_in, theta_out=theta_out, u_zero=0.1), SAMPLES[4]))
    spread = np.sqrt(np.mean(np.square(z), axis=0))
    assert np.all((spread > 0.55) & (spread < 1.45)), spread


def test_the_parts_of_a_standard_error_make_up_the_whole(measure: Measure) -> None:
    dataset = measure(*SAMPLES[4], systematic=True, wavelength_step=23.0)
    # without a shift the model leaves the colours, and says so
    for fit, beyond in ((brdf_fit(dataset, "cook-torrance"), {"model"}), (brdf_fit(dataset), set())):
        for parameter in fit.parameters:
            assert set(parameter.error_by_part) == beyond | {
                "random", "dark", "reference", "non-linearity", "angle", "wavelength", "drift", "stray light",
            }  # fmt: skip
            whole = np.sqrt(np.sum(np.square(list(parameter.error_by_part.values()))))
            assert whole == pytest.approx(parameter.standard_error, rel=1e-9)


@pytest.mark.parametrize("alpha", [0.003, 0.01, 0.02, 0.05, 0.1, 0.6])
def test_no_roughness_is_missed_for_want_of_a_good_start(measure: Measure, alpha: float) -> None:
    wide = (16, 40) if alpha < 0.05 else (5, 14)
    dataset = measure(alpha, 0.9, 4.0, noise=1e-4, reference=0.0, floor=1e-8, rule=wide, incident=(0, 20, 40))
    assert brdf_fit(dataset).value("alpha") == pytest.approx(alpha, rel=0.01)


def test_no_shift_of_a_narrow_lobe_is_missed_for_want_of_a_good_start(measure: Measure) -> None:
    # between two roughnesses of the scan the lobe's misfit is larger than the whole shift
    fit = brdf_fit(measure(0.03, -1.0, 8.0, wavelength_step=46.0, incident=(0, 20, 40, 60)))
    assert fit.value("h") == pytest.approx(-1, abs=4 * fit.standard_error("h"))
    assert fit.value("w") == pytest.approx(8, abs=4 * fit.standard_error("w"))


@pytest.mark.parametrize("engine", ["fast", "lmfit"])
@pytest.mark.parametrize("sample", SAMPLES)
def test_a_shift_is_found_where_all_wavelengths_lie_beyond_that_at_which_it_is_one(
    measure: Measure, sample: int, engine: Engine
) -> None:
    whole = measure(*SAMPLES[sample], seed=sample)
    red = whole.wavelengths > 625
    dataset = replace(
        whole,
        wavelengths=whole.wavelengths[red],
        brdf=whole.brdf[:, red],
        sources=tuple(replace(source, values=source.values[:, red]) for source in whole.sources),
    )
    fit = brdf_fit(dataset, engine=engine)
    for found, truth in zip(fit.parameters, SAMPLES[sample], strict=True):
        assert found.value == pytest.approx(truth, rel=0.1)


@pytest.fixture(scope="module")
def mirror(measure: Measure) -> Dataset:
    """Sample 6, measured with a rule that is fine enough for its lobe."""
    return measure(0.0045, rule=(16, 40), wavelength_step=23.0)


def test_a_mirror_seen_through_its_aperture_is_not_trusted(mirror: Dataset) -> None:
    fit = brdf_fit(mirror, "cook-torrance")
    assert not fit.verdict.trusted
    assert any("aperture" in reason and "of a zero" in reason for reason in fit.verdict.reasons)
    assert fit.value("alpha") == pytest.approx(0.0045, rel=0.02)
    assert fit.standard_error("alpha") < 0.02 * fit.value("alpha")


def test_the_shift_of_a_mirror_is_said_to_be_none(mirror: Dataset) -> None:
    fit = brdf_fit(mirror)
    assert not fit.verdict.trusted
    assert any("compatible with zero" in reason for reason in fit.verdict.reasons)
    assert fit.value("w") == 0
    assert np.isinf(fit.standard_error("w"))
    np.testing.assert_array_equal(fit.correlation[2], [0, 0, 1])
    assert abs(fit.value("h")) < 4 * fit.standard_error("h")


def test_a_rough_surface_without_shift_is_not_given_one(measure: Measure) -> None:
    for seed in range(5):
        dataset = measure(0.25, seed=seed, wavelength_step=23.0)
        fit = brdf_fit(dataset)
        assert not fit.verdict.trusted
        assert fit.value("alpha") == pytest.approx(0.25, rel=1e-3)
        assert brdf_fit(dataset, "cook-torrance").verdict.trusted


def test_saturated_points_are_left_out_and_counted(measure: Measure) -> None:
    dataset = measure(*SAMPLES[4])
    saturated = np.abs(dataset.theta_out - dataset.theta_in) < 3
    spoilt = np.where(saturated[:, None], 0.1, dataset.brdf)
    flags = np.where(saturated, Flag.SATURATED, 0).astype(np.uint16)
    fit = brdf_fit(replace(dataset, brdf=spoilt, flags=flags))
    assert fit.value("alpha") == pytest.approx(0.18, rel=1e-3)
    assert any(reason.startswith(f"{saturated.sum()} of") for reason in fit.verdict.reasons)
    assert fit.fitted.shape == dataset.brdf.shape


def test_the_cost_is_that_of_the_fitted_values(measure: Measure) -> None:
    dataset = measure(*SAMPLES[3])
    cos_in = np.cos(np.radians(dataset.theta_in))[:, None]
    for fit in (brdf_fit(dataset, "cook-torrance"), brdf_fit(dataset)):
        residual = np.log1p(cos_in * fit.fitted) - np.log1p(cos_in * dataset.brdf)
        assert fit.cost == "loew"
        assert fit.cost_value == pytest.approx(np.sum(residual**2), rel=1e-9)


def test_weights_change_the_name_of_the_cost_and_not_the_answer(measure: Measure) -> None:
    fit = brdf_fit(measure(*SAMPLES[2]), weight="uncertainty")
    assert "uncertainty" in fit.cost
    assert fit.value("alpha") == pytest.approx(0.28, rel=2e-3)
    assert abs(fit.value("h") - 1.5) < 4 * fit.standard_error("h")


def test_noise_far_below_zero_does_not_break_the_logarithm(measure: Measure) -> None:
    dataset = measure(*SAMPLES[5])
    brdf = dataset.brdf.copy()
    brdf[::40, ::10] = -50.0
    brdf[5, 3:9] = np.nan
    assert brdf_fit(replace(dataset, brdf=brdf)).value("alpha") == pytest.approx(0.113, rel=0.1)


def test_a_signal_drowned_in_noise_is_not_trusted(measure: Measure) -> None:
    fit = brdf_fit(measure(0.02, floor=30.0, wavelength_step=23.0), "cook-torrance")
    assert any("above the noise" in reason for reason in fit.verdict.reasons)


def test_wavelengths_beyond_the_metal_and_too_few_points_are_refused(measure: Measure) -> None:
    dataset = measure(*SAMPLES[1], incident=(0,))
    with pytest.raises(OutOfRange):
        brdf_fit(replace(dataset, wavelengths=dataset.wavelengths + 100))
    with pytest.raises(FitError, match="left out of all fits: footprint leaves the sample"):
        brdf_fit(replace(dataset, flags=np.full_like(dataset.flags, Flag.CLIPPED)), "cook-torrance")


@pytest.mark.parametrize("distribution", ["ggx", "beckmann"])
@pytest.mark.parametrize("alpha", [0.0045, 0.1, 0.4])
def test_lobe_width_is_where_the_distribution_halves(alpha: float, distribution: Distribution) -> None:
    half_angle = np.radians(lobe_width(alpha, distribution) / 4)
    ratio = ndf(np.array([np.cos(half_angle)]), alpha, distribution) / ndf(np.array([1.0]), alpha, distribution)
    assert ratio[0] == pytest.approx(0.5, abs=1e-9)
