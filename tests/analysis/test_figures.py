"""Figures show the measured values where they were measured, and can be read on any page."""

import re
import warnings
from collections.abc import Callable
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest

from analysis.colour import colour_differences
from analysis.figures.curves import distributions, slopes, spectra
from analysis.figures.filled import STEP
from analysis.figures.maps import cell_edges, colour_map, difference_map, difference_scale
from analysis.figures.notation import with_uncertainty
from analysis.figures.shown_colours import Exposure, exposure_of
from analysis.figures.svg import INK, hex_colour, line_colours
from analysis.fits.analyse import analyse
from analysis.fits.noise import at_wavelength
from analysis.reports.measured import measured_chapter
from analysis.reports.models import models_chapter
from analysis.results import SampleAnalysis
from goniometer.datasets.dataset import Dataset, Flag
from goniometer.datasets.fill import fill, unmeasured
from goniometer.uncertainty import ErrorSource

SVG = "{http://www.w3.org/2000/svg}"


@pytest.fixture(scope="module")
def rough_analysis(measure: Callable[..., Dataset]) -> SampleAnalysis:
    """All fits of a rough sample, three incident angles of it."""
    dataset = measure(0.28, 1.5, 2.6, incident=(10, 40, 70), wavelength_step=9.0)
    lineage: dict[str, object] = {"scan": 3, "exposures": list(range(70)), "software_version": "0.1.0"}
    return analyse(replace(dataset, sample="disc <2>", lineage=lineage))


def _all(analysis: SampleAnalysis) -> list[str]:
    dataset = analysis.dataset
    exposure = exposure_of(dataset)
    return [
        colour_map(dataset, dataset.brdf, exposure, "a", "Measured", measured=True),
        colour_map(dataset, dataset.brdf, None, "b", "Hue"),
        difference_map(dataset, analysis.differences["cook-torrance"].absolute, 10, "c", "dE00"),
        difference_scale(10, "d"),
        distributions(dataset, "e"),
        spectra(dataset, analysis.local, "f"),
        *slopes(dataset, analysis.local, analysis.model("global"), "g"),
        *slopes(dataset, analysis.local, analysis.model("cook-torrance-shift"), "h"),
    ]


def test_every_figure_is_well_formed_and_follows_the_page(rough_analysis: SampleAnalysis) -> None:
    drawn = _all(rough_analysis)
    assert len(drawn) == 6 + 2 * 3
    for figure in drawn:
        root = ElementTree.fromstring(figure)
        assert root.tag == f"{SVG}svg"
        assert "currentColor" in figure
        assert INK not in figure
        assert "font-family" not in figure
        assert "<style" not in figure
        assert not re.search(r"(href|src)=\"(?!#)", figure)


def test_ids_are_unique_when_all_figures_stand_in_one_page(rough_analysis: SampleAnalysis) -> None:
    ids = re.findall(r' id="([^"]+)"', "".join(_all(rough_analysis)))
    assert len(ids) == len(set(ids))
    references = re.findall(r'(?:url\(|href=")#([^)"]+)', "".join(_all(rough_analysis)))
    assert set(references) <= set(ids)


def test_the_same_data_gives_the_same_figure(rough_analysis: SampleAnalysis) -> None:
    assert _all(rough_analysis) == _all(rough_analysis)


def test_every_measured_cell_says_its_angles_and_its_value(rough_analysis: SampleAnalysis) -> None:
    dataset = rough_analysis.dataset
    svg = _all(rough_analysis)[0]
    titles = [e.text or "" for e in ElementTree.fromstring(svg).iter(f"{SVG}title")]
    assert len(titles) == dataset.theta_in.size
    f, u = at_wavelength(dataset, 600.0)
    wanted = f"θ in {dataset.theta_in[7]:.1f}°, θ out {dataset.theta_out[7]:.1f}°; "
    assert wanted + f"BRDF at 600 nm = {with_uncertainty(f[7], u[7])} 1/sr" in titles


