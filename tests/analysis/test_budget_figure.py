"""The figures of a budget show what the budget says, and can be read on any page by any eye."""

import re
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest

from analysis.figures.budget import (
    LOOKS,
    budget_page,
    budget_panels,
    budget_table,
    relative_in_words,
    share_in_words,
)
from analysis.figures.notation import uncertainty
from analysis.figures.svg import INK, side_by_side
from drivers.arrays import FloatArray
from goniometer.datasets.budget import budget
from goniometer.datasets.dataset import Dataset
from goniometer.errors import GeometryError
from goniometer.uncertainty import PARTS, ErrorSource, everywhere
from tests.drawn_dataset import drawn_dataset

SVG = "{http://www.w3.org/2000/svg}"


@pytest.fixture(scope="module")
def dataset() -> Dataset:
    """A measured lobe with an error of every part."""
    drawn = drawn_dataset("sample-4")

    def source(part: str, values: FloatArray) -> ErrorSource:
        return ErrorSource(f"{part}: more", part, values, everywhere(drawn.theta_in.size), True)

    sizes = np.geomspace(2e-3, 1e-5, len(PARTS))
    more = tuple(source(part, size * drawn.brdf) for part, size in zip(PARTS, sizes, strict=True))
    return replace(drawn, sample="disc <2>", sources=drawn.sources + more)


def test_every_part_of_a_budget_has_a_look_of_its_own() -> None:
    assert tuple(LOOKS) == PARTS
    assert len({colour for colour, _, _ in LOOKS.values()}) == len(PARTS)


def test_colours_can_be_told_from_a_white_and_from_a_black_page() -> None:
    # WCAG 2.2, success criterion 1.4.11: graphics need a contrast of 3 : 1
    for colour, _, _ in LOOKS.values():
        channels = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255
        linear = np.where(channels <= 0.04045, channels / 12.92, ((channels + 0.055) / 1.055) ** 2.4)
        luminance = float(linear @ [0.2126, 0.7152, 0.0722])
        assert 1.05 / (luminance + 0.05) >= 3, colour
        assert (luminance + 0.05) / (0.0077 + 0.05) >= 3, colour  # on #14171b


def test_panels_follow_the_page_and_name_every_part_and_unit(dataset: Dataset) -> None:
    shares, angles = budget_panels(dataset, 40, 40)
    for panel in (shares, angles):
        assert ElementTree.fromstring(panel).tag == f"{SVG}svg"
        assert "currentColor" in panel
        assert INK not in panel
    assert "wavelength / nm" in shares
    assert "share of the variance / %" in shares
    assert "reflected angle θ out / °" in angles
    assert "(k = 1)" in angles
    for part in PARTS:
        assert re.search(rf">\s*{part}\s*<", shares), part
        assert re.search(rf">\s*{part}\s*<", angles), part


def test_ids_are_unique_where_both_panels_stand_in_one_page(dataset: Dataset) -> None:
    drawn = "".join(budget_panels(dataset, 40, 40))
    ids = re.findall(r' id="([^"]+)"', drawn)
    assert len(ids) == len(set(ids))
    assert set(re.findall(r'(?:url\(|href=")#([^)"]+)', drawn)) <= set(ids)


def test_a_file_of_both_panels_stands_alone_and_shows_them_side_by_side(dataset: Dataset) -> None:
    root = ElementTree.fromstring(side_by_side(budget_panels(dataset, 40, 40)))
    inner = root.findall(f"{SVG}svg")
    assert [float(each.get("x") or 0) for each in inner] == [0, 430]
    assert root.get("viewBox") == "0 0 860 290"


def test_the_table_says_all_parts_the_sum_and_the_coverage_factor(dataset: Dataset) -> None:
    found = budget(dataset, 40, 40, 600)
    table = budget_table(found)
    ElementTree.fromstring(table)
    for part in found.parts:
        assert part.name in table
        assert f'<td class="number">{uncertainty(abs(part.u))}</td>' in table
    assert "combined, k = 1" in table
    assert "expanded, k = 2" in table
    told = re.search(r"BRDF = ([\d.]+)\(\d\d\) 1/sr \(k = 1\); expanded uncertainty ± ([\d.]+) 1/sr \(k = 2: 95", table)
    assert told
    assert [float(number) for number in told.groups()] == pytest.approx([found.brdf, 2 * found.u], rel=0.05)
    page = budget_page(found, budget_panels(dataset, 40, 40), "What they show.")
    assert "disc &lt;2&gt;: uncertainty budget" in page
    assert "src=" not in page


def test_what_is_too_small_to_write_is_not_called_zero() -> None:
    assert (relative_in_words(-0.01234), relative_in_words(3e-9)) == ("1.2 %", "< 0.01 %")
    assert (share_in_words(0.7581), share_in_words(0.0004), share_in_words(1)) == ("75.8 %", "< 0.1 %", "100.0 %")


def test_gaps_and_negative_values_break_nothing(dataset: Dataset) -> None:
    brdf = dataset.brdf.copy()
    brdf[3], brdf[dataset.theta_out < -60], brdf[:, 5] = np.nan, -1e-6, np.nan
    for panel in budget_panels(replace(dataset, brdf=brdf), 40, 40):
        ElementTree.fromstring(panel)
    with pytest.raises(GeometryError):
        budget_panels(dataset, 44, 44)
