"""The report of one sample: a single HTML file that explains itself to a person who has not read the paper.

It needs no other file and no network: figures are inline SVG, the style stands inside, light and dark follow
the reader's system.
"""

from dataclasses import dataclass
from html import escape
from pathlib import Path

import numpy as np

from analysis import figures
from analysis.errors import ExportError
from analysis.export_mitsuba import LARGEST_TESTED_ANGLE, BsdfReport
from analysis.identify import lobe_width
from analysis.notation import roughly, with_uncertainty
from analysis.results import ModelFit, SampleAnalysis
from goniometer.dataset import NOT_COVERED
from goniometer.geometry import BLOCKED_HALF_WIDTH

MODEL_NAMES = {
    "local": "Local fit",
    "global": "Global model",
    "cook-torrance": "Cook-Torrance",
    "cook-torrance-shift": "Cook-Torrance with shift",
}

_MEANING = {
    "alpha": "roughness of the surface (GGX)",
    "h": "height of the slope's cosine",
    "w": "how fast the slope changes with θm",
    "t_y": "slope that all directions share",
    "p": "exponent of the Fresnel term: how often light was reflected",
}


@dataclass(frozen=True)
class RunFacts:
    """What a report says about the run, besides its data."""

    uniform_points: int
    """Points that a scan at every degree of theta_out would have had."""
    bench_time: float
    """Seconds from the first move to the last exposure."""
    certificate: str
    """Which certificate the reference panel has, in words."""
    blocked_points: int
    """Directions of a 1 degree grid in which the detector would block the source; a plan never asks for them."""
    failed_points: int
    """Directions that could not be measured."""
    files: tuple[tuple[str, str], ...]
    """Path relative to the report, and what the file holds."""
    bsdf: BsdfReport | None = None
    """How well the rendering file stands for the model."""


def write_report(path: Path, analysis: SampleAnalysis, facts: RunFacts) -> None:
    """Write the report to `path`; raises `ExportError` where that is impossible."""
    try:
        path.write_text(report_html(analysis, facts), encoding="utf-8")
    except OSError as fault:
        raise ExportError(f"The report {path} cannot be written: {fault.strerror}.") from fault


def report_html(analysis: SampleAnalysis, facts: RunFacts) -> str:
    """The report as one HTML text."""
    sample = escape(analysis.dataset.sample)
    style = Path(__file__).with_name("report.css").read_text(encoding="utf-8")
    body = "\n".join(
        [
            f"<h1>{sample}: colour and brightness of its reflection</h1>",
            _opening(analysis, facts),
            _verdict(analysis),
            _measured(analysis),
            _shift(analysis),
            _models(analysis),
            _left_out(analysis, facts),
            _files(analysis, facts),
            _lineage(analysis, facts),
        ]
    )
    return (
        f'<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n<title>{sample}: BRDF report</title>\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<style>\n{style}</style>\n</head>\n<body>\n<main>\n{body}\n</main>\n</body>\n</html>\n"
    )


def _opening(analysis: SampleAnalysis, facts: RunFacts) -> str:
    dataset = analysis.dataset
    points = dataset.theta_in.size
    tiles = [
        ("spectra measured", f"{points}"),
        ("a 1° grid would need", f"{facts.uniform_points}"),
        ("bench time of this sample", _duration(facts.bench_time)),
        ("wavelengths", f"{dataset.wavelengths[0]:.0f} to {dataset.wavelengths[-1]:.0f} nm"),
        ("aperture", f"{dataset.aperture:g}°"),
    ]
    return (
        "<p>A beam of white light falls on the sample at an angle θ in from its normal; a detector looks at it from "
        "the angle θ out, in the same plane. θ out counts positive on the far side, so θ out = θ in is the mirror "
        "direction and θ out = −θ in looks straight back into the lamp. What is measured is the BRDF: how much light "
        "goes this way for how much falls in, at every wavelength.</p>\n"
        '<dl class="facts">' + "".join(f"<div><dt>{name}</dt><dd>{value}</dd></div>" for name, value in tiles) + "</dl>"
    )


