"""The report stands alone, says what may be trusted, and what was left out."""

import re
from collections.abc import Callable
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from analysis.bsdf.error import RelativeError
from analysis.bsdf.export import BsdfReport, Tried
from analysis.bsdf.search import Budget
from analysis.errors import ExportError
from analysis.figures.notation import uncertainty, with_uncertainty
from analysis.fits.analyse import analyse
from analysis.reports.report import RunFacts, report_html, write_report
from analysis.results import Parameter, SampleAnalysis, Verdict
from goniometer.datasets.dataset import Check, Dataset, Flag

ERROR = RelativeError(0.0081, 0.0153, 0.0242)
FACTS = RunFacts(
    uniform_points=483,
    bench_time=754.2,
    blocked_points=27,
    failed_points=2,
    too_noisy="12 points stayed below the wanted ratio & more.",
    files=(("disc.json", "all fits"), ("disc & more.bsdf", "for rendering")),
    bsdf=BsdfReport(
        Path("disc.bsdf"),
        5,
        "flat",
        np.arange(6.0),
        Budget(),
        "Clamped: a trifle.",
        {"flat": Tried(5, 8, 12, ERROR, 0.043, 0.1, 0.93)},
        "",
    ),
)


@pytest.fixture(scope="module")
def rough_analysis(measure: Callable[..., Dataset]) -> SampleAnalysis:
    """All fits of a rough sample, three incident angles of it."""
    dataset = measure(0.28, 1.5, 2.6, incident=(10, 40, 70), wavelength_step=9.0)
    lineage: dict[str, object] = {
        "scan": 3,
        "exposures": list(range(70)),
        "certificate": "SRS-99-010, serial 1234",
        "certificate_calibrated": "2023-04-05",
        "certificate_valid_until": None,
        "certificate_sha256": "5e1f",
        "software_version": "0.1.0",
    }
    return analyse(replace(dataset, sample="disc <2>", lineage=lineage))


class _Reader(HTMLParser):
    """Collects tags and text, and checks that every element is closed in order."""

    VOID = ("meta", "br")

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.text = ""
        self.links: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in self.VOID:
            self.open.append(tag)
        self.links += [value or "" for name, value in attrs if name in ("href", "src", "xlink:href")]

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.links += [value or "" for name, value in attrs if name in ("href", "src", "xlink:href")]

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data


@pytest.fixture(scope="module")
def html(rough_analysis: SampleAnalysis) -> str:
    return report_html(rough_analysis, FACTS)


@pytest.fixture(scope="module")
def page(html: str) -> _Reader:
    reader = _Reader()
    reader.feed(html)
    assert reader.open == []
    return reader


def test_the_report_needs_no_network(html: str, page: _Reader) -> None:
    outside = [link for link in page.links if not link.startswith("#")]
    assert outside == ["disc.json", "disc & more.bsdf"]
    namespaces = ("http://www.w3.org/2000/svg", "http://www.w3.org/1999/xlink")
    assert set(re.findall(r"https?://[^\"'\s<)]+", html)) <= set(namespaces)
    assert "@import" not in html
    assert "<script" not in html
    assert len(html.encode()) < 3e6


def test_any_model_has_its_pictures_its_verdict_and_what_it_gains(rough_analysis: SampleAnalysis) -> None:
    models = ("global", "global-two-component", "cook-torrance", "cook-torrance-shift", "dielectric")
    analysis = analyse(rough_analysis.dataset, models=models)
    html = report_html(analysis, FACTS)
    page = _Reader()
    page.feed(html)
    table = page.text[page.text.index("What speaks for each model") : page.text.index("Parametersmodel")]
    gained = analysis.model("cook-torrance-shift").comparison
    assert gained is not None
    assert f"Cook-Torrance{gained.bic:.0f}{gained.dE00:.2f}" in table
    assert "loew; ggx; fast" in table
    assert "Diffuse albedo" in page.text
    assert "Dashed: Global model, two components" in page.text
    # a second component is not there, so the data do not tell where it would take over
    assert "thresholdnot determined" in page.text
    ids = re.findall(r'\sid="([^"]+)"', html)
    assert len(ids) == len(set(ids))


def test_ids_are_unique_in_the_whole_page(html: str) -> None:
    ids = re.findall(r'\sid="([^"]+)"', html)
    assert len(ids) == len(set(ids))


def test_a_sample_name_cannot_break_the_page(page: _Reader, html: str) -> None:
    assert "disc <2>" in page.text
    assert "<2>" not in html


def test_the_report_says_both_mean_colour_differences_of_both_models(
    page: _Reader, rough_analysis: SampleAnalysis
) -> None:
    for model, title in (("cook-torrance", "Cook-Torrance"), ("cook-torrance-shift", "Cook-Torrance with shift")):
        absolute, chromatic = (
            rough_analysis.differences[model].statistics(k)["mean"] for k in ("absolute", "chromatic")
        )
        assert f"{title}{absolute:.2f}{chromatic:.2f}" in page.text


def test_parameters_carry_their_uncertainty_and_unit(page: _Reader, rough_analysis: SampleAnalysis) -> None:
    fit = rough_analysis.model("cook-torrance-shift")
    assert f"h{with_uncertainty(fit.value('h'), fit.standard_error('h'))} /µm" in page.text
    assert page.text.count("coverage factor") >= 4


