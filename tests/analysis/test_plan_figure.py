"""A plan's pictures show every direction, and nothing that a page would have to fetch."""

from xml.etree import ElementTree

import pytest

from analysis.figures.plan import arm_view, polar_view
from goniometer.plans.plan import next_points
from goniometer.plans.plan_spec import PlanSpec

SPEC = PlanSpec((0.0, 30.0, 60.0))
SVG = "{http://www.w3.org/2000/svg}"


@pytest.fixture(scope="module")
def plan():
    return next_points(SPEC, [])


def dots(svg, fill):
    return sum(fill in (use.get("style") or "") for use in ElementTree.fromstring(svg).iter(f"{SVG}use"))


def test_every_planned_direction_is_a_dot(plan):
    svg = polar_view(plan, "a")
    assert dots(svg, "fill: #3a7bd5") == len(plan)
    assert f"{len(plan)} directions at 3 incident angles" in svg


def test_the_way_of_the_arm_passes_all_directions_and_follows_the_ink_of_the_page(plan):
    svg = arm_view(plan, "c")
    assert dots(svg, "fill: #3a7bd5") == len(plan)
    assert "currentColor" in svg
    assert "http://" not in svg.replace("http://www.w3.org", "")
