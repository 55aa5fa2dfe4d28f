"""A fit that was saved can be used again, years later and by other programs."""

import json
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from analysis.choices import MODELS, Distribution
from analysis.errors import ExportError, OutOfRange
from analysis.fits.analyse import analyse
from analysis.fits.brdf_fit import form_of
from analysis.fits.fit_json import analysis_from_json, analysis_to_json, fit_from_json, fit_to_json
from analysis.fits.global_fit import SLOPE_MODELS, slope_and_derivative
from analysis.fits.stored_fit import evaluate
from analysis.reflectance.directions import in_plane
from analysis.reflectance.fresnel import load_conductor
from analysis.reflectance.microfacet import brdf
from analysis.reflectance.models import cook_torrance, normalised_fresnel, shift
from analysis.results import Parameter, SampleAnalysis, Verdict
from goniometer.datasets.dataset import Check, Dataset, Flag
from goniometer.errors import InputError
from tests.drawn_dataset import drawn_dataset


@pytest.fixture(scope="module")
def rough_analysis(measure: Callable[..., Dataset]) -> SampleAnalysis:
    """All fits of a rough sample, three incident angles of it."""
    dataset = measure(0.28, 1.5, 2.6, incident=(10, 40, 70), wavelength_step=9.0)
    lineage: dict[str, object] = {"scan": 3, "exposures": list(range(70)), "software_version": "0.1.0"}
    return analyse(replace(dataset, sample="disc <2>", lineage=lineage), models=EVERY)


def _saved(analysis: SampleAnalysis, model: str) -> str:
    return fit_to_json(analysis.model(model), analysis.dataset, analysis.differences[model], load_conductor())


def _refuse(name: str) -> None:
    raise AssertionError(f"{name} is not strict JSON")


EVERY = ("global", "global-two-component", "cook-torrance", "cook-torrance-shift", "two-component", "dielectric-shift")


@pytest.mark.parametrize("model", EVERY)
def test_a_reloaded_fit_is_the_same_bit_for_bit(rough_analysis: SampleAnalysis, model: str) -> None:
    fit, dataset = rough_analysis.model(model), rough_analysis.dataset
    stored = fit_from_json(_saved(rough_analysis, model))
    for name in (
        "model", "equation", "parameters", "verdict", "cost", "cost_value", "r2", "lambda_n", "theta_range",
        "wavelength_range", "clamped_points", "engine", "distribution", "comparison", "independent",
    ):  # fmt: skip
        assert getattr(stored, name) == getattr(fit, name), name
    np.testing.assert_array_equal(stored.correlation, fit.correlation)
    if fit.albedo is not None:
        assert stored.albedo is not None
        for name in ("wavelengths", "values", "u"):
            np.testing.assert_array_equal(getattr(stored.albedo, name), getattr(fit.albedo, name))
    assert (stored.albedo is None) == (fit.albedo is None)
    assert (stored.conductor is None) == (fit.albedo is not None)
    assert (stored.sample, stored.dataset_hash) == (dataset.sample, dataset.content_hash)
    assert (stored.points, stored.aperture) == (dataset.theta_in.size, 1.0)
    assert stored.colour_difference["absolute"] == rough_analysis.differences[model].statistics("absolute")


def test_a_reloaded_model_gives_identical_values_in_directions_never_measured(rough_analysis: SampleAnalysis) -> None:
    fit = rough_analysis.model("cook-torrance-shift")
    stored = fit_from_json(_saved(rough_analysis, "cook-torrance-shift"))
    rng = np.random.default_rng(5)
    theta_in, theta_out = rng.uniform(0, 85, 200), rng.uniform(-85, 85, 200)
    wavelengths = np.linspace(360, 830, 31)
    expected = cook_torrance(
        in_plane(theta_in, theta_out), wavelengths, fit.value("alpha"), load_conductor(), fit.value("h"), fit.value("w")
    )
    assert np.array_equal(evaluate(stored, theta_in, theta_out, wavelengths), expected)
    # by hand at one direction: plain Cook-Torrance differs by the shift alone
    plain = replace(stored, model="cook-torrance")
    ratio = evaluate(stored, np.array([20.0]), np.array([50.0]), np.array([700.0])) / evaluate(
        plain, np.array([20.0]), np.array([50.0]), np.array([700.0])
    )
    slope = fit.value("h") * np.cos(fit.value("w") * np.radians(15))
    assert ratio[0, 0] == pytest.approx(1 + 0.1 * slope, rel=1e-12)