def _verdict(analysis: SampleAnalysis) -> str:
    """Banner: may the fits be believed, and why not."""
    doubted = [fit for fit in analysis.models if not fit.verdict.trusted]
    parts = []
    if doubted:
        for fit in doubted:
            parts.append(
                f'<div class="verdict warn"><strong>⚠ Do not trust: {MODEL_NAMES[fit.model]}</strong>'
                f"{_list(fit.verdict.reasons)}</div>"
            )
    sound = [fit for fit in analysis.models if fit.verdict.trusted]
    if sound:
        names = ", ".join(MODEL_NAMES[fit.model] for fit in sound)
        notes = [f"{MODEL_NAMES[fit.model]}: {' '.join(fit.verdict.reasons)}" for fit in sound if fit.verdict.reasons]
        parts.append(f'<div class="verdict"><strong>✓ Parameters are determined: {names}</strong>{_list(notes)}</div>')
    return "\n".join(parts)


def _measured(analysis: SampleAnalysis) -> str:
    dataset, local = analysis.dataset, analysis.local
    exposure = figures.exposure_of(dataset)
    clipped = f"; {exposure.clipped} cells are brighter than the display and clipped" if exposure.clipped else ""
    maps = [
        figures.colour_map(dataset, dataset.brdf, exposure, "measured", "As bright as measured", measured=True),
        figures.colour_map(dataset, dataset.brdf, None, "hue", "The same, all equally bright", measured=True),
    ]
    return (
        "<h2>What was measured</h2>"
        + _figure(
            maps,
            "Each cell is one measured spectrum, shown in its own colour under daylight (D65, BT.709; exposure "
            f"× {exposure.factor:.2g}{clipped}). Dashed: mirror direction. Dotted: back into the lamp; there the "
            "detector blocks the light (hatched). Empty places were not measured; on the right, pale cells are too "
            "dark to have a hue. Point at a cell for its angles and its BRDF, with the standard uncertainty (coverage "
            "factor 1) of its counts in brackets; the error of the angles is not in it.",
        )
        + '<div class="pair"><div><h3>Where the light goes</h3>'
        + _figure(
            [figures.distributions(dataset, "distributions")],
            "BRDF at 600 nm on a logarithmic scale, one line for each incident angle; dots are measurements. Bands are "
            f"expanded uncertainties (coverage factor {figures.COVERAGE}) and mostly thinner than the lines. Lines "
            "break where the detector blocks the source.",
        )
        + "</div><div><h3>How its colour changes</h3>"
        + _figure(
            [figures.spectra(dataset, local, "spectra")],
            "Spectra from backward (negative) to forward, each divided by its value at "
            f"{local.lambda_n:g} nm. Rising to the right means reddish, falling bluish. Bands: measurement with "
            f"expanded uncertainty (coverage factor {figures.COVERAGE}); lines: the local fit.",
        )
        + "</div></div>"
    )


def _shift(analysis: SampleAnalysis) -> str:
    dataset, local = analysis.dataset, analysis.local
    fit = analysis.model("global")
    reliable = int(local.reliable.sum())
    good = int(np.sum(local.r2[local.reliable] > 0.9))
    return (
        "<h2>The wavelength shift</h2>"
        "<p>A smooth metal colours light only through its Fresnel reflectance. On a rough one every spectrum is tilted "
        "on top of that, along a straight line: diffraction. The <em>slope</em> m of this line is fitted to every "
        f"spectrum on its own (local fit); m = 1 /µm means that the reflectance rises by 10 % from {local.lambda_n:g} "
        f"to {local.lambda_n + 100:g} nm. {reliable} of {local.reliable.size} spectra give a reliable slope; the fit "
        f"explains more than 90 % of the variation (r² &gt; 0.9) in {good} of these.</p>"
        + _slope_in_words(fit, float(np.max(np.abs(dataset.theta_out - dataset.theta_in))) / 2)
        + _figure(
            figures.slopes(dataset, local, fit, "slopes"),
            "Dots: slope of each spectrum, bars its expanded uncertainty (coverage factor "
            f"{figures.COVERAGE}), hollow where it is unreliable. Line: the global model, one cosine of θm for all "
            "directions, θm = |θ out − θ in| / 2. Grey: blocked by the detector.",
            "three",
        )
    )


