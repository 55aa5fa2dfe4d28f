"""`goniometer tradeoff` charts what it says it does."""

import json
from pathlib import Path

import numpy as np
import pytest

from analysis.fresnel import load_conductor
from analysis.tradeoff_fits import fit_charts
from api.cli import main
from drivers.arrays import FloatArray
from simulators.materials import material, true_brdf
from simulators.topography import topography
from simulators.tradeoff_bench import drawn
from simulators.tradeoff_scans import scan_charts
from simulators.tradeoff_simulations import simulation_charts


def test_a_dynamic_scan_is_on_the_front_of_a_narrow_lobe() -> None:
    def truth(theta_in: FloatArray, theta_out: FloatArray, wavelengths: FloatArray) -> FloatArray:
        return true_brdf(material("sample-8"), theta_in, theta_out, wavelengths) * np.cos(np.radians(theta_in))[:, None]

    error, colour = scan_charts("sample-8", truth, (0.0, 30.0, 60.0), 1, lambda _: None)
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
def test_more_rays_and_finer_transforms_err_less() -> None:
    field = topography("gaussian:0.5:4", 256, 0.25, 1, micro=False).field
    rays, sums, waves = simulation_charts("made", field, 1, lambda _: None)
    errors = [choice.error for choice in rays.choices]
    assert errors[-1] < 0.5 * errors[0]
    transforms = [choice.error for choice in sums.choices if choice.family == "fast transform"]
    assert np.all(np.diff(transforms) < 0)
    by_nodes = [choice.error for choice in waves.choices if choice.family == "all places, fewer wavelengths"]
    assert by_nodes[-1] < by_nodes[0]
