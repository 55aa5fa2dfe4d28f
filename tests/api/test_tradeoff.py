"""`goniometer tradeoff` charts what it says it does."""

import json
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from analysis.costs.fits import fit_charts
from analysis.costs.models import model_charts
from analysis.reflectance.fresnel import load_conductor
from api.commands.main import main
from drivers.arrays import FloatArray
from goniometer.plans.plan_spec import PlanSpec
from simulators.costs import simulations
from simulators.costs.measurements import drawn
from simulators.costs.scans import scan_charts
from simulators.costs.simulations import simulation_charts
from simulators.materials.materials import material, true_brdf
from simulators.topographies.topography import topography


def test_a_dynamic_scan_is_on_the_front_of_a_narrow_lobe() -> None:
    def truth(theta_in: FloatArray, theta_out: FloatArray, wavelengths: FloatArray) -> FloatArray:
        return true_brdf(material("sample-8"), theta_in, theta_out, wavelengths) * np.cos(np.radians(theta_in))[:, None]

    error, colour = scan_charts("sample-8", truth, PlanSpec((0.0, 30.0, 60.0)), 1, lambda _: None)
    assert "dynamic" in [choice.family for i, choice in enumerate(error.choices) if i in error.front]
    by_name = {(choice.family, choice.name): choice.error for choice in colour.choices}
    assert by_name["uniform", "2°"] < by_name["uniform", "10°"]


@pytest.mark.slow
def test_the_command_writes_one_json_object_and_a_page(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    page = tmp_path / "charts.html"
    command = ["goniometer", "tradeoff", "fits", "--sample", "two-component-1", "--rounds", "1"]
    monkeypatch.setattr("sys.argv", [*command, "--page", str(page), "--json"])
    with pytest.raises(SystemExit) as ended:
        main()
    assert not ended.value.code
    charts = json.loads(capsys.readouterr().out)["charts"]
    assert [chart["kind"] for chart in charts] == ["fit-parameters", "fit-colour", "fit-local"]
    assert all(any(choice["on_front"] for choice in chart["choices"]) for chart in charts)
    assert "time of a fit / s" in page.read_text(encoding="utf-8")


@pytest.mark.slow
def test_fits_of_the_bench_come_out_right_by_every_engine_at_all_wavelengths() -> None:
    datasets, known = drawn("sample-1", material("sample-1"), 2)
    parameters, colour, local = fit_charts(datasets, load_conductor(), known, 1, lambda _: None)
    whole = [choice for choice in parameters.choices if choice.name.startswith("401")]
    assert len(whole) == 4
    assert all(choice.error < 1e-3 for choice in whole)
    assert all(choice.error < 0.02 for choice in colour.choices)
    assert all(choice.error < 0.1 for choice in local.choices)


@pytest.mark.slow
def test_more_rays_and_finer_transforms_err_less(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(simulations, "RAYS", (1_000, 10_000))
    monkeypatch.setattr(simulations, "REFERENCE_RAYS", 100_000)
    monkeypatch.setattr(simulations, "WINDOWS", (1,))
    field = topography("gaussian:0.5:4", 64, 0.25, 1, micro=False).field
    rays, sums, waves = simulation_charts("made", field, 1, lambda _: None)
    errors = [choice.error for choice in rays.choices]
    assert errors[-1] < 0.5 * errors[0]
    transforms = [choice.error for choice in sums.choices if choice.family == "fast transform"]
    assert np.all(np.diff(transforms) < 0)
    by_nodes = [choice.error for choice in waves.choices if choice.family == "all places, fewer wavelengths"]
    assert by_nodes[-1] < by_nodes[0]


@pytest.mark.slow
def test_models_that_know_of_the_shift_are_closer_in_colour_than_those_that_do_not() -> None:
    datasets, _ = drawn("sample-1", material("sample-1"), 1)
    told: list[str] = []
    there = find_spec("mitsuba") is not None
    evaluation, size, shading, *rendering = model_charts(
        datasets[0], load_conductor(), False, 1, told.append, rendering=there
    )
    errors = {choice.name: choice.error for choice in evaluation.choices}
    assert errors["cook-torrance-shift"] < 0.3 < errors["cook-torrance"] < errors["lambert"]
    assert errors["table"] < 0.5
    bytes_of = {choice.name: choice.cost for choice in size.choices}
    assert bytes_of["cook-torrance-shift"] == 3 * 8
    shaded = {choice.name: choice.error for choice in shading.choices}
    assert shaded["cook-torrance-shift"] < shaded["cook-torrance"]
    if not rendering:
        pytest.skip("Mitsuba is not installed: " + told[-1])
    rendered = {(choice.family, choice.name): choice.error for choice in rendering[0].choices}
    for name in ("lambert", "tinted", "cook-torrance"):  # another renderer finds the same errors
        assert rendered["table, 31 λ", name] == pytest.approx(shaded[name], rel=0.1, abs=0.05)
    # what Mitsuba has a formula for looks as our file of it does
    assert rendered["Mitsuba's formula", "cook-torrance"] == pytest.approx(shaded["cook-torrance"], rel=0.1)
    assert rendered["Mitsuba's formula", "lambert"] == pytest.approx(shaded["lambert"], rel=0.1)
    assert rendered["table, 31 λ", "cook-torrance-shift"] < 0.1
