"""How good a dataset is: its sanity checks, its uncertainty budget, and the corrections with which it is calibrated."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

from rich import box
from rich.table import Table

from analysis.figures.budget import (
    budget_page,
    budget_panels,
    panels_in_words,
    relative_in_words,
    share_in_words,
)
from analysis.figures.notation import uncertainty, with_uncertainty
from analysis.figures.svg import side_by_side
from api.datasets import too_noisy
from api.written import Export, write_text
from goniometer.datasets.budget import COVERAGE, COVERAGE_FACTOR, USUAL_WAVELENGTH, Budget, budget, usual_direction
from goniometer.datasets.dataset import IN_FITS, MEANING, Check, Dataset, Flag
from goniometer.errors import InputError
from goniometer.radiometry.response import CORRECTIONS, DEFAULT_CORRECTIONS, Settings
from goniometer.storage.store import Store

MARKS = {True: "✓", False: "✗", None: "?"}
"""Of a check that passed, that failed, and of one that the data cannot answer."""


def flag_counts(dataset: Dataset) -> list[dict[str, Any]]:
    """Every flag that occurs: what it means, how many points have it, and what the fits do with them."""
    counts = {flag: int(dataset.flagged(flag).sum()) for flag in Flag}
    return [
        {
            "flag": str(flag.name).lower().replace("_", " "),
            "meaning": MEANING[flag],
            "points": count,
            "in_fits": IN_FITS[flag],
        }
        for flag, count in counts.items()
        if count
    ]


def quality(store: Store, dataset_id: int) -> dict[str, Any]:
    """Checks and flags of a dataset, as JSON content; `passed` is false where any check failed.

    Raises `NotInStore`.
    """
    return quality_of(store, dataset_id, store.dataset(dataset_id))


def quality_of(store: Store, dataset_id: int, dataset: Dataset) -> dict[str, Any]:
    """The same of a dataset that was read already."""
    scan_id = store.scan_of(dataset_id)
    return {
        "dataset": dataset_id,
        "sample": dataset.sample,
        "passed": all(check.passed is not False for check in dataset.checks),
        "checks": [asdict(check) for check in dataset.checks],
        "points": dataset.theta_in.size,
        "flags": flag_counts(dataset),
        "too_noisy": "" if scan_id is None else too_noisy(store, store.scan(scan_id)),
        "certificate_override": dataset.lineage.get("certificate_override"),
    }


def quality_lines(found: dict[str, Any]) -> list[str]:
    """The result of `quality` as lines for a person."""
    lines = [f"Dataset {found['dataset']}, {found['sample']}"]
    if found["certificate_override"]:
        lines.append(f"! {found['certificate_override']}")
    lines += [check_line(Check(**check)) for check in found["checks"]]
    lines += [
        f"{each['points']} of {found['points']} points: {each['meaning']} ({each['in_fits']})"
        for each in found["flags"]
    ]
    if not found["flags"]:
        lines.append(f"No flag on any of the {found['points']} points")
    return [*lines, found["too_noisy"]] if found["too_noisy"] else lines


def check_line(check: Check) -> str:
    """A check as one line."""
    return f"{MARKS[check.passed]} {check.name}: {check.message}"


def dataset_budget(
    dataset: Dataset, theta_in: float | None, theta_out: float | None, wavelength: float | None
) -> Budget:
    """The budget at a direction (degrees) and wavelength (nm).

    What is not given is the incident angle nearest 45 degrees, the mirror direction, or what was measured nearest to
    it, and 600 nm. Raises what `goniometer.datasets.budget.budget` raises.
    """
    incident, reflected = usual_direction(dataset)
    if theta_in is not None:
        incident = reflected = theta_in
    if theta_out is not None:
        reflected = theta_out
    return budget(dataset, incident, reflected, USUAL_WAVELENGTH if wavelength is None else wavelength)


def budget_content(dataset_id: int, found: Budget) -> dict[str, Any]:
    """A budget as JSON content."""
    return {
        "dataset": dataset_id,
        **asdict(found),
        "units": {"angles": "deg", "wavelength": "nm", "brdf": "1/sr", "u": "1/sr"},
        "expanded_uncertainty": found.expanded,
        "coverage_factor": COVERAGE_FACTOR,
        "coverage": COVERAGE,
    }


def budget_rows(found: Budget) -> Table:
    """A budget as a table for a terminal."""
    shown = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    shown.add_column("Source of error")
    for head in ("u (k = 1)\nin 1/sr", "relative", "of the\nvariance"):
        shown.add_column(head, justify="right", no_wrap=True)
    shown.add_column("the same for")
    for part in found.parts:
        single = _short(part.sources[0].shared) if len(part.sources) == 1 else ""
        shown.add_row(part.name, *_numbers(part.u, part.relative), share_in_words(part.share), single)
        if not single:
            for source in part.sources:
                cells = *_numbers(source.u, source.relative), share_in_words(source.share), _short(source.shared)
                shown.add_row(f"  {source.name.removeprefix(f'{part.name}: ')}", *cells, style="dim")
    shown.add_section()
    shown.add_row("combined (k = 1)", *_numbers(found.u, found.u / found.brdf), "", "")
    expanded = _numbers(found.expanded, found.expanded / found.brdf)
    shown.add_row(f"expanded (k = {COVERAGE_FACTOR})", *expanded, "", "", style="bold")
    return shown


def _short(shared: str) -> str:
    return shared.replace("wavelengths", "λ")


def budget_lines(dataset_id: int, found: Budget, done: str) -> list[str]:
    """What stands above and below the table of a budget; `done` is what was done to get it, e.g. "measured"."""
    return [
        f"Dataset {dataset_id}, {found.sample}: {done} at θ in = {found.theta_in:.2f}°, "
        f"θ out = {found.theta_out:.2f}°, {found.wavelength:.1f} nm".replace("-", "−"),
        f"BRDF = {with_uncertainty(found.brdf, found.u)} 1/sr (k = 1); expanded ± {uncertainty(found.expanded)} 1/sr "
        f"(k = {COVERAGE_FACTOR}: {COVERAGE})",
    ]


def _numbers(u: float, relative: float) -> tuple[str, str]:
    """Sizes; the sign of a source says which way it moves the value, and matters only beside other values."""
    return uncertainty(abs(u)), relative_in_words(relative)


def write_budget(dataset: Dataset, found: Budget, path: Path) -> Export:
    """Write the plots of a budget as SVG, or with its table as HTML, by the ending of `path`.

    Raises `InputError` for another ending and `StoreFull` where the disk refuses.
    """
    panels = budget_panels(dataset, found.theta_in, found.theta_out, found.wavelength)
    if path.suffix == ".svg":
        return write_text("svg", path, side_by_side(panels))
    if path.suffix == ".html":
        return write_text("html", path, budget_page(found, panels, panels_in_words(dataset)))
    raise InputError(f'A budget cannot be drawn to "{path}"; end its name in .svg or .html.')


def settings_of(without: list[str], also: list[str]) -> Settings:
    """The standard calibration without some corrections, and with others that it leaves out.

    Raises `InputError` for what is no correction.
    """
    for name in [*without, *also]:
        if name not in CORRECTIONS:
            raise InputError(f'There is no correction "{name}"; there are {", ".join(CORRECTIONS)}.')
    if contrary := set(without) & set(also):
        raise InputError(f'The correction "{min(contrary)}" is asked for both with and without; decide on one.')
    return Settings(corrections=(DEFAULT_CORRECTIONS - set(without)) | set(also))
