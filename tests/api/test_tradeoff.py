"""`goniometer tradeoff` charts what it says it does."""

import json

import numpy as np
import pytest

from analysis.fresnel import load_conductor
from analysis.tradeoff_fits import fit_charts
from api.cli import main
from simulators.materials import material
from simulators.topography import topography
from simulators.tradeoff_bench import drawn
from simulators.tradeoff_simulations import simulation_charts


def test_scans_of_a_bench_material_are_charted_with_a_dynamic_one_on_the_front(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path
) -> None:
    page = tmp_path / "charts.html"
    command = ["goniometer", "tradeoff", "scans", "--sample", "sample-1", "--rounds", "1", "-o", str(page), "--json"]
    monkeypatch.setattr("sys.argv", command)
    with pytest.raises(SystemExit) as ended:
        main()
    assert not ended.value.code
    charts = json.loads(capsys.readouterr().out)["charts"]
    assert [chart["kind"] for chart in charts] == ["scan-error", "scan-colour"]
    best = [choice["family"] for choice in charts[0]["choices"] if choice["on_front"]]
    assert "dynamic" in best
    assert "Scanning" in page.read_text(encoding="utf-8")


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
