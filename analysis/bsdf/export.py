"""Writes a model of the ladder, as the fits give it, as a `.bsdf` file for Mitsuba 3 and PBRT.

What is in the file stands in `analysis.bsdf.fields`. Four layouts are tried for every file, each with the smallest
tables that keep the error budget, and the smallest file of those that keep it is written:

- "flat": `vndf` is one everywhere, the nodes of the table are even in sqrt(theta_m) and phi_m;
- "vndf": half of the nodes follow the normals that are visible from theta_i, the other half stay even;
- "flat-whole" and "vndf-whole": the same with the lobe left in the table.

A file that a renderer samples badly is noise, however right its values are: such a layout is not taken if another is
sampled well.
Where the model reflects more than all it is clamped first (`analysis.bsdf.energy`), and the error of the file is that
against the clamped model.
"""

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from analysis.bsdf.energy import HIGHEST_ALBEDO, Clamped, clamp, darkening, file_albedo, sampling_noise
from analysis.bsdf.error import LARGEST_TESTED_ANGLE, PAIRS, RelativeError, probe, read_back
from analysis.bsdf.fields import Grid, bsdf_fields, size_of
from analysis.bsdf.measured_bsdf import MeasuredBsdf, read_bsdf
from analysis.bsdf.rendered_model import RenderedModel, of_fit, rendered
from analysis.bsdf.search import LARGEST_SIZE, USUAL_BUDGET, Budget, Layout, lobe_for, smallest_grid, wavelength_nodes
from analysis.bsdf.tensor_file import Tensor, encode
from analysis.errors import ExportError
from analysis.reflectance.fresnel import Conductor
from analysis.results import ModelFit
from analysis.scenes.ladder import Model
from drivers.arrays import FloatArray
from goniometer.datasets.dataset import Dataset

LAYOUTS = {
    "flat": Layout(0.0, whole=False),
    "vndf": Layout(0.5, whole=False),
    "flat-whole": Layout(0.0, whole=True),
    "vndf-whole": Layout(0.5, whole=True),
}
"""In which order they are tried; a later one has to be smaller."""

NOISIEST = 0.5
"""Relative standard deviation of a sample's weight beyond which a layout is not taken if another has less."""

_TESTED_WAVELENGTHS = 48
_PARTS_OF_BUDGET = (1.0, 0.85)
"""For which tables are sought, in turn; the second where the colours or the other wavelengths want more than sought."""


@dataclass(frozen=True)
class Tried:
    """A layout with its smallest tables."""

    size: int
    """Bytes, without the description."""
    incident: int
    """Nodes of theta_i."""
    table: int
    """Nodes along a side of the square."""
    error: RelativeError
    colour: float
    """99th percentile of CIEDE2000, brightness included."""
    noise: float
    """Relative standard deviation of the weight of a sample, `analysis.bsdf.energy.sampling_noise`."""
    albedo: float
    """Largest albedo of the file in a white furnace."""


@dataclass(frozen=True)
class BsdfReport:
    """What was written, and how well it stands for the model."""

    path: Path
    size: int
    """Bytes."""
    layout: str
    """Key of `LAYOUTS`."""
    wavelengths: FloatArray
    """[nodes] nm."""
    budget: Budget
    clamped: str
    """What was done to the model so that it reflects no more than all, a sentence; empty where nothing had to be."""
    tried: dict[str, Tried]
    """The layouts that came into question, in the order of `LAYOUTS`; see `write_bsdf`."""
    description: str
    """The text inside the file."""

    @property
    def written(self) -> Tried:
        """The layout in the file."""
        return self.tried[self.layout]

    @property
    def within_budget(self) -> bool:
        """Whether the file keeps both parts of the budget."""
        return _within(self.written, self.budget)


