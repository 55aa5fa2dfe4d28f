"""What can be made of a dataset in the database at any time: fits, files for others, a report."""

import hashlib
import json
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from analysis.bsdf.search import Budget
from analysis.choices import BRDF_MODELS, MODELS, Distribution, Engine, Weight
from analysis.figures.notation import roughly, with_uncertainty
from analysis.fits.analyse import AT_THE_END_OF_A_SCAN, analyse
from analysis.fits.fit_json import SCHEMA_VERSION, analysis_to_json, fit_to_json
from analysis.fits.loew import weight_of
from analysis.reflectance.fresnel import load_conductor
from analysis.reports.report import NO_RUN
from analysis.results import SampleAnalysis, Verdict
from api.results.derive import RENDERED_MODEL, write_analysis_report, write_bsdf
from api.results.fitting import run_facts
from api.results.outcome import STATED
from api.written import Export, slug, write_text
from goniometer.datasets.dataset import Dataset
from goniometer.errors import InputError
from goniometer.files.dataset_file import last_file
from goniometer.storage.store import Store


@dataclass(frozen=True)
class HowToFit:
    """What a person may choose of a fit."""

    engine: Engine = "fast"
    distribution: Distribution = "ggx"
    weight: Weight = "none"
    conductor: str = "main/Al/Cheng"
    """Name in the refractive index database."""


def fit_datasets(
    store: Store,
    dataset_ids: Sequence[int],
    model: str | None,
    how: HowToFit = HowToFit(),
    executor: Executor | None = None,
) -> Iterator[dict[str, Any]]:
    """Fit datasets anew, store the fits, and return them as JSON: one model, or all of a scan's end.

    Each dataset is a task of `executor`; without one they are fitted here. Raises `InputError` for an unknown model,
    `UnknownConductor`, and `FitError` for data that cannot be fitted.
    """
    if model is not None and model not in MODELS:
        raise InputError(f'There is no model "{model}"; there are {", ".join(MODELS)}.')
    datasets = [store.dataset(each) for each in dataset_ids]
    made = (map if executor is None else executor.map)(partial(_fitted, model, how), datasets)
    for dataset_id, dataset, texts in zip(dataset_ids, datasets, made, strict=True):
        for kind, text in texts.items():
            if kind != "analysis" or model in {None, "local"}:
                store.add_fit(dataset_id, kind, text)
        content: dict[str, Any] = json.loads(texts["analysis"])
        parts = {"local": content["local"]} | {part["model"]: part for part in content["models"]}
        shown = parts if model is None else {model: parts[model]}
        yield {"dataset": dataset_id, "sample": dataset.sample, "uncertainties": STATED, "fits": shown}


def fit_dataset(
    store: Store, dataset_id: int, model: str | None, how: HowToFit = HowToFit(), executor: Executor | None = None
) -> dict[str, Any]:
    """As `fit_datasets`, one."""
    return next(fit_datasets(store, [dataset_id], model, how, executor))


def _fitted(model: str | None, how: HowToFit, dataset: Dataset) -> dict[str, str]:
    """JSON of all fits together as "analysis", and of each but "local" by the name of its model; a pure function."""
    conductor = load_conductor(*conductor_name(how.conductor))
    models = AT_THE_END_OF_A_SCAN if model in {None, "local"} else (str(model),)
    analysis = analyse(dataset, conductor, models, how.engine, how.distribution, how.weight)
    texts = {"analysis": analysis_to_json(analysis, conductor)}
    if model != "local":
        for fit in analysis.models:
            texts[fit.model] = fit_to_json(fit, dataset, analysis.differences[fit.model], conductor)
    return texts


def conductor_name(name: str) -> tuple[str, str, str]:
    """Shelf, book and page of "shelf/book/page"; raises `InputError` for another form."""
    match name.split("/"):
        case [shelf, book, page] if shelf and book and page:
            return shelf, book, page
    raise InputError(f'"{name}" is no name of a conductor; it should read shelf/book/page, e.g. main/Al/Cheng.')


