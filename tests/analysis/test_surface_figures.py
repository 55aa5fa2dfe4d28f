"""Pictures of a topography show its heights where they are, and stay small enough to send."""

import base64
import io
import re
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib import colormaps
from matplotlib.image import imread

from analysis.figures.topographies import (
    autocorrelation_figure,
    height_histogram,
    perspective,
    slope_distribution,
    top_view,
)

Y, X = np.indices((200, 300)) * 0.5
HILL = 2.0 * np.exp(-((X - 110) ** 2 + (Y - 25) ** 2) / 200)
"""[y, x] one hill near the lower right corner of a patch of 150 x 100 um."""


def pictures(svg: str) -> list[np.ndarray]:
    """[up, right, rgba] the images in an SVG, as they are seen."""
    found = []
    for element in ElementTree.fromstring(svg).iter("{http://www.w3.org/2000/svg}image"):
        data = element.attrib["{http://www.w3.org/1999/xlink}href"].split(",", 1)[1]
        image = imread(io.BytesIO(base64.b64decode(data)))
        # stored from the top down; a negative vertical scale puts the first row at the bottom
        vertical = re.findall(r"scale\(\S+ (-?[\d.]+)\)|matrix\(\S+ \S+ \S+ (-?[\d.]+)", element.attrib["transform"])
        sign = np.prod([float(a or b) for a, b in vertical])
        found.append(image[::-1] if sign > 0 else image)
    return found


def test_a_hill_is_seen_where_it_is_and_in_the_colour_of_its_height() -> None:
    image = max(pictures(top_view(HILL, 0.5, "hill")), key=np.size)
    assert image.shape[1] / image.shape[0] == pytest.approx(1.5, rel=0.02)
    colours = colormaps["viridis"](np.linspace(0, 1, 64))
    height = np.argmin(((image[:, :, None, :3] - colours[:, :3]) ** 2).sum(axis=-1), axis=2)
    row, column = np.unravel_index(height.argmax(), height.shape)
    assert (column + 0.5) / image.shape[1] * 150 == pytest.approx(110, abs=8)
    assert (row + 0.5) / image.shape[0] * 100 == pytest.approx(25, abs=8)
    assert height[-1, 0] == 0


def test_the_side_view_hides_what_is_behind_a_wall() -> None:
    def visible_ground(begin: float) -> int:
        """Pixels in the colour of the lowest height, beside a wall of 20 um in the picture that begins at y."""
        (image,) = pictures(perspective(np.where((begin <= Y) & (begin + 2 > Y), 100.0, 0.0), 0.5, "wall"))
        low = np.array(colormaps["viridis"](0.0)[:3])
        hue = image[..., :3] / np.linalg.norm(image[..., :3], axis=-1, keepdims=True).clip(1e-9)
        return int(((hue @ (low / np.linalg.norm(low)) > 0.999) & (image[..., 3] == 1)).sum())

    # seen from 38 degrees above and 28 degrees beside, a wall hides its height / tan 38, times cos 28 of it along y
    hidden = 20 / np.tan(np.radians(38)) * np.cos(np.radians(28))
    assert visible_ground(40) / visible_ground(98) == pytest.approx((98 - hidden) / 98, abs=0.03)


@pytest.mark.parametrize("width", [252.0, 400.0])
def test_views_of_a_large_rough_map_are_small_files(width: float) -> None:
    rough = np.random.default_rng(1).normal(size=(1500, 1500))
    size = len(top_view(rough, 0.625, "a", width=width)) + len(perspective(rough, 0.625, "b", width=width))
    assert size < 1.2e6 * (width / 400) ** 2


def test_a_flat_surface_is_drawn_too() -> None:
    flat = np.zeros((40, 30))
    correlation = np.full(flat.shape, np.nan)
    for svg in (
        top_view(flat, 1.0, "a"),
        perspective(flat, 1.0, "b"),
        height_histogram(flat, "c"),
        slope_distribution(np.zeros((50, 2)), "d"),
        autocorrelation_figure(correlation, 1.0, float("nan"), 0.2, "e"),
    ):
        assert ElementTree.fromstring(svg).tag == "{http://www.w3.org/2000/svg}svg"


def test_distributions_name_the_rms_of_what_they_show() -> None:
    random = np.random.default_rng(2)
    heights = random.normal(scale=0.5, size=(100, 100))
    heights *= 0.5 / heights.std()
    assert "Sq = 0.5 µm" in height_histogram(heights, "a")
    slopes = np.array([[0.3, -0.1], [-0.3, 0.1]])
    drawn = slope_distribution(slopes, "b")
    assert "dz/dx, rms 0.3" in drawn
    assert "dz/dy, rms 0.1" in drawn
    lag = np.hypot(*np.ogrid[-50:50, -50:50])
    assert "Sal = 12.7 µm" in autocorrelation_figure(np.exp(-((lag / 20) ** 2)), 0.5, 12.7, 0.2, "c")