def write_bsdf(path: Path, model: Model, budget: Budget = USUAL_BUDGET, *, about: str = "") -> BsdfReport:
    """Write a model of the ladder to `path`, in the smallest file that keeps `budget`, or in the best one there is.

    Layouts are tried in the order of `LAYOUTS`; one that needs larger tables than another one before it is given up.
    `about` opens the description inside the file. Raises `OutOfRange` where the model does not cover 400 to 700 nm,
    and `ExportError` where the file cannot be written.
    """
    whole = rendered(model)
    clamped = clamp(whole.reflectance, whole.alpha, np.linspace(*whole.wavelengths, _TESTED_WAVELENGTHS))
    if clamped is not None:
        whole = replace(whole, reflectance=clamped)
    wavelengths, spent = wavelength_nodes(whole, budget)
    lobe = lobe_for(whole, wavelengths, budget)
    tried: dict[str, Tried] = {}
    fields: dict[str, dict[str, Tensor]] = {}
    limit = LARGEST_SIZE
    for layout, kind in LAYOUTS.items():
        for part in _PARTS_OF_BUDGET:
            grid, found = smallest_grid(whole, wavelengths, lobe, kind, spent, part * budget.error, limit)
            if not found and limit < LARGEST_SIZE:
                break  # none of less than what there is already
            fields[layout], bsdf = _tables(whole, wavelengths, grid, lobe)
            tried[layout] = _judged(whole, bsdf, grid, size_of(grid, wavelengths.size, lobe.size))
            if not found or _within(tried[layout], budget):
                break
        if layout in tried and _within(tried[layout], budget) and tried[layout].noise <= NOISIEST:
            limit = min(limit, tried[layout].size)
    layout = min(tried, key=lambda name: _rank(tried[name], budget))
    done = clamping_words(clamped)
    description = _description(about, whole, layout, tried[layout], wavelengths, budget, done)
    content = encode(fields[layout] | {"description": np.frombuffer(description.encode(), np.uint8)})
    try:
        path.write_bytes(content)
    except OSError as fault:
        raise ExportError(f"The file {path} cannot be written: {fault.strerror}.") from fault
    return BsdfReport(path, len(content), layout, wavelengths, budget, done, tried, description)


def write_fit(
    path: Path, fit: ModelFit, dataset: Dataset, conductor: Conductor, budget: Budget = USUAL_BUDGET
) -> BsdfReport:
    """Write the fit of a microfacet model to `path`, described by what it was fitted to.

    `conductor` is that of the fit, if it is of a metal. Raises as `write_bsdf`, and `ExportError` for a model that says
    nothing of brightness.
    """
    return write_bsdf(path, of_fit(fit, conductor), budget, about=describe(fit, dataset))


def describe(fit: ModelFit, dataset: Dataset) -> str:
    """What a renderer's user has to know about a fit before believing its file."""
    low_in, high_in, low_out, high_out = fit.theta_range
    lines = [
        f"Fitted model of sample {dataset.sample}: {fit.equation}.",
        "This is the model, not the data behind it: an in-plane scan cannot fill a hemisphere.",
        f"Fitted in plane for theta_in {low_in:g} to {high_in:g} deg, theta_out {low_out:g} to {high_out:g} deg, "
        f"{fit.wavelength_range[0]:g} to {fit.wavelength_range[1]:g} nm; everything else is extrapolated.",
        f"Dataset SHA-256 {dataset.content_hash}.",
        "Parameters with standard uncertainty (coverage factor 1): "
        + ", ".join(f"{p.name} = {p.value:.6g} +- {p.standard_error:.2g} {p.unit}" for p in fit.parameters)
        + ".",
    ]
    if not fit.verdict.trusted:
        lines.append("NOT TO BE TRUSTED: " + " ".join(fit.verdict.reasons))
    return "\n".join(lines)


def report_lines(report: BsdfReport) -> list[str]:
    """What a person has to know of a file: its size, its error, its light."""
    found, wavelengths = report.written, report.wavelengths
    lines = [
        f"{report.size / 1e6:.2f} MB, layout {report.layout}: {found.incident} theta_i x {found.table} x {found.table} "
        f"normals x {wavelengths.size} wavelengths from {wavelengths[0]:g} to {wavelengths[-1]:g} nm",
        f"error against the model up to {LARGEST_TESTED_ANGLE:g} deg, the worst of all wavelengths: median "
        f"{found.error.median:.2%}, 99 of 100 directions below {found.error.p99:.2%}, at most "
        f"{found.error.maximum:.2%}; 99 of 100 colours within {found.colour:.2f} dE00",
        f"largest albedo in a white furnace {found.albedo:.4f}",
    ]
    if not report.within_budget:
        lines.append(
            f"the budget of {report.budget.error:.2%} and {report.budget.colour:g} dE00 is NOT kept: no file up to "
            f"{LARGEST_SIZE / 1e6:g} MB keeps it, this is the best one"
        )
    return [*lines, *([report.clamped] if report.clamped else [])]


