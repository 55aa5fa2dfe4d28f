"""The chapters of a report that show the measurement: its colours, its distributions, its wavelength shift."""

import numpy as np

from analysis.choices import MODEL_NAMES
from analysis.figures.curves import distributions, slopes, spectra
from analysis.figures.filled import STEP
from analysis.figures.maps import colour_map
from analysis.figures.page import bullets, figure
from analysis.figures.shown_colours import exposure_of
from analysis.results import ModelFit, SampleAnalysis
from analysis.wording import words
from goniometer.datasets.between import FEWEST
from goniometer.datasets.budget import COVERAGE_FACTOR
from goniometer.datasets.dataset import Dataset
from goniometer.datasets.fill import TELLS, Filled, fill, unmeasured

TWO_COMPONENT_MODELS = ("global-two-component", "two-component", "dielectric-two-component")
"""Models whose slope stands beside the cosine, the first of those that were fitted."""


def measured_chapter(analysis: SampleAnalysis) -> str:
    """What was measured, or simulated: maps, distributions, spectra."""
    dataset, local, named = analysis.dataset, analysis.local, words(analysis.dataset)
    exposure = exposure_of(dataset)
    enough = np.count_nonzero(dataset.usable & np.isfinite(dataset.brdf).any(axis=1)) >= FEWEST
    filled = fill(dataset, *unmeasured(dataset, STEP)) if enough and not dataset.simulated else None
    noise = "single values" if dataset.simulated else "counts"
    clipped = f"; {exposure.clipped} cells are brighter than the display and clipped" if exposure.clipped else ""
    colourless = "" if exposure.coloured else " No cell has a colour, for every spectrum has a gap."
    maps = [
        colour_map(
            dataset, dataset.brdf, exposure, "colours", f"As bright as {named.done}", measured=True, filled=filled
        ),
        colour_map(dataset, dataset.brdf, None, "hue", "The same, all equally bright", measured=True, filled=filled),
    ]
    return (
        f"<h2>What was {named.done}</h2>"
        + figure(
            maps,
            f"Each cell is one {named.done} spectrum, shown in its own colour under daylight (D65, BT.709; exposure "
            f"× {exposure.factor:.2g}{clipped}).{colourless} Dashed: mirror direction. Dotted: back into the "
            f"lamp{_unseen(dataset)}. Empty places were not {named.done}; on the right, pale cells are too dark to "
            "have a hue. Point at a cell for its angles and its BRDF, with its combined standard uncertainty "
            "(coverage factor 1) in brackets. A dashed outline marks a flagged cell; pointing at it says for what.",
        )
        + '<div class="pair"><div><h3>Where the light goes</h3>'
        + figure(
            [distributions(dataset, "distributions", filled=filled)],
            f"BRDF at 600 nm on a logarithmic scale, one line for each incident angle; dots are {named.done}, lines "
            "are read between them by a process that knows how well it can. Bands are "
            f"expanded uncertainties (coverage factor {COVERAGE_FACTOR}) and mostly thinner than the lines. "
            + ("" if dataset.simulated else _filled_words(filled)),
        )
        + "</div><div><h3>How its colour changes</h3>"
        + figure(
            [spectra(dataset, local, "spectra")],
            "Spectra from backward (negative) to forward, each divided by its value at "
            f"{local.lambda_n:g} nm. Rising to the right means reddish, falling bluish. Bands: {named.result} with "
            f"the expanded uncertainty of its {noise} (coverage factor {COVERAGE_FACTOR}), without the errors that "
            "wavelengths share; lines: the local fit.",
        )
        + "</div></div>"
    )


def _unseen(dataset: Dataset) -> str:
    """What a map shows where nobody saw anything; a simulation has no such place."""
    if dataset.simulated:
        return ""
    return (
        "; there the detector blocks the light. Hatched places were not measured; a colour under the hatching is "
        "filled, and pointing at it says by what"
    )


def _filled_words(filled: Filled | None) -> str:
    """What is dashed in the distributions, what not even that, and what is assumed."""
    if filled is None:
        return "Lines break where the detector blocks the source."
    silent = int(np.sum(~filled.tells))
    words = (
        "Where the detector blocks the source, lines are dashed: <em>filled by interpolation, not measured</em>, from "
        "both edges and the other incident angles, under the assumption that nothing in there is steeper than at the "
        "edges; a peak narrower than the gap would go unseen. Nothing filled takes part in any fit."
    )
    if not silent:
        return words
    return (
        f"{words} At {silent} of {filled.theta_in.size} filled directions the relative standard uncertainty exceeds "
        f"{100 * TELLS:.0f} %, so nothing can be said and nothing is drawn."
    )


def shift_chapter(analysis: SampleAnalysis) -> str:
    """The slopes of the spectra and the global model of them."""
    dataset, local = analysis.dataset, analysis.local
    fit = analysis.model("global")
    two = next((each for each in analysis.models if each.model in TWO_COMPONENT_MODELS), None)
    blocked = "" if dataset.simulated else "Grey: blocked by the detector."
    dashed = f"Dashed: {MODEL_NAMES[two.model]}. " if two else ""
    reliable = int(local.reliable.sum())
    good = int(np.sum(local.r2[local.reliable] > 0.9))
    return (
        "<h2>The wavelength shift</h2>"
        "<p>A smooth metal colours light only through its Fresnel reflectance. On a rough one every spectrum is tilted "
        "on top of that, along a straight line: diffraction. The <em>slope</em> m of this line is fitted to every "
        f"spectrum on its own (local fit); m = 1 /µm means that the reflectance rises by 10 % from {local.lambda_n:g} "
        f"to {local.lambda_n + 100:g} nm. {reliable} of {local.reliable.size} spectra give a reliable slope; the fit "
        f"explains more than 90 % of the variation (r² &gt; 0.9) in {good} of these.</p>"
        + bullets(local.doubts)
        + _slope_in_words(fit, float(np.max(np.abs(dataset.theta_out - dataset.theta_in))) / 2, words(dataset).done)
        + figure(
            slopes(dataset, local, fit, "slopes", two),
            "Dots: slope of each spectrum, bars its expanded uncertainty (coverage factor "
            f"{COVERAGE_FACTOR}), hollow where it is unreliable. Line: the global model, one cosine of θm for all "
            f"directions, θm = |θ out − θ in| / 2. {dashed}{blocked}",
            "three",
        )
    )


def _slope_in_words(fit: ModelFit, largest: float, done: str) -> str:
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
        return f"{words}, and it keeps that hue over all {done} directions.</p>"
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
