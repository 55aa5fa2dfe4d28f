"""A campaign for a scene measures what the scene asks for, and says in one line what is wrong with its file."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from goniometer.campaigns.campaign_file import load_campaign
from goniometer.campaigns.scene_weights import STEP_D, STEP_H, SceneWeights, weights_on_nodes
from goniometer.errors import CampaignError
from goniometer.plans.plan import Measured, next_points, reached
from goniometer.plans.plan_spec import coarse, incident, plan_spec, reference_points
from tests.benchmarks.sampling import measure
from tests.benchmarks.sampling_materials import MATERIALS

CAMPAIGN = "name: a\nsamples: [{name: A, material: m}]\n"


def _weights(theta_d: float = 40.0, slope: float = 20.0) -> SceneWeights:
    """A scene in the sun: one angle between light and camera, all normals."""
    rng = np.random.default_rng(1)
    theta_h = np.abs(rng.normal(0, 15, 4000)).clip(0, 90 - theta_d)
    table = weights_on_nodes(theta_h, np.full_like(theta_h, theta_d), np.ones_like(theta_h))
    return SceneWeights(scene="sun", colour_slope=slope, weights=tuple(map(tuple, table.tolist())))


def _write(folder: Path, content: object) -> Path:
    (folder / "weights.json").write_text(content if isinstance(content, str) else json.dumps(content))
    path = folder / "campaign.yaml"
    path.write_text(CAMPAIGN + "resolution: {scene: weights.json, colour_tolerance: 0.5}\n")
    return path


def test_weights_keep_their_sum_and_their_place() -> None:
    table = weights_on_nodes(np.array([1.0, 33.0]), np.array([40.0, 47.0]), np.array([1.0, 3.0]))
    assert table.sum() == pytest.approx(1)
    rows, columns = np.arange(table.shape[0]) * STEP_H, np.arange(table.shape[1]) * STEP_D
    assert rows @ table.sum(axis=1) == pytest.approx((1 + 3 * 33) / 4)
    assert table.sum(axis=0) @ columns == pytest.approx((40 + 3 * 47) / 4)


def test_what_a_scene_asks_for_matters_and_its_reverse_is_not_measured_again() -> None:
    weights = _weights()
    # theta_d = 40 and theta_h = 10
    asked, reverse, elsewhere = weights.importance(np.array([50.0, 30.0, 20.0]), np.array([30.0, 50.0, -60.0]))
    assert asked > 50 * reverse
    assert reverse == elsewhere
    assert elsewhere > 0


def test_a_campaign_carries_its_scene_with_it(tmp_path: Path) -> None:
    path = _write(tmp_path, _weights().model_dump())
    campaign = load_campaign(path)
    (tmp_path / "weights.json").unlink()  # not needed any more
    spec = plan_spec(campaign)
    assert spec.tolerance == math.inf
    assert spec.colour_tolerance == 0.5
    assert spec.colour_slope == 20.0
    usual = load_campaign(_write_usual(tmp_path))
    assert plan_spec(usual).importance is None
    other = load_campaign(_write(tmp_path, _weights(slope=21.0).model_dump()))
    assert len({campaign.hash, usual.hash, other.hash}) == 3


def _write_usual(folder: Path) -> Path:
    path = folder / "usual.yaml"
    path.write_text(CAMPAIGN + "resolution: {colour_tolerance: 0.5}\n")
    return path


def test_a_scan_for_a_scene_needs_few_points_and_says_when_it_is_accurate(tmp_path: Path) -> None:
    spec = plan_spec(load_campaign(_write(tmp_path, _weights().model_dump())))
    usual = plan_spec(load_campaign(_write_usual(tmp_path)))
    assert set(incident(spec)) < set(spec.theta_in)
    assert len(coarse(spec)) < 0.5 * len(coarse(usual))
    truth, random = MATERIALS["GGX 0.25"], np.random.default_rng(2)
    measured: list[Measured] = []
    while batch := next_points(spec, measured):
        assert not any(g.blocked for g in batch)
        measured += measure(truth, batch, random)
    told = reached(spec, measured)
    assert told.stopped == "accuracy"
    assert told.colour_error <= 0.5
    assert len(measured) <= 50
    panel = reference_points(spec)
    assert len(panel) < 0.7 * len(reference_points(usual))
    for point in measured:  # else they would have no value
        angles = [g.theta_out for g in panel if g.theta_in == point.geometry.theta_in]
        assert min(angles) <= point.geometry.theta_out <= max(angles)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ("{", "JSON"),
        ({"weights": [[1.0]]}, "37 rows"),
        ({"colour_slope": -1}, "colour_slope"),
        ({"weights": [[0.0] * 10] * 37}, "nothing that can be measured"),
    ],
)
def test_a_file_of_weights_that_is_none_is_refused_in_one_line(
    tmp_path: Path, change: str | dict[str, Any], says: str
) -> None:
    content = change if isinstance(change, str) else _weights().model_dump() | change
    with pytest.raises(CampaignError, match=says) as fault:
        load_campaign(_write(tmp_path, content))
    assert "\n" not in str(fault.value)
    assert "weights.json" in str(fault.value)


def test_an_even_grid_has_no_use_for_a_scene(tmp_path: Path) -> None:
    path = _write(tmp_path, _weights().model_dump())
    path.write_text(CAMPAIGN + "resolution: {scene: weights.json, mode: uniform}\n")
    with pytest.raises(CampaignError, match="dynamic"):
        load_campaign(path)
