"""The report of one sample: a single HTML file that explains itself to a person who has not read the paper.

It needs no other file and no network: figures are inline SVG, the style stands inside, light and dark follow
the reader's system.
"""

from dataclasses import dataclass
from html import escape
from pathlib import Path

import numpy as np

from analysis.bsdf.error import LARGEST_TESTED_ANGLE
from analysis.bsdf.export import BsdfReport
from analysis.choices import MODEL_NAMES
from analysis.errors import ExportError
from analysis.figures.page import bullets, page
from analysis.reports.measured import measured_chapter, shift_chapter
from analysis.reports.models import models_chapter
from analysis.reports.quality import budget_chapter, quality_chapter, warnings
from analysis.results import SampleAnalysis
from analysis.wording import words
from goniometer.datasets.dataset import Dataset
from goniometer.geometry import BLOCKED_HALF_WIDTH


@dataclass(frozen=True)
class RunFacts:
    """What a report says about the run, besides its data; None is what nobody knows of data without one."""

    uniform_points: int | None
    """Points that a scan at every degree of theta_out would have had."""
    bench_time: float | None
    """Seconds from the first move to the last exposure."""
    blocked_points: int | None
    """Directions of a 1 degree grid in which the detector would block the source; a plan never asks for them."""
    failed_points: int
    """Directions that could not be measured."""
    too_noisy: str
    """Which points missed the wanted signal-to-noise ratio, as a sentence; empty where none did."""
    files: tuple[tuple[str, str], ...]
    """Path relative to the report, and what the file holds."""
    bsdf: BsdfReport | None = None
    """How well the rendering file stands for the model."""


NO_RUN = RunFacts(None, None, None, failed_points=0, too_noisy="", files=())
"""Of data that were measured elsewhere, or simulated."""


def write_report(path: Path, analysis: SampleAnalysis, facts: RunFacts) -> None:
    """Write the report to `path`; raises `ExportError` where that is impossible."""
    try:
        path.write_text(report_html(analysis, facts), encoding="utf-8")
    except OSError as fault:
        raise ExportError(f"The report {path} cannot be written: {fault.strerror}.") from fault


def report_html(analysis: SampleAnalysis, facts: RunFacts) -> str:
    """The report as one HTML text."""
    sample = analysis.dataset.sample
    body = [
        f"<h1>{escape(sample)}: colour and brightness of its reflection</h1>",
        _origin(analysis.dataset),
        warnings(analysis.dataset),
        _opening(analysis, facts),
        _verdict(analysis),
        measured_chapter(analysis),
        shift_chapter(analysis),
        models_chapter(analysis),
        quality_chapter(analysis.dataset, facts.too_noisy),
        budget_chapter(analysis.dataset),
        _left_out(analysis, facts),
        _files(analysis, facts),
        _lineage(analysis.dataset),
    ]
    return page(f"{sample}: BRDF report", body)


def _origin(dataset: Dataset) -> str:
    """A banner where nothing of what follows was seen on any bench."""
    if not dataset.simulated:
        return ""
    told = escape(str(dataset.lineage["simulated"]))
    return f'<div class="verdict note"><strong>Simulated: {told}</strong></div>'


def _opening(analysis: SampleAnalysis, facts: RunFacts) -> str:
    dataset = analysis.dataset
    points = dataset.theta_in.size
    no_aperture = "none" if dataset.simulated else "corrected for"
    tiles = [
        (f"spectra {words(dataset).done}", f"{points}"),
        *([] if facts.uniform_points is None else [("a 1° grid would need", f"{facts.uniform_points}")]),
        *([] if facts.bench_time is None else [("bench time of this sample", _duration(facts.bench_time))]),
        ("wavelengths", f"{dataset.wavelengths[0]:.0f} to {dataset.wavelengths[-1]:.0f} nm"),
        ("aperture", f"{dataset.aperture:g}°" if dataset.aperture else no_aperture),
    ]
    return (
        "<p>A beam of white light falls on the sample at an angle θ in from its normal; a detector looks at it from "
        "the angle θ out, in the same plane. θ out counts positive on the far side, so θ out = θ in is the mirror "
        f"direction and θ out = −θ in looks straight back into the lamp. What is {words(dataset).done} is the "
        "BRDF: how much light goes this way for how much falls in, at every wavelength.</p>\n"
        '<dl class="facts">' + "".join(f"<div><dt>{name}</dt><dd>{value}</dd></div>" for name, value in tiles) + "</dl>"
    )


