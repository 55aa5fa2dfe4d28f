"""The kinds of jobs: what each is asked, and which function of the command line does it."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from analysis.figures.page import titled_page
from analysis.reports.choose import choice_body
from analysis.tradeoff import charts_json
from api.bodies.base import Asked
from api.bodies.jobs import (
    ChooseArguments,
    DoctorArguments,
    ExportArguments,
    FitArguments,
    ImportAsked,
    RecalibrateArguments,
    ReportArguments,
    StabilityArguments,
    TradeoffArguments,
)
from api.choices import Role
from api.datasets import recalibrate
from api.executor import processes
from api.exports.formats import FORMATS, Options, export_dataset
from api.jobs.uploads import uploaded
from api.results.certificates import known_certificate
from api.results.choose import choice_content, choice_pictures, choose_model, mitsuba_is_there
from api.results.imports import Request, imported_file
from api.results.products import HowToFit, fit_dataset, report_dataset
from api.results.quality import quality, settings_of
from api.results.stability import TITLE as STABILITY
from api.results.stability import stability_body, stability_content
from api.results.tradeoff import TITLE as TRADEOFF
from api.results.tradeoff import chapters, charts
from api.written import Export, make_folder, slug, write_text
from goniometer.certificates.certificate import Override
from goniometer.storage.store import Store
from simulators.choices import METHODS
from simulators.stability.ensemble import cells, ensemble, jobs
from simulators.stability.regimes import REGIMES

Tell = Callable[[float | None, str], None]
"""Told which part of the work is done (None: nobody knows) and what is being done."""


@dataclass(frozen=True)
class Work:
    """What a job works with."""

    store: Store
    folder: Path
    """Where it may write; not yet made. It stays when the job is over."""
    output: Path
    """Folder of the results of the service."""
    tell: Tell
    cluster: str | None = None
    """Address of the Dask scheduler that does heavy work; None for this machine."""


@dataclass(frozen=True)
class Made:
    """What came of a job."""

    result: dict[str, Any]
    """As JSON content; NaN where there is no value."""
    page: str | None = None
    """HTML."""


@dataclass(frozen=True)
class Kind:
    """A kind of job."""

    about: str
    """For a person, e.g. "Fit a dataset"."""
    arguments: type[Asked]
    run: Callable[[Work, Any], Made] | None
    """None: it is a command of the bench, which the process that drives it obeys."""
    role: Role = "operator"
    """Whoever asks for it needs this role or a higher one."""
    long: bool = False
    """Whether it takes minutes or hours; the others need not wait for it."""


def _fit(work: Work, asked: FitArguments) -> Made:
    work.tell(None, f"Fitting {asked.model or 'all models'}")
    how = HowToFit(asked.engine, asked.distribution, asked.weight, asked.conductor)
    if work.cluster is None:
        return Made(fit_dataset(work.store, asked.dataset, asked.model, how))
    with processes(work.cluster) as executor:
        return Made(fit_dataset(work.store, asked.dataset, asked.model, how, executor))


def _export(work: Work, asked: ExportArguments) -> Made:
    work.tell(None, f"Writing {asked.format}")
    said = asked.options
    options = Options(
        raw=said.raw,
        license=said.license,
        creators=tuple(said.creators),
        attached=tuple(uploaded(work.output, token) for token in said.attached),
        about=None if said.about is None else uploaded(work.output, said.about),
        model=said.model,
        budget=said.budget,
        colour_budget=said.colour_budget,
    )
    wanted = FORMATS[asked.format]
    path = _file(work, asked.dataset, wanted.ending)
    return Made(
        _told(work.store, asked.dataset, export_dataset(work.store, asked.dataset, asked.format, path, options))
    )


def _report(work: Work, asked: ReportArguments) -> Made:
    work.tell(None, "Fitting and drawing")
    written = report_dataset(work.store, asked.dataset, _file(work, asked.dataset, "html"))
    return Made(_told(work.store, asked.dataset, written), written.path.read_text(encoding="utf-8"))


def _file(work: Work, dataset_id: int, ending: str) -> Path:
    """A new file for a dataset, that nothing was ever written to: an export stays what it was."""
    make_folder(work.folder)
    return work.folder / f"{slug(work.store.entry(dataset_id).sample)}.{ending}"


def _told(store: Store, dataset_id: int, written: Export) -> dict[str, Any]:
    newest = store.exports(dataset_id)[-1]
    return {
        "dataset": dataset_id,
        "export": newest.id,
        "format": written.file_format,
        "file": written.path.name,
        "sha256": written.sha256,
        "notes": list(written.notes),
        "facts": written.facts,
    }


def _import(work: Work, asked: ImportAsked) -> Made:
    work.tell(None, "Reading the file")
    said = asked.model_dump(exclude={"upload"})
    for name in ("reference", "certificate", "darks"):
        said[name] = None if said[name] is None else uploaded(work.output, said[name])
    said["highest"] = float("inf") if asked.highest is None else asked.highest
    dataset = imported_file(Request(path=uploaded(work.output, asked.upload), **said))
    made = work.store.add_dataset(None, dataset)
    return Made(quality(work.store, made) | {"lineage": dataset.lineage})


def _recalibrate(work: Work, asked: RecalibrateArguments) -> Made:
    work.tell(None, "Calibrating")
    text = None if asked.certificate is None else known_certificate(work.store, asked.certificate).text
    override = None
    if asked.override_name is not None and asked.override_reason is not None:
        override = Override(asked.override_name, asked.override_reason)
    made = recalibrate(work.store, asked.dataset, text, settings_of(asked.without, asked.also), override)
    lineage = work.store.lineage(made)
    more = {"recalibrated_from": asked.dataset, **{name: lineage[name] for name in ("certificate", "corrections")}}
    return Made(quality(work.store, made) | more)


def _tradeoff(work: Work, asked: TradeoffArguments) -> Made:
    own = None if asked.dataset is None else work.store.dataset(asked.dataset)
    found = []
    kinds = list(dict.fromkeys(asked.kinds))
    for i, kind in enumerate(kinds):

        def tell(words: str, share: float = i / len(kinds)) -> None:
            work.tell(share, words)

        tell(f"Charting {kind}")
        found += charts(kind, own, asked.sample, asked.surface, asked.rounds, tell, dielectric=asked.dielectric)
    return Made({"charts": charts_json(found)}, titled_page(TRADEOFF, chapters(found)))


def _stability(work: Work, asked: StabilityArguments) -> Made:
    wanted = jobs(asked.regimes or list(REGIMES), asked.methods or list(METHODS), asked.runs)
    found = []
    with processes(work.cluster) as executor:
        for run in ensemble(wanted, executor):
            found.append(run)
            work.tell(len(found) / len(wanted), f"{len(found)} of {len(wanted)} fits")
    silent = [each for each in found if each.silent]
    made = cells(found)
    return Made(stability_content(made, found), titled_page(STABILITY, stability_body(made, silent)))


def _choose(work: Work, asked: ChooseArguments) -> Made:
    work.tell(None, "Fitting the ladder and lighting the scene")
    make_folder(work.folder)
    scene = work.folder / ("scene.xml" if asked.scene_format == "mitsuba" else "scene.yaml")
    write_text("scene", scene, asked.scene)
    rendering = asked.rendering and mitsuba_is_there()
    dielectric = asked.dielectric
    found = choose_model(work.store, asked.dataset, scene, asked.tolerance, dielectric=dielectric, rendering=rendering)
    sample = work.store.entry(asked.dataset).sample
    body = choice_body(found.choice, sample, scene.name, found.rendered)
    result = {"dataset": asked.dataset, "sample": sample} | choice_content(found) | {"pictures": choice_pictures(found)}
    return Made(result, titled_page(f"The model that {sample} needs", body))


KINDS: dict[str, Kind] = {
    "doctor": Kind("Examine every device", DoctorArguments, None),
    "fit": Kind("Fit a dataset", FitArguments, _fit),
    "export": Kind("Write a dataset for others", ExportArguments, _export),
    "report": Kind("Write the report of a dataset", ReportArguments, _report),
    "import": Kind("Import a BRDF that was measured elsewhere", ImportAsked, _import),
    "recalibrate": Kind("Calibrate raw data anew", RecalibrateArguments, _recalibrate, "metrologist"),
    "tradeoff": Kind("Chart speed against accuracy", TradeoffArguments, _tradeoff, long=True),
    "stability": Kind("Map the stability of the fits", StabilityArguments, _stability, long=True),
    "choose": Kind("Choose the model that a scene needs", ChooseArguments, _choose, long=True),
}
"""By the name that the database keeps."""