def test_a_flagged_cell_is_outlined_and_says_for_what(rough_analysis: SampleAnalysis) -> None:
    dataset = rough_analysis.dataset
    flags = dataset.flags.copy()
    flags[7] = Flag.SATURATED | Flag.NEGATIVE
    flags[20] = Flag.CLIPPED
    flagged = replace(dataset, flags=flags)

    def drawn(measured: bool, of: Dataset) -> tuple[list[str], int]:
        svg = colour_map(of, of.brdf, exposure_of(of), "a", "Map", measured=measured)
        root = ElementTree.fromstring(svg)
        titles = [e.text or "" for e in root.iter(f"{SVG}title")]
        return titles, sum(e.get("stroke-dasharray") is not None for e in root.iter(f"{SVG}rect"))

    titles, outlines = drawn(True, flagged)
    assert outlines == 2
    (first,) = [
        t for t in titles if t.endswith("saturated at the shortest integration time, negative beyond the noise")
    ]
    assert first.startswith(f"θ in {dataset.theta_in[7]:.1f}°, θ out {dataset.theta_out[7]:.1f}°; BRDF at 600 nm = ")
    assert sum(t.endswith("footprint leaves the sample") for t in titles) == 1
    assert drawn(True, dataset)[1] == 0
    assert drawn(False, flagged)[1] == 0


def test_flagged_neighbours_have_one_outline(rough_analysis: SampleAnalysis) -> None:
    dataset = rough_analysis.dataset
    row = np.flatnonzero((dataset.theta_in == 40) & (dataset.theta_out > -40))
    flags = np.zeros_like(dataset.flags)
    flags[row] = Flag.BELOW_NOISE
    flagged = replace(dataset, flags=flags)
    svg = colour_map(flagged, dataset.brdf, exposure_of(dataset), "a", "Map", measured=True)
    assert svg.count('stroke-dasharray="2 2"') == 1


def test_what_was_filled_says_so_in_map_and_curves_and_is_no_measured_cell(rough_analysis: SampleAnalysis) -> None:
    dataset = rough_analysis.dataset
    filled = fill(dataset, *unmeasured(dataset, STEP))
    exposure = exposure_of(dataset)
    svg = colour_map(dataset, dataset.brdf, exposure, "a", "Map", measured=True, filled=filled)
    titles = [e.text or "" for e in ElementTree.fromstring(svg).iter(f"{SVG}title")]
    assert sum("not measured" in title for title in titles) == filled.tells.sum() > 0
    assert sum("not measured" not in title for title in titles) == dataset.theta_in.size
    curves = distributions(dataset, "b", filled=filled)
    assert "filled by interpolation, not measured" in curves
    assert "not measured" not in distributions(dataset, "c")


def test_cells_lie_around_their_point_and_never_over_the_blocked_sector(
    rough_analysis: SampleAnalysis,
) -> None:
    dataset = rough_analysis.dataset
    random = np.random.default_rng(2)
    theta_in = dataset.theta_in + random.normal(0, 0.004, dataset.theta_in.size)
    theta_out = random.permutation(dataset.theta_out + 0.01 * np.sign(dataset.theta_in + dataset.theta_out))
    seen = np.abs(dataset.theta_in + theta_out) > 5.1
    theta_in, theta_out = theta_in[seen], theta_out[seen]
    left, right, bottom, top = cell_edges(replace(dataset, theta_in=theta_in, theta_out=theta_out)).T
    assert np.all((left <= theta_out) & (theta_out <= right))
    assert np.all((bottom < theta_in) & (theta_in < top))
    back = -np.round(theta_in / 10) * 10
    assert np.all((right <= back - 4.98) | (left >= back + 4.98))
    # cells of one row do not overlap: their widths sum to what they cover
    row = np.abs(theta_in - 40) < 1
    order = np.argsort(left[row])
    assert np.all(right[row][order][:-1] <= left[row][order][1:] + 1e-9)


def test_a_white_reflector_is_drawn_white_and_a_red_one_red(rough_analysis: SampleAnalysis) -> None:
    theta_in, theta_out = np.zeros(3), np.array([10.0, 20, 30])
    wavelengths = rough_analysis.dataset.wavelengths
    brdf = np.ones((3, wavelengths.size))
    brdf[1] = np.where(wavelengths > 600, 1.0, 0.02)
    brdf[2] *= 0.2140411  # linear light of display value 0.5
    small = replace(
        rough_analysis.dataset,
        theta_in=theta_in,
        theta_out=theta_out,
        brdf=brdf,
        sources=(ErrorSource("random: counts", "random", 0.01 * brdf, None, False),),
        flags=np.zeros(3, dtype=np.uint16),
    )
    svg = colour_map(small, brdf, Exposure(1.0, 0, 3), "x", "x")
    fills = [e.get("fill") or "" for e in ElementTree.fromstring(svg).iter(f"{SVG}rect") if e.get("fill")]
    assert fills[0] == "#ffffff"
    assert fills[2] in ("#7f7f7f", "#808080")
    red, green, blue = (int(fills[1][i : i + 2], 16) for i in (1, 3, 5))
    assert red > 2 * green
    assert red > 2 * blue