def _verdict(analysis: SampleAnalysis) -> str:
    """Banners: may the fits be believed, and why not; what all fits have to say is said once."""
    first, *others = (fit.verdict.reasons for fit in analysis.models)
    common = [reason for reason in first if all(reason in reasons for reasons in others)]
    own = {fit.model: [r for r in fit.verdict.reasons if r not in common] for fit in analysis.models}
    parts = [
        f'<div class="verdict warn"><strong>⚠ Do not trust: {MODEL_NAMES[fit.model]}</strong>'
        f"{bullets(own[fit.model])}</div>"
        for fit in analysis.models
        if not fit.verdict.trusted
    ]
    sound = [fit for fit in analysis.models if fit.verdict.trusted]
    if sound:
        names = ", ".join(MODEL_NAMES[fit.model] for fit in sound)
        notes = [f"{MODEL_NAMES[fit.model]}: {' '.join(own[fit.model])}" for fit in sound if own[fit.model]]
        parts.append(
            f'<div class="verdict"><strong>✓ Parameters are determined: {names}</strong>{bullets(notes)}</div>'
        )
    if common:
        parts.append(f'<div class="verdict note"><strong>All fits</strong>{bullets(common)}</div>')
    return "\n".join(parts)


def _left_out(analysis: SampleAnalysis, facts: RunFacts) -> str:
    dataset, local = analysis.dataset, analysis.local
    flagged, unreliable = int(np.sum(~dataset.usable)), int(np.sum(dataset.usable & ~local.reliable))
    items = [
        "Directions that nobody asked the simulation for."
        if dataset.simulated
        else "Directions that the file does not hold: it was measured elsewhere."
        if facts.blocked_points is None
        else f"Directions within {BLOCKED_HALF_WIDTH:g}° of the way back to the lamp ({facts.blocked_points} of a 1° "
        "grid): the detector would stand in the beam. They are in no fit and no file; pictures show what can be filled "
        "there, hatched or dashed.",
        f"{facts.failed_points} directions could not be measured." if facts.failed_points else "",
        f"{flagged} spectra are flagged and take no part in the fits; the chapter on quality says which and why."
        if flagged
        else "",
        f"{unreliable} spectra are too weak or too odd for a slope of their own (hollow dots)." if unreliable else "",
    ]
    clamped = analysis.model("cook-torrance-shift").clamped_points
    if clamped:
        items.append(f"At {clamped} directions the shift would be negative at some wavelength and is taken as zero.")
    return "<h2>What was left out</h2>" + bullets([item for item in items if item])


def _files(analysis: SampleAnalysis, facts: RunFacts) -> str:
    if not facts.files and facts.bsdf is None:
        return ""
    rows = "".join(
        f'<tr><td><a href="{escape(path, quote=True)}"><code>{escape(path)}</code></a></td><td>{escape(what)}</td></tr>'
        for path, what in facts.files
    )
    text = f'<h2>Files</h2><div class="wide"><table><tbody>{rows}</tbody></table></div>'
    if facts.bsdf is None:
        return text
    error = facts.bsdf.written.error
    doubt = "" if analysis.model("cook-torrance-shift").verdict.trusted else ", and this fit is not to be trusted"
    median, p99, maximum = (f"{100 * value:.1f} %" for value in (error.median, error.p99, error.maximum))
    return text + (
        "<p>The rendering file (<code>.bsdf</code>) holds the fitted model Cook-Torrance with shift, not the "
        f"{words(analysis.dataset).result}{doubt}: an in-plane scan cannot fill a hemisphere. Read back as a renderer "
        "reads it, it is off "
        f"its model by {median} at the median, by less than {p99} in 99 of 100 directions and by {maximum} at most, up "
        f"to {LARGEST_TESTED_ANGLE:g}° from the normal, with its {len(facts.bsdf.wavelengths)} wavelengths; 99 of 100 "
        f"colours are within {facts.bsdf.written.colour:.2f} dE00. In a white furnace it reflects "
        f"{100 * facts.bsdf.written.albedo:.1f} % at most."
        f"{' ' + escape(facts.bsdf.clamped) if facts.bsdf.clamped else ''}</p>"
    )


def _lineage(dataset: Dataset) -> str:
    known = {
        "data, SHA-256": dataset.content_hash,
        **({} if dataset.simulated else _stages(dataset)),
        **{name.replace("_", " "): _short(value) for name, value in dataset.lineage.items() if value not in (None, [])},
    }
    rows = "".join(f"<tr><th>{escape(name)}</th><td>{escape(value)}</td></tr>" for name, value in known.items())
    return f'<h2>Where the numbers come from</h2><div class="wide"><table><tbody>{rows}</tbody></table></div>'


def _stages(dataset: Dataset) -> dict[str, str]:
    return {
        "standard uncertainty of a stage position (coverage factor 1)": f"{dataset.u_angle:g}°",
        "standard uncertainty of a stage's zero (coverage factor 1)": f"{dataset.u_zero:g}°",
    }


def _short(value: object) -> str:
    """A lineage entry on one line."""
    if isinstance(value, (list, tuple)) and len(value) > 4:
        return f"{value[0]} … {value[-1]} ({len(value)})"
    if isinstance(value, (list, tuple)):
        return ", ".join(map(str, value))
    if isinstance(value, dict):
        return ", ".join(f"{name.replace('_', ' ')} {_short(item)}" for name, item in value.items())
    return str(value)


def _duration(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    if hours:
        return f"{hours} h {minutes} min"
    return f"{minutes} min {rest} s" if minutes else f"{rest} s"
