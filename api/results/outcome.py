"""What a campaign came to: one summary per sample, read from the database alone.

The table on the screen, `--json` and the tests all show this, so that a resumed run and an uninterrupted one
can be compared number by number.
"""

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich import box
from rich.markup import escape
from rich.table import Table

from analysis.figures.notation import roughly, with_uncertainty
from analysis.results import ColourDifferences
from api.datasets import too_noisy
from goniometer.campaigns.material_file import material_file
from goniometer.datasets.dataset import MEANING, Dataset
from goniometer.plans.plan_spec import plan_spec, uniform_grid_size
from goniometer.storage.lineage import own_datasets
from goniometer.storage.records import Scan
from goniometer.storage.store import Store
from simulators.materials.materials import SAMPLES, material

STATED = "standard uncertainties, k = 1"
"""What a stated uncertainty is, to be said beside every table and JSON object."""


@dataclass(frozen=True)
class SampleOutcome:
    """One sample of a campaign, as far as it has come."""

    sample: str
    material: str
    phase: str
    outcome: str | None
    """completed, aborted or failed; None while the scan goes on."""
    reason: str
    points: int
    """Measured points."""
    failed_points: int
    uniform_1_degree_points: int
    """How many points a uniform grid of 1 degree in theta_out would have needed."""
    bench_seconds: float
    """Time that the points took on the bench."""
    dataset_id: int | None
    """The newest that the campaign made; what somebody calibrated anew stands beside it."""
    checks: list[dict[str, Any]]
    """What the dataset's sanity checks found: name, passed (null where the data do not tell), message."""
    flagged_points: dict[str, int]
    """Flag in words -> how many points carry it."""
    left_out_points: int
    """Measured points that the fits leave out because of a flag."""
    too_noisy: str
    """Which points missed the wanted signal-to-noise ratio, as a sentence; empty where none did."""
    certificate_override: str
    """Who used an expired or missing certificate of the reference and why; empty where nobody had to."""
    dE00: dict[str, dict[str, dict[str, float]]]  # noqa: N815  (the field's own spelling)
    """Model -> "absolute" or "chromatic" -> mean, median, p95, max."""
    parameters: dict[str, list[dict[str, Any]]]
    """Model -> name, value, standard_error, unit of each parameter; "true" beside them on the simulated bench."""
    trusted: dict[str, bool]
    """Model -> whether its fit may be believed."""
    reasons: dict[str, list[str]]
    """Model -> the sentences of the verdict."""
    files: list[str]
    """Paths of what was written: fits, rendering file, report."""


def outcomes(store: Store, campaign_id: int, *, truth: bool) -> list[SampleOutcome]:
    """All samples of a campaign, in its order; `truth` adds what the simulated bench knows."""
    spec = plan_spec(store.campaign(campaign_id))
    uniform = uniform_grid_size(spec)
    return [_outcome(store, scan, uniform, truth=truth) for scan in store.scans(campaign_id) if scan.kind == "sample"]


def _outcome(store: Store, scan: Scan, uniform: int, *, truth: bool) -> SampleOutcome:
    points = store.points(scan.id)
    dataset_id = max(own_datasets(store, scan.id), default=None)
    analysis: dict[str, Any] = {}
    files: list[str] = []
    dataset: Dataset | None = None
    if dataset_id is not None:
        dataset = store.dataset(dataset_id)
        texts = {fit.kind: fit.text for fit in store.fits(dataset_id)}
        analysis = json.loads(texts.get("analysis", "{}"))
        files = list(dict.fromkeys(export.text for export in store.exports(dataset_id)))
    models = {model["model"]: model for model in analysis.get("models", [])}
    differences = {name: model["metrics"]["dE00"] for name, model in models.items()}
    if analysis:
        differences = {"local": _local_differences(analysis["local"])} | differences
    return SampleOutcome(
        sample=scan.name,
        material=scan.material,
        phase=scan.phase,
        outcome=scan.outcome,
        reason=scan.reason,
        points=sum(point.status == "done" for point in points),
        failed_points=sum(point.status == "failed" for point in points),
        uniform_1_degree_points=uniform,
        bench_seconds=sum(point.seconds for point in points),
        dataset_id=dataset_id,
        checks=[] if dataset is None else [asdict(check) for check in dataset.checks],
        flagged_points={} if dataset is None else _flagged_points(dataset),
        left_out_points=0 if dataset is None else int(np.sum(~dataset.usable)),
        too_noisy=too_noisy(store, scan),
        certificate_override="" if dataset is None else str(dataset.lineage.get("certificate_override") or ""),
        dE00=differences,
        parameters={
            name: [p | _true_value(scan.material, p["name"], name, known=truth) for p in model["parameters"]]
            for name, model in models.items()
        },
        trusted={name: model["verdict"]["trusted"] for name, model in models.items()},
        reasons={name: model["verdict"]["reasons"] for name, model in models.items()},
        files=files,
    )