@pytest.mark.parametrize("distribution", ["ggx", "beckmann"])
@pytest.mark.parametrize("model", MODELS[1:])
def test_every_model_gives_the_same_bits_after_it_was_in_a_file_alone_or_among_all_fits(
    model: str, distribution: Distribution
) -> None:
    drawn = drawn_dataset("sample-2")
    dataset = drawn.at_points(np.flatnonzero(np.isin(drawn.theta_in, (20, 60)))).at_wavelengths(slice(None, None, 2))
    analysis = analyse(dataset, models=(model,), distribution=distribution)
    fit, metal = analysis.model(model), load_conductor()
    alone = fit_from_json(fit_to_json(fit, dataset, analysis.differences[model], metal))
    (among,) = analysis_from_json(analysis_to_json(analysis, metal))
    assert alone.parameters == among.parameters == fit.parameters
    random = np.random.default_rng(8)
    theta_in, theta_out = random.uniform(0, 85, 100), random.uniform(-85, 85, 100)
    wavelengths = random.uniform(dataset.wavelengths[0], dataset.wavelengths[-1], 7)
    directions, values = in_plane(theta_in, theta_out), np.array([p.value for p in fit.parameters])
    if model in SLOPE_MODELS:
        tilt = shift(slope_and_derivative(model, directions, values[:-1])[0], wavelengths, fit.lambda_n)
        expected = tilt * normalised_fresnel(theta_in, wavelengths, metal, fit.lambda_n) ** fit.value("p")
    else:
        albedo = None if fit.albedo is None else np.interp(wavelengths, fit.albedo.wavelengths, fit.albedo.values)
        form = form_of(model, None if fit.albedo else metal, distribution)
        expected = brdf(form, directions, wavelengths, values, albedo)
    for stored in (alone, among):
        assert np.array_equal(evaluate(stored, theta_in, theta_out, wavelengths), expected)


def test_the_reloaded_global_model_gives_the_values_that_were_fitted(rough_analysis: SampleAnalysis) -> None:
    dataset, local = rough_analysis.dataset, rough_analysis.local
    stored = fit_from_json(_saved(rough_analysis, "global"))
    normalised = evaluate(stored, dataset.theta_in, dataset.theta_out, dataset.wavelengths)
    np.testing.assert_allclose(normalised * local.scale[:, None], rough_analysis.model("global").fitted, rtol=1e-9)


@pytest.mark.parametrize("model", ["two-component", "dielectric-shift"])
def test_a_reloaded_model_is_what_a_detector_without_an_aperture_would_read(
    rough_analysis: SampleAnalysis, model: str
) -> None:
    fit, dataset = rough_analysis.model(model), rough_analysis.dataset
    stored = fit_from_json(_saved(rough_analysis, model))
    values = evaluate(stored, dataset.theta_in, dataset.theta_out, dataset.wavelengths)
    # lobes of 18 degrees and more are nearly the same through one degree
    np.testing.assert_allclose(values, fit.fitted, rtol=5e-3)


def test_an_albedo_is_not_invented_beyond_its_wavelengths(rough_analysis: SampleAnalysis) -> None:
    stored = fit_from_json(_saved(rough_analysis, "dielectric-shift"))
    with pytest.raises(OutOfRange, match="albedo is known from 382"):
        evaluate(stored, np.array([20.0]), np.array([30.0]), np.array([370.0, 500.0]))


