"""What came of analyses, as pages draw it: how to ask for a way, the runs behind a cell, the pictures of a choice."""

import base64
import io
import json
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.image import imread

from analysis.strict_json import strict_json
from analysis.tradeoff import charts_json
from api.choices import ChartKind
from api.results.choose import choice_content, choice_pictures, choose_model
from api.results.stability import stability_content
from api.results.tradeoff import charts
from api.views.analyses import choice, ensemble, stability_map, tradeoff
from goniometer.campaigns.campaign import Campaign
from goniometer.errors import NotInStore
from goniometer.storage.store import Store
from simulators.stability.ensemble import cells, jobs
from simulators.stability.ensemble import ensemble as runs_of
from tests.drawn_dataset import drawn_dataset


@pytest.fixture(scope="module")
def stability() -> dict[str, Any]:
    """The result of a small map, as the database keeps it."""
    with ThreadPoolExecutor(1) as executor:
        runs = list(runs_of(jobs(["few points"], ["local", "global"], 2), executor))
    result: dict[str, Any] = json.loads(strict_json(stability_content(cells(runs), runs)))
    return result


def test_the_runs_behind_a_cell_tell_value_error_and_truth_of_which_the_cell_is_made(
    stability: dict[str, Any],
) -> None:
    shown = stability_map(7, stability)
    assert shown.methods == ["local", "global"]
    cell = next(c for c in shown.cells if (c.level, c.method) == ("50 points", "global"))
    found = ensemble(7, stability, cell.regime, cell.level, cell.method)
    assert [run.seed for run in found.runs] == [1, 2]
    assert cell.trusted == np.mean([run.trusted for run in found.runs])
    for run in found.runs:
        assert run.z, "a good verdict vouches for something"
        for name, z in run.z.items():
            told = run.estimates[name]
            assert z == pytest.approx((told.value - told.true) / told.u)  # type: ignore[operator]  # all are known
    shifts = [run.estimates["h"] for run in found.runs]
    bias = np.mean([h.value - h.true for h in shifts])  # type: ignore[operator]  # all are known
    assert cell.bias["h"] == pytest.approx(bias)
    with pytest.raises(NotInStore, match="no cell few points, 50 points, guess"):
        ensemble(7, stability, "few points", "50 points", "guess")


def test_what_an_older_version_has_kept_is_refused_in_words(stability: dict[str, Any]) -> None:
    older = {name: value for name, value in stability.items() if name != "runs"}
    with pytest.raises(NotInStore, match="run it again"):
        ensemble(7, older, "few points", "50 points", "global")


@pytest.mark.slow
def test_a_scan_of_the_chart_is_a_campaign_that_plans_as_many_points() -> None:
    made = charts(ChartKind.SCANS, drawn_dataset("sample-4"), "", "", 1, lambda _: None, dielectric=False)
    shown = tradeoff(3, json.loads(strict_json({"charts": charts_json(made)})))
    uses = [way.use for way in shown.charts[0].choices]
    assert all(use is not None and use.kind == "campaign" for use in uses)
    for use in uses:
        assert use is not None
        asked = {"name": "Chart", "samples": [{"name": "A", "material": "sample-4"}], "resolution": use.settings}
        resolution = Campaign.model_validate(asked).resolution
        assert resolution.mode == use.settings["mode"]
        for name in use.settings.keys() & {"tolerance", "step"}:
            assert getattr(resolution, name) == use.settings[name]


@pytest.mark.slow
def test_a_choice_shows_the_scene_by_measurement_and_model_and_how_they_differ(tmp_path: Path) -> None:
    store = Store.open(tmp_path / "bench.db")
    number = store.add_dataset(None, drawn_dataset("sample-1"))
    text = (
        "camera: {position: [0, -4, 1], pixels: [16, 16], field_of_view: 32}\nmaterial: [{sphere: 1}]\n"
        "lights: [{sun: [1, -1, 1]}]\n"
    )
    scene = tmp_path / "sun.yaml"
    scene.write_text(text)
    found = choose_model(store, number, scene, 2.0, dielectric=False, rendering=False)
    result = {"dataset": number, "sample": "sample-1"} | choice_content(found) | {"pictures": choice_pictures(found)}
    kept = json.loads(strict_json(result))
    shown = choice(5, json.dumps({"scene": text}), kept)
    assert shown.chosen is not None
    assert shown.chosen.name in shown.words[0]
    assert [picture.name for picture in shown.pictures] == ["measurement", "model", "difference"]
    images = [imread(io.BytesIO(base64.b64decode(picture["png"])), format="png") for picture in kept["pictures"]]
    seen = images[0][..., 3] > 0
    assert 0.3 < seen.mean() < 1, "a sphere, and nothing beside it"
    assert all(image.shape == images[0].shape for image in images)
    # what meets the tolerance looks like the measurement
    assert np.abs(images[0] - images[1])[seen, :3].mean() < 0.05