def last_way(store: Store, dataset_id: int) -> HowToFit:
    """How a dataset was last fitted: of each choice, the newest fit that depends on it; as usual where none does."""
    how = HowToFit()
    for stored in store.fits(dataset_id):
        document = json.loads(stored.text)
        if document["schema_version"] != SCHEMA_VERSION:
            continue
        if "conductor" in document:
            how = replace(how, conductor=document["conductor"]["name"])
        for part in document.get("models", [document]):
            how = replace(how, engine=part["engine"])
            if "distribution" in part:
                weight = weight_of(part["metrics"]["cost"]["name"])
                how = replace(how, distribution=part["distribution"], weight=weight)
    return how


def fit_lines(found: dict[str, Any]) -> list[str]:
    """The result of `fit_dataset` as lines for a person; uncertainties have coverage factor k = 1."""
    lines = [f"Dataset {found['dataset']}, {found['sample']}; {STATED}"]
    for name, part in found["fits"].items():
        if name == "local":
            slopes = [m for m, good in zip(part["m_per_um"], part["reliable"], strict=True) if good]
            spread = f", slopes from {min(slopes):.2f} to {max(slopes):.2f} 1/µm" if slopes else ""
            lines.append(f"local: {len(slopes)} of {len(part['reliable'])} spectra are reliable{spread}")
            lines += [f"  {doubt}" for doubt in part["doubts"]]
            continue
        values = [f"{p['name']} {_shown(p, part['verdict'])}" for p in part["parameters"]]
        difference = part["metrics"]["dE00"]
        means = " / ".join(_known(difference[kind]["mean"]) for kind in ("absolute", "chromatic"))
        r2 = f"r2 {_number(part['metrics']['r2']):.4f}"
        lines.append(f"{name}: {', '.join(values)}; mean dE00 absolute / chromatic {means}; {r2}")
        if "comparison" in part:
            other = part["comparison"]
            bic = _number(other["BIC_falls_by"])
            lines.append(
                f"  against {other['simpler_model']}: BIC {'rises' if bic < 0 else 'falls'} by {abs(bic):.4g}, "
                f"mean dE00 falls by {_known(other['mean_dE00_falls_by'])}"
            )
        word = "note" if part["verdict"]["trusted"] else "do not trust it"
        lines += [f"  {word}: {reason}" for reason in part["verdict"]["reasons"]]
    return lines


def _shown(parameter: dict[str, Any], verdict: dict[str, Any]) -> str:
    """A parameter with its unit; one that the data do not tell has no value."""
    if parameter["name"] in verdict["undetermined"]:
        return "not determined"
    value, unit = _number(parameter["value"]), "" if parameter["unit"] == "1" else f" {parameter['unit']}"
    error = _number(parameter["standard_error"])
    return (with_uncertainty(value, error) if verdict["trusted"] else roughly(value)) + unit


def _number(stored: float | str | None) -> float:
    """A number of the JSON of a fit, in which null and "inf" stand for what JSON cannot write."""
    return float("nan") if stored is None else float(stored)


def _known(difference: float | None) -> str:
    """A mean colour difference, of which there is none where no spectrum covers all that the eye sees."""
    return "not known" if difference is None else f"{difference:.2f}".replace("-", "−")


def write_fits(store: Store, dataset_id: int, path: Path) -> Export:
    """Write a dataset's fits as JSON: those of a scan's end, and of every other model that it was ever fitted with.

    All are of the metal, distribution, weight and engine of the last fit.
    """
    analysis = _analysed(store, dataset_id, _models_of(store, dataset_id))
    return write_text("json", path, analysis_to_json(analysis, analysis.conductor))


