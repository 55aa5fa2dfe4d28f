"""The map of failures shows every cell in numbers, and a silent failure apart from one that was said."""

import math
from xml.etree import ElementTree

from analysis.figures.stability import MapCell, stability_map

ROWS = [("outliers", "one"), ("outliers", "many"), ("mixture", "of normals")]


def test_every_cell_says_how_many_are_right_and_how_many_trusted() -> None:
    found = {
        ("outliers", "one", "local"): MapCell(1.0, 1.0, 0, "all well"),
        ("outliers", "many", "local"): MapCell(0.25, 0.5, 2, "a < b & c"),
        ("mixture", "of normals", "local"): MapCell(math.nan, 0.0, 0, "no truth"),
    }
    svg = stability_map(ROWS, ["local", "global"], found, "map")
    ElementTree.fromstring(svg)
    for text in ("100 / 100", "✕2  25 / 50", "– / 0", "one", "many", "global"):
        assert text in svg
    assert "a &lt; b &amp; c" in svg
    assert svg.count("<title>") == 3
    assert svg.count("outliers") == 1