def test_lines_can_be_told_from_a_white_and_from_a_black_page() -> None:
    # WCAG 2.2, success criterion 1.4.11: graphics need a contrast of 3 : 1
    for colour in line_colours(12):
        channels = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255
        linear = np.where(channels <= 0.04045, channels / 12.92, ((channels + 0.055) / 1.055) ** 2.4)
        luminance = float(linear @ [0.2126, 0.7152, 0.0722])
        assert 1.05 / (luminance + 0.05) >= 3
        assert (luminance + 0.05) / (0.0077 + 0.05) >= 3  # on #14171b


def test_points_without_a_value_leave_a_pale_cell_and_break_nothing(rough_analysis: SampleAnalysis) -> None:
    dataset = rough_analysis.dataset
    brdf = dataset.brdf.copy()
    brdf[4, 20:30] = np.nan
    brdf[5] = np.nan
    gap = replace(dataset, brdf=brdf)
    svg = colour_map(gap, brdf, exposure_of(gap), "x", "x")
    assert "#80808026" in svg
    ElementTree.fromstring(distributions(gap, "y"))
    ElementTree.fromstring(spectra(gap, rough_analysis.local, "z"))


def test_a_dataset_whose_spectra_all_have_a_gap_is_reported_without_colours_and_without_warnings(
    rough_analysis: SampleAnalysis,
) -> None:
    dataset = rough_analysis.dataset
    brdf = dataset.brdf.copy()
    brdf[:, 30] = np.nan
    gap = replace(dataset, brdf=brdf)
    differences = {
        name: colour_differences(brdf, rough_analysis.model(name).fitted, gap.wavelengths, gap.theta_in)
        for name in ("cook-torrance", "cook-torrance-shift")
    }
    models = tuple(
        replace(fit, comparison=fit.comparison and replace(fit.comparison, dE00=float("nan")))
        for fit in rough_analysis.models
    )
    analysis = replace(rough_analysis, dataset=gap, models=models, differences=differences)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        page = measured_chapter(analysis) + models_chapter(analysis)
    assert not re.search(r"\bnan\b", page)
    assert "No cell has a colour" in page
    assert "mean not known" in page
    assert "No cell has a colour" not in measured_chapter(rough_analysis)
    black = exposure_of(replace(dataset, brdf=np.zeros_like(brdf)))
    assert (black.factor, black.clipped, black.coloured) == (1.0, 0, dataset.theta_in.size)


def test_a_sample_that_drowns_in_noise_still_gets_its_report(rough_analysis: SampleAnalysis) -> None:
    dataset = rough_analysis.dataset
    noise = ErrorSource("random: counts", "random", dataset.brdf, None, False)
    noisy = replace(dataset, sources=(noise,))
    svg = spectra(noisy, rough_analysis.local, "z")
    assert "no spectrum stands clear of its noise" in "".join(ElementTree.fromstring(svg).itertext())


@pytest.mark.parametrize(
    ("value", "u", "text"),
    [
        # JCGM 100:2008, 7.2.2, example 2: m_s = 100.021 47 g with u_c = 0.35 mg
        (100.02147, 0.00035, "100.02147(35)"),
        (1.23412, 0.01234, "1.234(12)"),
        (-0.00033, 0.0021, "−0.0003(21)"),
        (4321.2, 13.7, "4321(14)"),
        (12345.6, 0.0996, "12345.60(10)"),
        (1.2341e-5, 1.234e-7, "1.234(12) × 10⁻⁵"),
        (-12.4, 171790.0, "0(170000)"),
        (0.0, float("inf"), "0 (uncertainty not determined)"),
        (float("nan"), 1.0, "no value"),
    ],
)
def test_uncertainties_are_written_as_metrology_writes_them(value: float, u: float, text: str) -> None:
    assert with_uncertainty(value, u) == text


def test_colours_are_clipped_into_what_a_page_can_show() -> None:
    assert hex_colour((1.5, -0.2, 0.5)) == "#ff0080"