def _flagged_points(dataset: Dataset) -> dict[str, int]:
    """How many points carry each flag that occurs."""
    counts = {words: int(dataset.flagged(flag).sum()) for flag, words in MEANING.items()}
    return {words: count for words, count in counts.items() if count}


def _local_differences(local: dict[str, Any]) -> dict[str, dict[str, float]]:
    """Statistics of the local fit, whose differences are stored point by point; null is a point without value."""
    found = ColourDifferences(*(np.array(local[f"dE00_{kind}"], dtype=float) for kind in ("absolute", "chromatic")))
    return {kind: found.statistics(kind) for kind in ("absolute", "chromatic")}


def _true_value(name: str, parameter: str, model: str, *, known: bool) -> dict[str, float]:
    """What the simulated bench put into a parameter, if it knows; a table is made of none."""
    if not known or model not in {"cook-torrance", "cook-torrance-shift"} or material_file(name):
        return {}
    lying = material(name)
    return {"true": getattr(lying, parameter)} if lying.name in SAMPLES else {}


def table(samples: list[SampleOutcome]) -> Table:
    """The paper's Table 2 for these samples, with what it took and what was found."""
    shown = Table(
        title="Mean CIEDE2000 difference between measurement and fit, absolute / chromatic",
        title_justify="left",
        box=box.SIMPLE_HEAD,
        pad_edge=False,
        padding=(0, 0),
    )
    shown.add_column("Sample", no_wrap=True)
    shown.add_column("Points of\n1° grid", justify="right", no_wrap=True)
    shown.add_column("Cook-\nTorrance", justify="right", no_wrap=True)
    shown.add_column("with\nshift", justify="right", no_wrap=True)
    shown.add_column("Shift model\n(h in 1/µm), k = 1", no_wrap=True)
    shown.add_column("True", no_wrap=True)
    shown.add_column("Trust", no_wrap=True)
    for sample in samples:
        fits = [
            " / ".join(f"{sample.dE00[model][kind]['mean']:.2f}" for kind in ("absolute", "chromatic"))
            if model in sample.dE00
            else "-"
            for model in ("cook-torrance", "cook-torrance-shift")
        ]
        parameters = sample.parameters.get("cook-torrance-shift", [])
        trusted = sample.trusted.get("cook-torrance-shift")
        shown.add_row(
            escape(sample.sample),
            f"{sample.points}\n{sample.uniform_1_degree_points}",
            *fits,
            "\n".join(f"{p['name']:5} {_with_error(p) if trusted else roughly(p['value'])}" for p in parameters)
            or sample.outcome
            or sample.phase,
            "\n".join(f"{p['true']:g}" if "true" in p else "-" for p in parameters),
            "-" if trusted is None else "yes" if trusted else "NO",
        )
    return shown


def remarks(samples: list[SampleOutcome]) -> list[str]:
    """Sentences below the table: why a fit is not to be trusted, and where the files are."""
    lines = [f"Uncertainties in brackets are {STATED}."]
    for sample in samples:
        if not sample.trusted.get("cook-torrance-shift", True):
            why = " ".join(sample.reasons["cook-torrance-shift"])
            lines.append(f"{sample.sample}: the fit cannot be trusted. {why}")
        if sample.certificate_override:
            lines.append(f"{sample.sample}: {sample.certificate_override}")
        for check in sample.checks:
            if check["passed"] is False:
                lines.append(f"{sample.sample}: the check of {check['name']} failed. {check['message']}")
        if sample.left_out_points:
            lines.append(f"{sample.sample}: {sample.left_out_points} flagged points take no part in the fits.")
        if sample.too_noisy:
            lines.append(f"{sample.sample}: {sample.too_noisy}")
        if sample.failed_points:
            lines.append(f"{sample.sample}: {sample.failed_points} points failed and are absent from every result.")
    lines += [f"{sample.sample}: {_folder(sample)}" for sample in samples if sample.files]
    return lines


def _folder(sample: SampleOutcome) -> str:
    """The folder of the first file, and what is in it; what somebody exported elsewhere is not."""
    paths = [Path(path) for path in sample.files]
    folder = paths[0].parent
    here = Path.cwd()
    shown = folder.relative_to(here) if folder.is_relative_to(here) else folder
    names = sorted(path.name for path in paths if path.parent == folder)
    return f"{shown} ({', '.join(names)})"


def _with_error(parameter: dict[str, Any]) -> str:
    error = parameter["standard_error"]
    if not isinstance(error, float | int):  # not determined: null or infinite in the stored JSON
        return f"{parameter['value']:.4g} (fixed)"
    return with_uncertainty(parameter["value"], error)