def test_what_is_not_determined_survives_strict_json(rough_analysis: SampleAnalysis) -> None:
    parameters = (
        Parameter("alpha", 0.1, float("inf"), "1"),
        Parameter("h", float("nan"), float("nan"), "1/um"),
        Parameter("w", float("-inf"), 0.1 + 0.2, "1"),
    )
    fit = replace(
        rough_analysis.model("cook-torrance-shift"),
        parameters=parameters,
        correlation=np.array([[1, np.nan, np.inf], [np.nan, 1, 0], [-np.inf, 0, 1]]),
        r2=float("nan"),
        verdict=Verdict(False, ("The lobe [ 0.66 deg ] is narrower than the aperture.", 'It says "no".')),
    )
    text = fit_to_json(fit, rough_analysis.dataset, rough_analysis.differences["local"], load_conductor())
    assert json.loads(text, parse_constant=_refuse)["parameters"][0]["standard_error"] == "inf"
    stored = fit_from_json(text)
    assert repr(stored.parameters) == repr(parameters)
    np.testing.assert_array_equal(stored.correlation, fit.correlation)
    assert np.isnan(stored.r2)
    assert stored.verdict == fit.verdict


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", "no valid JSON"),
        ("[1, 2]", "JSON object"),
        ('{"schema": "something-else"}', '"goniometer-fit"'),
        ('{"schema": "goniometer-fit", "schema_version": 99}', "schema version 99"),
        ('{"schema": "goniometer-fit", "schema_version": 3}', "is missing"),
        ('{"schema": "goniometer-fit", "schema_version": 3, "r2": NaN}', "NaN is not JSON"),
    ],
)
def test_a_wrong_file_is_refused_in_one_line(text: str, complaint: str) -> None:
    with pytest.raises(InputError, match=complaint) as refusal:
        fit_from_json(text)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("parameters",), 3),
        (("parameters", 0, "value"), "much"),
        (("parameters", 0, "standard_error_by_part"), 0.1),
        (("correlation",), [[1.0]]),
        (("fitted_to", "theta_in_deg"), [1.0]),
        (("metrics", "dE00"), []),
        (("conductor", "n"), {"a": 1}),
    ],
)
def test_a_damaged_field_is_refused_and_never_guessed(
    rough_analysis: SampleAnalysis, path: tuple[str | int, ...], value: object
) -> None:
    document = json.loads(_saved(rough_analysis, "cook-torrance-shift"))
    place = document
    for step in path[:-1]:
        place = place[step]
    place[path[-1]] = value
    with pytest.raises(InputError, match="damaged"):
        fit_from_json(json.dumps(document))


def test_the_whole_analysis_is_strict_json_and_holds_every_point_once(rough_analysis: SampleAnalysis) -> None:
    document = json.loads(analysis_to_json(rough_analysis, load_conductor()), parse_constant=_refuse)
    assert document["dataset"]["sha256"] == rough_analysis.dataset.content_hash
    assert [m["model"] for m in document["models"]] == list(EVERY)
    local = document["local"]
    assert local["theta_out_deg"] == rough_analysis.dataset.theta_out.tolist()
    assert local["m_per_um"] == rough_analysis.local.slope.tolist()
    assert local.pop("doubts") == []
    assert {len(v) for v in local.values() if isinstance(v, list)} == {rough_analysis.dataset.theta_in.size}


def test_the_whole_analysis_says_what_the_checks_found_and_what_is_flagged(rough_analysis: SampleAnalysis) -> None:
    dataset = rough_analysis.dataset
    flags = dataset.flags.copy()
    flags[[3, 4]] = Flag.SATURATED
    checks = (Check("drift", None, "Nobody looked."), Check("energy", False, "It shines."))
    text = analysis_to_json(
        replace(rough_analysis, dataset=replace(dataset, flags=flags, checks=checks)), load_conductor()
    )
    document = json.loads(text)
    assert document["dataset"]["checks"] == [
        {"name": "drift", "passed": None, "message": "Nobody looked."},
        {"name": "energy", "passed": False, "message": "It shines."},
    ]
    assert document["dataset"]["flagged_points"]["saturated at the shortest integration time"] == 2
    assert sum(document["dataset"]["flagged_points"].values()) == 2
    assert document["local"]["flags"][3:6] == ["saturated at the shortest integration time"] * 2 + [""]


def test_a_blocked_direction_never_leaves_the_house(rough_analysis: SampleAnalysis) -> None:
    dataset = rough_analysis.dataset
    theta_out = dataset.theta_out.copy()
    theta_out[3] = -dataset.theta_in[3] + 4.9
    slipped_in = replace(rough_analysis, dataset=replace(dataset, theta_out=theta_out))
    local = json.loads(analysis_to_json(slipped_in, load_conductor()))["local"]
    assert len(local["theta_in_deg"]) == dataset.theta_in.size - 1
    assert min(abs(a + b) for a, b in zip(local["theta_in_deg"], local["theta_out_deg"], strict=True)) >= 5


def test_lineage_that_json_cannot_hold_is_named(rough_analysis: SampleAnalysis) -> None:
    strange = replace(rough_analysis, dataset=replace(rough_analysis.dataset, lineage={"camera": {1, 2}}))
    with pytest.raises(ExportError, match="set"):
        analysis_to_json(strange, load_conductor())