def report_content(report: BsdfReport) -> dict[str, Any]:
    """The same as one JSON object."""
    return {
        "bytes": report.size,
        "layout": report.layout,
        "wavelengths_nm": report.wavelengths.tolist(),
        "budget": {"p99": report.budget.error, "dE00": report.budget.colour, "kept": report.within_budget},
        "tested_up_to_deg": LARGEST_TESTED_ANGLE,
        "clamped": report.clamped or None,
        "layouts": {name: asdict(tried) for name, tried in report.tried.items()},
    }


def _within(tried: Tried, budget: Budget) -> bool:
    return tried.error.p99 <= budget.error and tried.colour <= budget.colour and tried.albedo <= HIGHEST_ALBEDO


def _rank(tried: Tried, budget: Budget) -> tuple[bool, bool, float]:
    """The smallest file comes first, if it keeps the budget and is sampled well; else the best one."""
    within = _within(tried, budget)
    return not within, tried.noise > NOISIEST, tried.size if within else tried.error.p99


def _tables(
    model: RenderedModel, wavelengths: FloatArray, grid: Grid, lobe: FloatArray
) -> tuple[dict[str, Tensor], MeasuredBsdf]:
    """The fields of a file that reflects no more than all, and how a renderer reads it."""
    fields = bsdf_fields(model.reflectance, model.alpha, wavelengths, grid, lobe)
    darker = darkening(read_bsdf(encode(fields)), model.alpha)
    fields["spectra"] = fields["spectra"] * darker[None, :, :, None, None]
    return fields, read_bsdf(encode(fields))


def _judged(model: RenderedModel, bsdf: MeasuredBsdf, grid: Grid, size: int) -> Tried:
    at = probe(model, np.linspace(*model.wavelengths, _TESTED_WAVELENGTHS))
    found = read_back(bsdf, at)
    return Tried(
        size,
        grid.incident,
        grid.table,
        at.relative(found),
        float(np.percentile(at.colours(found), 99)),
        sampling_noise(bsdf, model.alpha),
        float(file_albedo(bsdf, model.alpha)[1].max()),
    )


def clamping_words(clamped: Clamped | None) -> str:
    """A sentence on what clamping did."""
    if clamped is None:
        return ""
    angle, wavelength = (int(i) for i in np.unravel_index(np.argmin(clamped.factor), clamped.factor.shape))
    touched = clamped.wavelengths[np.any(clamped.factor < 1, axis=0)]
    angles = clamped.angles[np.any(clamped.factor < 1, axis=1)]
    lowest = clamped.factor[angle, wavelength]
    return (
        f"Clamped: the model reflects more light than falls on it, up to {1 / lowest:.3f} of it (at "
        f"{clamped.angles[angle]:g} deg, {clamped.wavelengths[wavelength]:g} nm), so it is multiplied by the smaller "
        f"of 1 / albedo at theta_i and at theta_o, {lowest:.3f} at least; this concerns {touched[0]:g} to "
        f"{touched[-1]:g} nm and {angles[0]:g} to {angles[-1]:g} deg."
    )


def _description(
    about: str,
    model: RenderedModel,
    layout: str,
    found: Tried,
    wavelengths: FloatArray,
    budget: Budget,
    clamped: str,
) -> str:
    """The text inside the file."""
    lines = [
        *([about] if about else []),
        f"{model.words}.",
        f"Beyond {model.wavelengths[0]:g} to {model.wavelengths[1]:g} nm the spectra go on as they end.",
        f"Table layout {layout}; error of this file against the model at {wavelengths.size} wavelength nodes: "
        f"relative, worst of {model.wavelengths[0]:g} to {model.wavelengths[1]:g} nm, median {found.error.median:.2g}, "
        f"99th percentile {found.error.p99:.2g}, maximum {found.error.maximum:.2g} over {PAIRS} pairs of directions up "
        f"to {LARGEST_TESTED_ANGLE:g} deg, half of them uniform in solid angle and half within the lobe; 99th "
        f"percentile of the colour difference {found.colour:.2g} CIEDE2000.",
        f"The error budget of {budget.error:g} and {budget.colour:g} CIEDE2000 is "
        f"{'kept' if _within(found, budget) else 'NOT kept: this is the best file that there is'}.",
        f"Largest albedo in a white furnace {found.albedo:.4f}.",
        *([clamped] if clamped else []),
    ]
    return "\n".join(lines)
