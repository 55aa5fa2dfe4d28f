"""A dataset that is wrong says so, and one that is right is not accused."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import chi2

from analysis.reflectance.directions import _from_vectors
from analysis.reflectance.distributions import lobe
from drivers.arrays import FloatArray
from goniometer.datasets.between import interpolate
from goniometer.datasets.checks import checks, checks_of_imported, noise_flags
from goniometer.datasets.dataset import Check, Dataset, Flag
from goniometer.datasets.energy import energy
from goniometer.datasets.fill import unmeasured
from goniometer.datasets.reciprocity import reciprocity
from goniometer.uncertainty import ErrorSource, everywhere
from simulators.materials.materials import SAMPLES
from tests.drawn_dataset import directions, drawn_dataset

NAMES = ["reciprocity", "energy", "values", "drift", "saturation", "homogeneity", "noise floor", "footprint"]


def asked(dataset: Dataset, name: str, **facts: object) -> Check:
    """What one check of a dataset says."""
    known = {"spot": None, "drift": None, "drift_corrected": False} | facts
    (found,) = [check for check in checks(dataset, **known) if check.name == name]
    return found


def of_values(
    theta_in: FloatArray, theta_out: FloatArray, f: FloatArray, sources: tuple[ErrorSource, ...] = ()
) -> Dataset:
    """A dataset of three grey wavelengths with exact angles."""
    brdf = np.repeat(f[:, None], 3, axis=1)
    flags = np.zeros(f.size, dtype=np.uint16)
    return Dataset("a sample", theta_in, theta_out, np.array([500.0, 510, 520]), brdf, sources, flags, 0.0, 0.0, 0.0)


@pytest.mark.parametrize("name", ["sample-1", "sample-4", "sample-5", "sample-6"])
def test_a_sound_dataset_passes_every_check(name: str) -> None:
    alike = {"zeros": (0.01, 0.005), "reference_error": -0.005}
    dataset, spot = (drawn_dataset(name, seed=seed, **alike) for seed in (1, 2))
    found = checks(dataset, spot=spot, drift=0.002, drift_corrected=True)
    assert [check.name for check in found] == NAMES
    assert not [check for check in found if check.passed is not True]


@pytest.mark.parametrize("name", ["sample-1", "sample-4", "sample-6"])
@pytest.mark.parametrize("zeros", [(0.1, 0.0), (0.0, 0.2)])
def test_a_stage_whose_zero_is_off_breaks_reciprocity(name: str, zeros: tuple[float, float]) -> None:
    found = asked(drawn_dataset(name, zeros=zeros), "reciprocity")
    assert found.passed is False
    assert "zeros of both stages" in found.message


def test_differences_of_reverse_directions_are_as_large_as_their_stated_uncertainty() -> None:
    z = np.concatenate([reciprocity(drawn_dataset("sample-4", seed=seed)).z for seed in range(8)])
    assert z.size == 8 * 72
    # interpolation is stated with a margin, so the differences may be smaller, but not larger
    assert 0.4 < np.sqrt(np.mean(z**2)) < 1.15
    assert np.mean(np.abs(z) > 2) < 0.1  # the zeros of one seed are shared by all of its pairs


def test_an_error_that_both_directions_share_does_not_excuse_a_broken_reciprocity() -> None:
    theta_in, theta_out = np.array([20.0, 20, 20, 60, 60, 60]), np.array([50.0, 60, 70, 10, 20, 30])
    f = np.full(6, 0.3)
    f[1] = 0.33
    incidence = np.array([0, 0, 0, 1, 1, 1])
    for groups, share in ((everywhere(6), 0.0), (incidence, np.sqrt(2)), (None, np.sqrt(2))):
        # a relative error of 2 %: common to all it cancels, else that of either direction counts
        source = ErrorSource("reference", "reference", 0.02 * np.repeat(f[:, None], 3, axis=1), groups, True)
        found = reciprocity(of_values(theta_in, theta_out, f, (source,)))
        at = np.flatnonzero((found.theta_in == 20) & (found.theta_out == 60))
        assert found.difference[at] == pytest.approx(np.log(1.1))
        assert found.u[at] == pytest.approx(0.02 * share, abs=1e-12)


def test_light_that_comes_back_is_compared_with_light_that_comes_back() -> None:
    # reciprocal: a function of theta_in + |theta_out| alone, on each side another one
    theta_in, theta_out = np.array([(t, float(o)) for t in (20.0, 60.0) for o in range(-80, 81, 10) if t + o]).T
    total = theta_in + np.abs(theta_out)
    f = np.where(theta_out > 0, np.exp(total / 100), 0.2 * np.exp(-total / 60))
    own = ErrorSource("random", "random", np.repeat(1e-3 * f[:, None], 3, axis=1), None, True)
    found = reciprocity(of_values(theta_in, theta_out, f, (own,)))
    assert sorted(np.sign(found.theta_out)) == [-1, 1]
    assert found.difference == pytest.approx(0, abs=1e-9)


def test_a_dataset_without_reverse_directions_says_that_it_does_not_know() -> None:
    found = asked(of_values(np.full(5, 30.0), np.arange(5.0), np.ones(5)), "reciprocity")
    assert found.passed is None


def hemisphere(alpha: float, theta_in: float) -> float:
    """Reflectance of GGX facets by Gauss-Legendre over the hemisphere, straight from the definition."""
    nodes, weights = np.polynomial.legendre.leggauss(400)
    theta = np.pi / 4 * (nodes + 1)[:, None]
    phi = np.pi / 2 * (nodes + 1)
    out = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta) + 0 * phi], axis=-1)
    tilt = np.radians(theta_in)
    incident = np.array([-np.sin(tilt), 0.0, np.cos(tilt)])
    f = lobe(_from_vectors(np.broadcast_to(incident, out.shape), out), alpha)
    inner = f @ weights * np.pi / 2 * 2
    return float(np.pi / 4 * np.sum(weights * inner * (np.sin(theta) * np.cos(theta))[:, 0]))


def slice_of(alpha: float, theta_in: float) -> Dataset:
    """GGX facets measured without error at one incident angle."""
    incident, theta_out = directions(alpha, (theta_in,))
    tilt, turn = np.radians(incident), np.radians(theta_out)
    pairs = (np.stack([np.sin(a), 0 * a, np.cos(a)], axis=-1) for a in (-tilt, turn))
    return of_values(incident, theta_out, lobe(_from_vectors(*pairs), alpha))


@pytest.mark.parametrize("alpha", [0.1, 0.2, 0.364])
@pytest.mark.parametrize("theta_in", [20.0, 40.0, 60.0])
def test_energy_of_facets_is_that_of_the_whole_hemisphere_within_its_uncertainty(alpha: float, theta_in: float) -> None:
    found = energy(slice_of(alpha, theta_in))
    truth = hemisphere(alpha, theta_in)
    assert found.rho[0, 0] == pytest.approx(truth, abs=3 * found.u[0, 0])
    assert found.rho[0, 0] == pytest.approx(truth, rel=0.09)


@pytest.mark.parametrize("alpha", [0.02, 0.1])
def test_energy_at_normal_incidence_counts_the_lobe_that_the_detector_hides(alpha: float) -> None:
    incident, theta_out = directions(alpha)
    tilt, turn = np.radians(incident), np.radians(theta_out)
    pairs = (np.stack([np.sin(a), 0 * a, np.cos(a)], axis=-1) for a in (-tilt, turn))
    f = lobe(_from_vectors(*pairs), alpha)
    own = ErrorSource("random", "random", np.repeat(1e-3 * f[:, None], 3, axis=1), None, False)
    found = energy(of_values(incident, theta_out, f, (own,)))
    assert found.theta_in[0] == 0
    assert found.rho[0, 0] == pytest.approx(hemisphere(alpha, 0.0), abs=3 * found.u[0, 0])
    assert found.u[0, 0] < 0.05


@pytest.mark.parametrize("theta_in", [0.0, 30.0, 60.0, 80.0])
def test_a_white_lambertian_surface_reflects_all_light_and_is_not_accused(theta_in: float) -> None:
    theta_out = np.array([o for o in np.arange(-85.0, 86, 10) if abs(o + theta_in) >= 5])
    dataset = of_values(np.full(theta_out.size, theta_in), theta_out, np.full(theta_out.size, 1 / np.pi))
    found = energy(dataset)
    assert found.rho[0, 0] == pytest.approx(1, abs=2 * found.u[0, 0])
    assert asked(dataset, "energy").passed


def test_a_reference_that_is_a_fifth_too_dark_gives_more_light_than_there_is() -> None:
    found = asked(drawn_dataset("sample-4", reference_error=0.2), "energy")
    assert found.passed is False
    assert "k = 3" in found.message


@pytest.mark.parametrize("value", [0.0, -0.01])
def test_a_band_that_is_nowhere_above_zero_has_no_energy_and_the_others_are_judged_without_it(value: float) -> None:
    theta_out = np.arange(-35.0, 86, 10)
    found, wavelengths = of_values(np.full(13, 40.0), theta_out, np.full(13, 2.0)), np.array([450.0, 550, 650])
    lit = replace(found, wavelengths=wavelengths)
    dark = replace(lit, brdf=np.where(wavelengths == 550, value, lit.brdf))
    black = replace(lit, brdf=np.full_like(lit.brdf, value))
    whole, judged = energy(lit), energy(dark)
    assert np.isnan(judged.rho[0]).tolist() == np.isnan(judged.u[0]).tolist() == [False, True, False]
    assert judged.rho[0, [0, 2]] == pytest.approx(whole.rho[0, [0, 2]], rel=1e-12)
    (told,) = (check for check in checks_of_imported(dark) if check.name == "energy")
    assert told.passed is False  # more than the 1 / pi of a white surface
    assert "2 of 2 combinations" in told.message
    assert "Not known for 1 of 3" in told.message
    assert asked(replace(dark, brdf=dark.brdf / 8), "energy").passed
    assert asked(black, "energy") == Check(
        "energy", None, "Not known: at no incident angle and in no band of wavelengths is a value above zero."
    )


def test_the_error_of_the_reference_is_in_the_uncertainty_of_the_energy() -> None:
    theta_out = np.arange(-35.0, 86, 10)
    theta_in = np.full(theta_out.size, 40.0)
    f = np.full(theta_out.size, 0.3)
    relative = ErrorSource("reference", "reference", np.full((f.size, 3), 0.03), everywhere(f.size), True)
    without, found = energy(of_values(theta_in, theta_out, f)), energy(of_values(theta_in, theta_out, f, (relative,)))
    # 0.03 of 0.3: every value rises by a tenth, and so does their integral
    assert np.sqrt(found.u**2 - without.u**2) == pytest.approx(0.1 * found.rho, rel=0.01)


def test_a_value_that_is_no_number_needs_a_flag_that_says_why() -> None:
    dataset = drawn_dataset("sample-4")
    brdf = dataset.brdf.copy()
    brdf[7, 3] = np.nan
    assert asked(replace(dataset, brdf=brdf), "values").passed is False
    flags = dataset.flags.copy()
    flags[7] |= np.uint16(Flag.SATURATED)
    explained = replace(dataset, brdf=brdf, flags=flags)
    assert asked(explained, "values").passed
    assert asked(explained, "saturation").passed is False


def test_darkness_is_below_the_noise_and_not_negative() -> None:
    random = np.random.default_rng(3)
    u = np.full((400, 130), 2e-5)
    flags = noise_flags(u * random.standard_normal(u.shape), u)
    assert np.all(flags & Flag.BELOW_NOISE)
    # more than 2 of 130 values below three sigma: binomial with p = 0.00135, about 8e-4
    assert np.sum((flags & Flag.NEGATIVE) != 0) <= 2


def test_too_much_dark_taken_off_is_negative_and_light_is_neither() -> None:
    random = np.random.default_rng(4)
    u = np.full((40, 130), 2e-5)
    assert np.all(noise_flags(-6e-5 + u * random.standard_normal(u.shape), u) & Flag.NEGATIVE)
    assert not np.any(noise_flags(6e-5 + u * random.standard_normal(u.shape), u))
    assert not np.any(noise_flags(np.full((2, 130), np.nan), np.full((2, 130), np.nan)))


def test_negative_values_fail_where_the_whole_uncertainty_does_not_explain_them() -> None:
    theta_in, theta_out = np.full(6, 30.0), np.arange(10.0, 70, 10)
    f = np.array([0.1, 0.1, 0.1, 0.1, -0.01, -0.01])
    small = ErrorSource("random", "random", np.full((6, 3), 1e-3), None, False)
    stray = ErrorSource("stray light", "stray light", np.full((6, 3), 1e-2), everywhere(6), True)
    assert asked(of_values(theta_in, theta_out, f, (small,)), "values").passed is False
    assert asked(of_values(theta_in, theta_out, f, (small, stray)), "values").passed


@pytest.mark.parametrize(
    ("largest", "corrected", "stated", "passed"),
    [
        (0.02, True, 0.0, True),
        (0.02, False, 0.0, False),
        (0.02, False, 0.02, True),
        (0.2, True, 0.02, False),
        (None, False, 0.005, None),
    ],
)
def test_a_lamp_that_drifts_is_accepted_where_that_is_corrected_or_stated(
    largest: float | None, corrected: bool, stated: float, passed: bool | None
) -> None:
    f = np.full(6, 0.1)
    drift = ErrorSource("drift", "drift", np.full((6, 3), 0.1 * stated), everywhere(6), True)
    dataset = of_values(np.full(6, 30.0), np.arange(10.0, 70, 10), f, (drift,))
    assert asked(dataset, "drift", drift=largest, drift_corrected=corrected).passed is passed


SPOT = (np.full(5, 40.0), np.array([-70.0, -10, 30, 40, 70]))
"""Some directions of `directions` at a middle incident angle."""


@pytest.mark.parametrize("name", ["sample-1", "sample-2", "sample-3", "sample-4", "sample-5", "sample-6"])
def test_a_sample_that_is_the_same_everywhere_passes_at_another_spot(name: str) -> None:
    for seed in range(4):
        zeros = (0.01, -0.01)  # both scans have the same
        around = directions(SAMPLES[name].alpha, (30, 40, 50))
        dataset = drawn_dataset(name, seed=seed, zeros=zeros, reference_error=0.01, at=around)
        spot = drawn_dataset(name, seed=100 + seed, zeros=zeros, reference_error=0.01, spot=1, at=SPOT)
        assert asked(dataset, "homogeneity", spot=spot).passed, name


def test_sample_7_which_the_paper_discards_is_caught_at_another_spot() -> None:
    dataset = drawn_dataset("sample-7", seed=1)
    found = asked(dataset, "homogeneity", spot=drawn_dataset("sample-7", seed=2, spot=1, at=SPOT))
    assert found.passed is False
    assert "not the same everywhere" in found.message


def test_without_another_spot_homogeneity_is_not_known() -> None:
    dataset = drawn_dataset("sample-4")
    assert asked(dataset, "homogeneity").passed is None
    assert "homogeneity in the campaign" in asked(dataset, "homogeneity").message
    elsewhere = drawn_dataset("sample-4", at=(np.full(3, 33.0), np.array([20.0, 33, 50])))
    assert asked(dataset, "homogeneity", spot=elsewhere).passed is None


def test_points_off_the_sample_and_a_dataset_of_noise_are_reported() -> None:
    dataset = drawn_dataset("sample-4")
    grazing = np.abs(dataset.theta_out) > 75
    clipped = replace(dataset, flags=np.where(grazing, Flag.CLIPPED, 0).astype(np.uint16))
    found = asked(clipped, "footprint")
    assert found.passed is False
    assert f"At {grazing.sum()} points, from |θ out| = {np.abs(dataset.theta_out[grazing]).min():.0f}°" in found.message
    dark = np.arange(dataset.theta_in.size) < 0.6 * dataset.theta_in.size
    assert asked(replace(dataset, flags=dark * np.uint16(Flag.BELOW_NOISE)), "noise floor").passed is False
    assert asked(dataset, "noise floor").passed


def test_rare_means_rare() -> None:
    # what the reciprocity and homogeneity checks count: a normal error beyond 3.5 standard uncertainties
    assert chi2.sf(3.5**2, 1) == pytest.approx(1 / 2149, rel=1e-3)


def test_directions_that_were_measured_twice_are_compared_with_their_reverse_in_numbers() -> None:
    """Two nodes at one angle would make the difference NaN, which is above no limit, so any fault would pass."""
    dataset = drawn_dataset("sample-2", zeros=(0.5, 0.0))
    once = reciprocity(dataset)
    repeated = _with_points(dataset, np.repeat(np.arange(dataset.theta_in.size), 2))
    assert reciprocity(repeated).difference == pytest.approx(once.difference)
    assert {c.name: c.passed for c in checks_of_imported(repeated)}["reciprocity"] is False


def test_spectra_with_gaps_are_interpolated_as_without_them() -> None:
    dataset = drawn_dataset("sample-2")
    gaps = np.random.default_rng(2).random(dataset.brdf.shape) < 0.05
    assert gaps.any(axis=0).all()  # no wavelength is complete
    at = np.array([15.0, 35.0]), np.array([12.0, 22.0])
    whole, with_gaps = (
        interpolate(d, *at) for d in (dataset, replace(dataset, brdf=np.where(gaps, np.nan, dataset.brdf)))
    )
    apart = np.abs(with_gaps.brdf - whole.brdf)
    assert (apart < 5 * np.hypot(whole.u, with_gaps.u)).all()
    assert np.median(apart / whole.brdf) < 0.01


def _with_points(dataset: Dataset, points: NDArray[np.intp]) -> Dataset:
    return replace(
        dataset,
        theta_in=dataset.theta_in[points],
        theta_out=dataset.theta_out[points],
        brdf=dataset.brdf[points],
        sources=tuple(
            replace(s, values=s.values[points], groups=None if s.groups is None else s.groups[points])
            for s in dataset.sources
        ),
        flags=dataset.flags[points],
    )


@pytest.mark.parametrize("lineage", [{}, {"simulated": "rays on sample-4"}])
def test_the_energy_of_a_sector_that_was_seen_is_that_of_its_values_and_not_of_what_would_fill_it(
    lineage: dict[str, object],
) -> None:
    theta_in, theta_out = (a.ravel() for a in np.meshgrid([0.0, 30.0], np.arange(-85.0, 86, 1), indexing="ij"))
    dataset = replace(of_values(theta_in, theta_out, np.full(theta_in.size, 1 / np.pi)), lineage=lineage)
    assert not np.any(np.abs(np.sum(unmeasured(dataset), axis=0)) < 5)
    assert energy(dataset).rho[0, 0] == pytest.approx(1.0, abs=0.005)  # a white sheet at normal incidence
