"""What is made of a calibrated dataset: fits, files and a report; runs in a process of its own, anywhere."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from xml.sax.saxutils import quoteattr  # nosec B406 # it writes

from analysis.bsdf.export import BsdfReport, report_content, report_lines, write_fit
from analysis.bsdf.export import write_bsdf as write_model
from analysis.bsdf.search import USUAL_BUDGET, Budget
from analysis.fits.analyse import analyse
from analysis.fits.fit_json import analysis_to_json, fit_to_json
from analysis.mitsuba.run import bsdf_element
from analysis.mitsuba.vase_scene import vase_scene
from analysis.reflectance.fresnel import load_conductor
from analysis.reports.report import RunFacts, write_report
from analysis.results import SampleAnalysis
from analysis.scenes.ladder import Model
from api.written import Export, make_folder, slug, write_bytes, write_file, write_text
from goniometer.datasets.dataset import Dataset
from simulators.materials.tabulated_file import write_tabulated

REPORT = "report.html"
"""Name of the report in the folder of a sample."""

RENDERED_MODEL = "cook-torrance-shift"
"""The model that goes to the renderer when a scan ends."""


@dataclass(frozen=True)
class Derived:
    """Everything derived from one dataset."""

    fits: dict[str, str]
    """Model -> JSON; "analysis" holds all of them together with the local fit."""
    files: tuple[tuple[str, str, bytes], ...]
    """Format, name and content of each; the report comes last."""


def derive(dataset: Dataset, facts: RunFacts) -> Derived:
    """Fit `dataset` and make `fit-*.json`, `analysis.json`, the `.bsdf` and `report.html`; a pure function.

    Raises `AnalysisError` for data that cannot be fitted or written, and `StoreFull` where the disk is full.
    """
    with TemporaryDirectory() as folder:
        return _derived(dataset, facts, Path(folder))


def write_derived(derived: Derived, folder: Path) -> tuple[Export, ...]:
    """Write the files into `folder`; raises `StoreFull` where the disk refuses."""
    make_folder(folder)
    return tuple(write_bytes(file_format, folder / name, content) for file_format, name, content in derived.files)


def _derived(dataset: Dataset, facts: RunFacts, folder: Path) -> Derived:
    conductor = load_conductor()
    analysis = analyse(dataset, conductor)
    fits = {fit.model: fit_to_json(fit, dataset, analysis.differences[fit.model], conductor) for fit in analysis.models}
    fits["analysis"] = analysis_to_json(analysis, conductor)
    exports = [write_text("json", folder / f"{model}.json", text) for model, text in fits.items()]
    bsdf, for_renderer = write_bsdf(folder / f"{slug(dataset.sample)}.bsdf", analysis)
    exports += for_renderer
    files = tuple((e.path.name, _CONTENT[e.file_format]) for e in exports)
    exports.append(write_analysis_report(folder / REPORT, analysis, replace(facts, files=files, bsdf=bsdf)))
    return Derived(fits, tuple((each.file_format, each.path.name, each.path.read_bytes()) for each in exports))


_CONTENT = {
    "json": "fitted parameters with their uncertainties, in JSON",
    "mitsuba": "the fitted model for Mitsuba 3 and PBRT",
    "scene": "a scene for Mitsuba 3 that shows it",
    "mesh": "the shape in that scene",
}


def write_material(path: Path, dataset: Dataset) -> Export:
    """Write a dataset as the table of a material for the simulated bench."""
    return write_file("material", path, lambda part: write_tabulated(part, dataset))


def write_analysis_report(path: Path, analysis: SampleAnalysis, facts: RunFacts) -> Export:
    """Write the HTML report of an analysis."""
    return write_file("report", path, lambda part: write_report(part, analysis, facts))


def write_bsdf(
    path: Path, analysis: SampleAnalysis, model: str = RENDERED_MODEL, budget: Budget = USUAL_BUDGET
) -> tuple[BsdfReport, tuple[Export, ...]]:
    """Write a fitted model of an analysis as a `.bsdf`, with a scene for Mitsuba that shows it beside."""
    fit, dataset, metal = analysis.model(model), analysis.dataset, analysis.conductor
    return _with_scene(path, lambda part: write_fit(part, fit, dataset, metal, budget))


def write_rung(path: Path, model: Model, about: str) -> tuple[BsdfReport, tuple[Export, ...]]:
    """Write a model of the ladder as `write_bsdf` does; `about` opens its description."""
    return _with_scene(path, lambda part: write_model(part, model, about=about))


def _with_scene(path: Path, write: Callable[[Path], BsdfReport]) -> tuple[BsdfReport, tuple[Export, ...]]:
    reports: list[BsdfReport] = []
    export = write_file("mitsuba", path, lambda part: reports.append(write(part)))
    report = replace(reports[0], path=path)
    scene = vase_scene(bsdf_element("measured", f'<string name="filename" value={quoteattr(path.name)}/>'))
    beside = [write_text("scene", path.with_name(f"{path.name.removesuffix('.bsdf')}.scene.xml"), scene.xml)]
    for name, content in scene.files.items():
        beside.append(write_bytes("mesh", path.with_name(name), content))
    shown = f"a scene that shows it: {beside[0].path.name}, with {', '.join(scene.files)}"
    notes = (*report_lines(report), shown)
    facts = report_content(report) | {"scene": str(beside[0].path)}
    return report, (replace(export, notes=notes, facts=facts), *beside)