def _slope_in_words(fit: ModelFit, largest: float) -> str:
    """What the cosine says up to theta_m = `largest`, degrees, for a trusted fit."""
    if not fit.verdict.trusted:
        return "<p>For this sample one cosine does not describe the slopes; see the verdict above.</p>"
    h, w, t_y = fit.value("h"), fit.value("w"), fit.value("t_y")
    mirror = h + t_y
    words = (
        f"<p>In the mirror direction the slope is {mirror:+.2f} /µm, so the reflection is "
        f"{'reddish' if mirror > 0 else 'bluish'} there".replace("-", "−")
    )
    zeros = _zeros(h, w, t_y, largest)
    if not zeros:
        return f"{words}, and it keeps that hue over all measured directions.</p>"
    hues = ("bluish", "reddish") if mirror > 0 else ("reddish", "bluish")
    turns = ", ".join(f"{hues[i % 2]} beyond θm = {zero:.0f}°" for i, zero in enumerate(zeros))
    return f"{words}; it turns {turns}.</p>"


def _zeros(h: float, w: float, t_y: float, largest: float) -> list[float]:
    """Angles theta_m up to `largest`, degrees, at which h cos(w theta_m) + t_y changes its sign, ascending."""
    if h == 0 or abs(t_y / h) >= 1 or w <= 0:
        return []
    first = np.arccos(-t_y / h)
    turns = np.arange(int(np.radians(largest) * w / (2 * np.pi)) + 1) * 2 * np.pi
    zeros = np.degrees(np.sort(np.concatenate([turns + first, turns + 2 * np.pi - first])) / w)
    return [float(zero) for zero in zeros if zero < largest]


def _models(analysis: SampleAnalysis) -> str:
    dataset = analysis.dataset
    exposure = figures.exposure_of(dataset)
    plain, shifted = analysis.model("cook-torrance"), analysis.model("cook-torrance-shift")
    pictures = [
        figures.colour_map(dataset, plain.fitted, exposure, "ct", "Cook-Torrance"),
        figures.colour_map(dataset, dataset.brdf, exposure, "measured-again", "Measured", measured=True),
        figures.colour_map(dataset, shifted.fitted, exposure, "cts", "Cook-Torrance with shift"),
    ]
    shown = {
        "local": ("chromatic", "Local fit, hue"),
        "global": ("chromatic", "Global model, hue"),
        "cook-torrance": ("absolute", "Cook-Torrance"),
        "cook-torrance-shift": ("absolute", "Cook-Torrance with shift"),
    }
    values = {name: getattr(analysis.differences[name], kind) for name, (kind, _) in shown.items()}
    largest = max(1.0, *(float(np.nanpercentile(v, 99)) for v in values.values()))
    maps = [
        figures.difference_map(
            dataset,
            values[name],
            largest,
            f"difference-{name}",
            f"{title}: mean {analysis.differences[name].statistics(kind)['mean']:.2f}",
        )
        for name, (kind, title) in shown.items()
    ]
    return (
        "<h2>What the models say</h2>"
        "<p>Cook-Torrance describes a rough surface as tiny mirrors that point in all directions around the normal. "
        "One number, the roughness alpha, says how widely: here the lobe is "
        f"{lobe_width(shifted.value('alpha')):.2g}° wide (full width at half maximum). With shift, the same model is "
        "multiplied by the straight line of the chapter above, whose slope is h cos(w θm).</p>"
        + _difference_table(analysis)
        + _parameter_table(analysis)
        + "<h3>Fits beside the measurement</h3>"
        + _figure(pictures, "Colours as in the first picture, with the same exposure.", "three")
        + "<h3>How far off the fits are</h3>"
        + f'<div class="scale">{figures.difference_scale(largest, "scale")}</div>'
        + _figure(
            maps,
            "Colour difference CIEDE2000 between fit and measurement, cell by cell, all on one scale. The local and "
            "global fits describe the hue only and are compared after dividing both spectra by their value at "
            f"{analysis.local.lambda_n:g} nm; the Cook-Torrance fits are compared as they are.",
        )
    )