def write_mitsuba(store: Store, dataset_id: int, path: Path, model: str | None, budget: Budget) -> Export:
    """Write a fitted model of a dataset for Mitsuba, fitted as in `write_fits`.

    Without `model` it is the one that was fitted last of those that can be rendered. Raises `InputError` for a model
    that cannot.
    """
    if model is not None and model not in BRDF_MODELS:
        raise InputError(f'"{model}" is no model that can be rendered; there are {", ".join(BRDF_MODELS)}.')
    fitted = [fit.kind for fit in store.fits(dataset_id) if fit.kind in BRDF_MODELS]
    wanted = model or (fitted or [RENDERED_MODEL])[-1]
    analysis = _analysed(store, dataset_id, (wanted,))
    _, exports = write_bsdf(path, analysis, wanted, budget)
    written, verdict = exports[0], analysis.model(wanted).verdict
    notes = (f"model {wanted}", *distrust(wanted, verdict), *written.notes)
    return replace(written, notes=notes, facts={"model": wanted, "trusted": verdict.trusted} | written.facts)


def distrust(model: str, verdict: Verdict) -> tuple[str, ...]:
    """What a person is told who uses a fit that is not to be trusted; nothing of another one."""
    return () if verdict.trusted else (f"The fit of {model} is not to be trusted: {' '.join(verdict.reasons)}",)


def _models_of(store: Store, dataset_id: int) -> tuple[str, ...]:
    """The models of a scan's end and every other one that a dataset was ever fitted with."""
    others = dict.fromkeys(fit.kind for fit in store.fits(dataset_id) if fit.kind in MODELS)
    return tuple(dict.fromkeys([*AT_THE_END_OF_A_SCAN, *others]))


def _analysed(store: Store, dataset_id: int, models: tuple[str, ...]) -> SampleAnalysis:
    how = last_way(store, dataset_id)
    conductor = load_conductor(*conductor_name(how.conductor))
    return analyse(store.dataset(dataset_id), conductor, models, how.engine, how.distribution, how.weight)


def usual_path(dataset: Dataset, ending: str) -> Path:
    """A file in the present folder; raises `InputError` rather than write over what a sample was imported from."""
    path = Path(f"{slug(dataset.sample)}.{ending}")
    read_from = {str(dataset.lineage.get("imported", "")).lower(), last_file(dataset.lineage).lower()}
    if path.exists() and path.name.lower() in read_from:
        raise InputError(f"{path} has the name of the file that was imported; name another one with --output.")
    return path


def check_place(store: Store, dataset_id: int, file_format: str, path: Path) -> None:
    """Raises `InputError` where `path` is a file that is not what was exported there before of the same dataset."""
    path = path.resolve()
    if not path.is_file():
        return
    with path.open("rb") as there:
        content = hashlib.file_digest(there, "sha256").hexdigest()
    if not store.has_export(dataset_id, path, file_format, content):
        raise InputError(
            f"{path} is there already, and is not the {file_format} that was written there of dataset {dataset_id}; "
            f"name another file with --output, or move it away."
        )


def report_dataset(store: Store, dataset_id: int, path: Path | None) -> Export:
    """Write the HTML report of a dataset to `path` or the present folder, and note that in the database.

    Raises `InputError` rather than replace another file.
    """
    path = path or usual_path(store.dataset(dataset_id), "html")
    check_place(store, dataset_id, "report", path)
    export = write_dataset_report(store, dataset_id, path)
    store.add_export(dataset_id, export.path, export.file_format, export.sha256)
    return export


def write_dataset_report(store: Store, dataset_id: int, path: Path) -> Export:
    """Write the HTML report of a dataset.

    It shows the models of a scan's end and every other one that the dataset was ever fitted with, all of them with the
    metal, distribution, weight and engine of the last fit.
    """
    scan_id = store.scan_of(dataset_id)
    facts = NO_RUN if scan_id is None else run_facts(store, store.scan(scan_id))
    analysis = _analysed(store, dataset_id, _models_of(store, dataset_id))
    return write_analysis_report(path, analysis, facts)
