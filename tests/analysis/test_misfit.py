"""A fit knows what its model does not describe, and its errors and verdicts say so."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from analysis.fits.brdf_fit import brdf_fit
from analysis.fits.by_name import fit_models
from analysis.fits.global_fit import global_fit
from analysis.fits.local_fit import local_fit
from analysis.fits.misfit import excess, moved_by
from analysis.reflectance.fresnel import fresnel_conductor, load_conductor
from analysis.reflectance.models import normalised_fresnel
from goniometer.datasets.dataset import Dataset
from goniometer.uncertainty import ErrorSource

Measure = Callable[..., Dataset]
WAVELENGTHS = np.arange(385.0, 880.0, 9.0)
SLOPE = 0.8


def spectra(metal: str, count: int = 40, seed: int = 0) -> Dataset:
    """Spectra of Eq. 2 with slope 0.8 1/um and p = 1.2 of a `metal`, 0.3 % noise."""
    random = np.random.default_rng(seed)
    theta_in = np.repeat([0.0, 30.0, 50.0, 70.0], count // 4)
    fresnel = normalised_fresnel(theta_in, WAVELENGTHS, load_conductor(*metal.split("/")), 600.0)
    clean = (1 + SLOPE * (WAVELENGTHS - 600) * 1e-3) * fresnel**1.2
    u = 0.003 * clean
    return Dataset(
        sample=metal,
        theta_in=theta_in,
        theta_out=np.linspace(-80, 80, count),
        wavelengths=WAVELENGTHS,
        brdf=clean + u * random.normal(size=clean.shape),
        sources=(ErrorSource("random: counts", "random", u, None, False),),
        flags=np.zeros(count, dtype=np.uint16),
        u_angle=0.005,
        u_zero=0.0,
        aperture=1.0,
    )


def test_what_conspires_moves_a_parameter_by_the_sum_and_groups_by_its_root_of_squares() -> None:
    gain = np.array([[[1.0, -2.0], [0.5, 0.0], [0.0, 3.0]]])
    beyond = np.array([[0.1, 0.1], [0.2, 0.2], [0.0, 0.4]])
    assert moved_by(gain, beyond) == pytest.approx(0.3 + 0.1 + 1.2)
    assert moved_by(gain, beyond, np.array([0, 0, 1])) == pytest.approx(np.hypot(0.4, 1.2))
    np.testing.assert_allclose(excess(np.array([5.0, -5.0, 1.0]), np.array([3.0, 4.0, 2.0])), [4.0, 3.0, 0.0])


def test_a_spike_in_a_spectrum_widens_the_error_of_its_slope_and_of_no_other() -> None:
    clean = spectra("main/Al/Cheng")
    spoilt = clean.brdf.copy()
    spoilt[7, 3] *= 1.5
    before, after = local_fit(clean), local_fit(replace(clean, brdf=spoilt))
    assert not before.misfit.any()
    assert np.flatnonzero(after.misfit[0]).tolist() == [7]
    off = abs(after.slope[7] - SLOPE)
    assert off > 5 * before.u_slope[7]
    assert off < 3 * after.u_slope[7]
    others = np.arange(40) != 7
    np.testing.assert_array_equal(after.u_slope[others], before.u_slope[others])


@pytest.mark.parametrize("metal", ["main/Ag/Johnson", "main/Cr/Johnson", "main/Fe/Johnson"])
def test_another_metal_than_assumed_is_noticed_by_its_colour(metal: str) -> None:
    dataset = spectra(metal)
    local = local_fit(dataset)
    assert any("Check which metal" in doubt for doubt in local.doubts), local.doubts
    fit = global_fit(dataset, local)
    assert not fit.verdict.trusted
    assert local.doubts[0] in fit.verdict.reasons
    assert local_fit(dataset, load_conductor(*metal.split("/"))).doubts == ()
    (lobe,) = fit_models(dataset, local, ("cook-torrance",))
    assert not lobe.verdict.trusted
    assert local.doubts[0] in lobe.verdict.reasons
    # a spectrum of which nobody asks the colour of a metal has no doubts about it
    assert local_fit(dataset, fresnel=False).doubts == ()


def test_a_metal_seen_at_few_wavelengths_is_not_called_another_one() -> None:
    part = spectra("main/Al/Cheng")
    part = part.at_wavelengths(np.flatnonzero(np.abs(WAVELENGTHS - 600) < 40))
    local = local_fit(part)
    assert np.median(local.u_exponent) > 1
    assert local.doubts == ()


def test_an_exponent_that_flat_spectra_hardly_tell_is_called_undetermined_and_the_slopes_are_not() -> None:
    told = global_fit(spectra("main/Al/Cheng"), local_fit(spectra("main/Al/Cheng")))
    assert told.standard_error("p") < 0.5
    assert "p" not in told.verdict.undetermined
    assert not any("hardly tell p" in reason for reason in told.verdict.reasons)
    part = spectra("main/Al/Cheng")
    part = part.at_wavelengths(np.flatnonzero(np.abs(WAVELENGTHS - 600) < 40))
    for model in ("constant-slope", "global"):
        vague = global_fit(part, local_fit(part), model=model)
        assert vague.standard_error("p") > 0.5
        assert "p" in vague.verdict.undetermined
        (said,) = (reason for reason in vague.verdict.reasons if "hardly tell p" in reason)
        assert f"± {vague.standard_error('p'):.2g}" in said
    # slopes are all the same here, which the constant fits, whatever p is
    assert global_fit(part, local_fit(part), model="constant-slope").verdict.trusted


def test_a_line_that_no_spectrum_should_have_is_an_error_that_all_slopes_share() -> None:
    dataset = spectra("main/Al/Cheng")
    line = 1 - 0.3 * np.exp(-0.5 * ((WAVELENGTHS - 480) / 15) ** 2)
    fit = global_fit(replace(dataset, brdf=dataset.brdf * line), local_fit(replace(dataset, brdf=dataset.brdf * line)))
    sound = global_fit(dataset, local_fit(dataset))
    level = {name: fit.value("h") + fit.value("t_y") for name in ("h", "t_y")}["h"]
    assert abs(level - SLOPE) > 0.05
    p = next(parameter for parameter in fit.parameters if parameter.name == "p")
    assert p.error_by_part["model"] > 5 * sound.standard_error("p")
    assert abs(p.value - 1.2) < 5 * p.standard_error


def test_a_wrong_metal_does_not_give_a_confident_shift(measure: Measure) -> None:
    silver = load_conductor("main", "Ag", "Johnson")

    def seen(nodes, nm):
        from analysis.reflectance.models import microfacet  # noqa: PLC0415

        fresnel = fresnel_conductor(nodes.cos_d[..., None], *silver.index(nm))
        return microfacet(nodes, nm, 0.2, fresnel, 1.2 * np.cos(3.0 * np.arccos(np.clip(nodes.cos_m, -1, 1))))

    dataset = measure(0.2, brdf=seen, systematic=True, incident=(0, 30, 60), wavelength_step=23.0)
    fit = brdf_fit(dataset)
    assert abs(fit.value("h") - 1.2) > 0.02
    h = next(parameter for parameter in fit.parameters if parameter.name == "h")
    assert h.error_by_part["model"] > 0
    assert abs(h.value - 1.2) < 5 * h.standard_error
    whole = np.sqrt(np.sum(np.square(list(h.error_by_part.values()))))
    assert whole == pytest.approx(h.standard_error, rel=1e-9)