def _difference_table(analysis: SampleAnalysis) -> str:
    means = {n: [d.statistics(k)["mean"] for k in ("absolute", "chromatic")] for n, d in analysis.differences.items()}
    rows = []
    for name in ("cook-torrance", "cook-torrance-shift", "global", "local"):
        statistics = analysis.differences[name].statistics("absolute")
        cells = [*means[name], statistics["median"], statistics["p95"], statistics["max"]]
        # the local fit and the global model take their brightness from the measurement
        best = name == min(("cook-torrance", "cook-torrance-shift"), key=lambda n: means[n][0])
        rows.append(
            f"<tr{' class=best' if best else ''}><td>{MODEL_NAMES[name]}</td>"
            + "".join(f'<td class="number">{value:.2f}</td>' for value in cells)
            + "</tr>"
        )
    counts = [analysis.differences["cook-torrance"].statistics(kind)["count"] for kind in ("absolute", "chromatic")]
    head = "".join(f'<th class="number">{t}</th>' for t in ("mean", "mean, hue only", "median", "95 %", "largest"))
    return (
        "<h3>Mean colour difference to the measurement</h3>"
        f'<div class="wide"><table><thead><tr><th>model</th>{head}</tr></thead><tbody>{"".join(rows)}</tbody>'
        f"<caption>CIEDE2000 over {counts[0]} measured directions; 1 is just noticeable. Values compare cos(θ in) × "
        "BRDF under D65, white being 1; “hue only” compares spectra divided by their value at "
        f"{analysis.local.lambda_n:g} nm, where they stand clear of their noise ({counts[1]} directions). The global "
        "model and the local fit take their brightness from the measurement, so only their hue is a test.</caption>"
        "</table></div>"
    )


def _parameter_table(analysis: SampleAnalysis) -> str:
    rows = []
    for fit in analysis.models:
        first = (
            f'<td rowspan="{len(fit.parameters)}">{MODEL_NAMES[fit.model]}<br>'
            f'<span class="soft">{escape(fit.equation)}</span></td>'
        )
        for parameter in fit.parameters:
            unit = {"1": "", "1/um": " /µm"}.get(parameter.unit, f" {parameter.unit}")
            trusted = fit.verdict.trusted
            value = with_uncertainty(parameter.value, parameter.standard_error) if trusted else roughly(parameter.value)
            rows.append(
                f"<tr>{first}<td><code>{escape(parameter.name)}</code></td>"
                f'<td class="number">{value}{escape(unit)}</td><td>{_MEANING.get(parameter.name, "")}</td></tr>'
            )
            first = ""
    return (
        "<h3>Parameters</h3>"
        '<div class="wide"><table><thead><tr><th>model</th><th>parameter</th><th class="number">value</th>'
        f"<th>meaning</th></tr></thead><tbody>{''.join(rows)}</tbody>"
        "<caption>In brackets: standard uncertainty (coverage factor 1) of the last digits, propagated from the counts "
        f"and the errors of the stages; {NOT_COVERED}. A value with ≈ belongs to a fit that is not to be trusted."
        "</caption></table></div>"
    )