def test_the_report_says_what_was_left_out_and_how_good_the_rendering_file_is(page: _Reader) -> None:
    assert "Directions within 5° of the way back to the lamp (27 of a 1° grid)" in page.text
    assert "2 directions could not be measured" in page.text
    assert "12 min 34 s" in page.text
    assert "0.8 % at the median, by less than 1.5 % in 99 of 100 directions and by 2.4 % at most" in page.text


def test_points_that_are_noisier_than_was_wanted_are_announced(page: _Reader) -> None:
    assert "12 points stayed below the wanted ratio & more." in page.text


def test_the_certificate_stands_where_the_numbers_come_from_with_its_day_and_its_digest(page: _Reader) -> None:
    table = page.text[page.text.index("Where the numbers come from") :]
    for row in ("certificateSRS-99-010, serial 1234", "certificate calibrated2023-04-05", "certificate sha2565e1f"):
        assert row in table
    assert "valid until" not in table


def test_what_makes_the_parameters_uncertain_stands_beside_them(page: _Reader, rough_analysis: SampleAnalysis) -> None:
    assert "What the parameters' uncertainty is made of" in page.text
    alpha = rough_analysis.model("cook-torrance-shift").parameters[0]
    for part in ("random", "dark", "angle"):
        assert uncertainty(alpha.error_by_part[part]) in page.text


def test_the_budget_of_the_mirror_direction_nearest_45_degrees_is_shown(page: _Reader) -> None:
    assert "Uncertainty budget" in page.text
    assert "θ in = 40.0°, θ out = 40.0°" in page.text
    assert "expanded, k = 2" in page.text


def test_checks_and_flags_are_shown_and_a_failed_one_is_announced_before_anything_else(
    rough_analysis: SampleAnalysis,
) -> None:
    dataset = rough_analysis.dataset
    flags = dataset.flags.copy()
    flags[dataset.theta_in == 70] = Flag.CLIPPED
    flags[dataset.theta_in == 10] = Flag.NEGATIVE
    checks = (
        Check("reciprocity", True, "All pairs agree & more."),
        Check("homogeneity", False, "Another spot is <rougher>."),
        Check("drift", None, "The lamp was not watched."),
    )
    lineage = {"certificate_override": "M. Curie overrode it: the new one is on its way."}
    html = report_html(
        replace(rough_analysis, dataset=replace(dataset, flags=flags, checks=checks, lineage=lineage)), FACTS
    )
    reader = _Reader()
    reader.feed(html)
    assert "✓ passedreciprocityAll pairs agree & more." in reader.text
    assert "✗ failedhomogeneityAnother spot is <rougher>." in reader.text
    assert "? not knowndriftThe lamp was not watched." in reader.text
    count = int(np.sum(dataset.theta_in == 70))
    assert f"footprint leaves the sample{count} of {flags.size}θ in 70°: θ out" in reader.text
    assert reader.text.count("left out of all fits") >= 1
    assert re.search(r"negative beyond the noise\d+ of \d+θ in 10°: θ out [^k]*kept", reader.text)
    assert f"{count} spectra are flagged and take no part in the fits" in reader.text
    first_picture = html.index("<svg")
    for warning in ("M. Curie overrode it", "A check of this measurement failed: homogeneity"):
        assert html.index(warning) < first_picture


def test_a_clean_dataset_has_no_warnings_and_says_that_nothing_is_flagged(html: str) -> None:
    assert "A check of this measurement failed" not in html
    assert "overridden" not in html
    assert "No direction is flagged" in html


def test_every_expanded_uncertainty_says_its_coverage_factor(page: _Reader) -> None:
    for found in re.finditer(r"xpanded", page.text):
        sentence = page.text[found.start() : found.start() + 120]
        assert "coverage factor" in sentence or "k = 2" in sentence, sentence


def test_a_doubtful_fit_is_announced_before_anything_else(rough_analysis: SampleAnalysis) -> None:
    shifted = rough_analysis.model("cook-torrance-shift")
    doubtful = replace(shifted, verdict=Verdict(False, ("The lobe is narrower than the aperture & more.",)))
    html = report_html(replace(rough_analysis, models=(*rough_analysis.models[:2], doubtful)), FACTS)
    banner = html.index("Do not trust: Cook-Torrance with shift")
    assert banner < html.index("<svg")
    assert html.index("The lobe is narrower than the aperture &amp; more.") < html.index("<svg")


def test_a_folder_that_cannot_be_written_is_named(rough_analysis: SampleAnalysis, tmp_path: Path) -> None:
    with pytest.raises(ExportError, match="nowhere"):
        write_report(tmp_path / "nowhere" / "report.html", rough_analysis, FACTS)
    write_report(tmp_path / "report.html", rough_analysis, FACTS)
    assert (tmp_path / "report.html").read_text(encoding="utf-8").startswith("<!doctype html>")


def test_a_fast_cosine_is_said_to_turn_more_than_once(rough_analysis: SampleAnalysis) -> None:
    # h cos(w theta_m) with w = 4.5 is zero at 20, 60 and 100 degrees
    fit = rough_analysis.model("global")
    parameters = tuple(Parameter(n, v, 0.01, "1") for n, v in (("h", 0.9), ("w", 4.5), ("t_y", 0.0), ("p", 1.0)))
    fast = replace(fit, parameters=parameters, verdict=Verdict(True))
    html = report_html(replace(rough_analysis, models=(fast, *rough_analysis.models[1:])), FACTS)
    assert "it turns bluish beyond θm = 20°, reddish beyond θm = 60°.</p>" in html
