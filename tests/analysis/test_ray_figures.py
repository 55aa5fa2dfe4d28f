"""The pictures of scattered light by the number of reflections show every share that is known, and none that is not."""

from xml.etree import ElementTree

import numpy as np

from analysis.figures.rays import ORDER_COLOURS, halves_panel, share_panel

SVG = "{http://www.w3.org/2000/svg}"


def bars(svg, colour):
    """Heights of the bars of a colour, SVG units."""
    found = [path for path in ElementTree.fromstring(svg).iter(f"{SVG}path") if colour in (path.get("style") or "")]
    points = [
        [float(n) for n in path.get("d").replace("M", "").replace("L", "").replace("z", "").split()] for path in found
    ]
    return [max(each[1::2]) - min(each[1::2]) for each in points if len(each) == 8]


def test_every_lit_direction_has_its_bar_and_dark_ones_have_none():
    share = np.array([[1, 0, 0, 0], [0.5, 0.25, 0.15, 0.1], [np.nan] * 4, [0.7, 0.1, 0.1, 0.1]])
    svg = share_panel(40.0, np.array([-5.0, 0, 5, 10]), share, 0.01 * np.ones((4, 4)), "a")
    once = bars(svg, ORDER_COLOURS[0])[:3]
    np.testing.assert_allclose(np.array(once) / once[0], [1, 0.5, 0.7], atol=0.01)
    twice = bars(svg, ORDER_COLOURS[1])[:3]
    np.testing.assert_allclose(np.array(twice) / once[0], [0, 0.25, 0.1], atol=0.01)
    assert "40°" in svg
    assert "nan" not in svg.lower()
    assert "currentColor" in svg


def test_where_light_goes_is_drawn_although_none_of_it_went_back():
    share = np.array([[[0.5, 0.5], [0, 0]], [[0.1, 0.8], [0, 0.1]]])
    svg = halves_panel(np.array([0.0, 60.0]), share, 0.01 * share, "b")
    assert all(words in svg for words in ("once, forward", "more often, back"))
    assert "nan" not in svg.lower()