def _left_out(analysis: SampleAnalysis, facts: RunFacts) -> str:
    dataset, local = analysis.dataset, analysis.local
    saturated, unreliable = int(dataset.saturated.sum()), int(np.sum(~local.reliable))
    items = [
        f"Directions within {BLOCKED_HALF_WIDTH:g}° of the way back to the lamp ({facts.blocked_points} of a 1° grid): "
        "the detector would stand in the beam. They are in no picture, no fit and no file.",
        f"{facts.failed_points} directions could not be measured." if facts.failed_points else "",
        f"{saturated} spectra were too bright at the shortest exposure in some pixels and take no part in the fits."
        if saturated
        else "",
        f"{unreliable} spectra are too weak or too odd for a slope of their own (hollow dots)." if unreliable else "",
    ]
    clamped = analysis.model("cook-torrance-shift").clamped_points
    if clamped:
        items.append(f"At {clamped} directions the shift would be negative at some wavelength and is taken as zero.")
    return "<h2>What was left out</h2>" + _list([item for item in items if item])


def _files(analysis: SampleAnalysis, facts: RunFacts) -> str:
    rows = "".join(
        f'<tr><td><a href="{escape(path, quote=True)}"><code>{escape(path)}</code></a></td><td>{escape(what)}</td></tr>'
        for path, what in facts.files
    )
    text = f'<h2>Files</h2><div class="wide"><table><tbody>{rows}</tbody></table></div>'
    if facts.bsdf is None:
        return text
    error = facts.bsdf.error
    doubt = "" if analysis.model("cook-torrance-shift").verdict.trusted else ", and this fit is not to be trusted"
    median, p99, maximum = (f"{100 * value:.1f} %" for value in (error.median, error.p99, error.maximum))
    return text + (
        "<p>The rendering file (<code>.bsdf</code>) holds the fitted model Cook-Torrance with shift, not the "
        f"measurement{doubt}: an in-plane scan cannot fill a hemisphere. Read back as a renderer reads it, it is off "
        f"its model by {median} at the median, by less than {p99} in 99 of 100 directions and by {maximum} at most, up "
        f"to {LARGEST_TESTED_ANGLE:g}° from the normal; interpolating its {len(facts.bsdf.wavelengths)} wavelengths "
        f"costs at most {facts.bsdf.colour_error:.2f} dE00.</p>"
    )


def _lineage(analysis: SampleAnalysis, facts: RunFacts) -> str:
    dataset = analysis.dataset
    known = {
        "certificate of the reference": facts.certificate,
        "data, SHA-256": dataset.content_hash,
        "standard uncertainty of a stage": f"{dataset.u_angle:g}°",
        **{name.replace("_", " "): _short(value) for name, value in dataset.lineage.items() if name != "certificate"},
    }
    rows = "".join(f"<tr><th>{escape(name)}</th><td>{escape(value)}</td></tr>" for name, value in known.items())
    return f'<h2>Where the numbers come from</h2><div class="wide"><table><tbody>{rows}</tbody></table></div>'


def _short(value: object) -> str:
    """A lineage entry on one line."""
    if isinstance(value, (list, tuple)) and len(value) > 4:
        return f"{value[0]} … {value[-1]} ({len(value)})"
    if isinstance(value, (list, tuple)):
        return ", ".join(map(str, value))
    if isinstance(value, dict):
        return ", ".join(f"{name.replace('_', ' ')} {_short(item)}" for name, item in value.items())
    return str(value)


def _figure(panels: list[str], caption: str, kind: str = "") -> str:
    return f'<figure><div class="panels {kind}">{"".join(panels)}</div><figcaption>{caption}</figcaption></figure>'


def _list(items: list[str] | tuple[str, ...]) -> str:
    return f"<ul>{''.join(f'<li>{escape(item)}</li>' for item in items)}</ul>" if items else ""


def _duration(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    if hours:
        return f"{hours} h {minutes} min"
    return f"{minutes} min {rest} s" if minutes else f"{rest} s"
