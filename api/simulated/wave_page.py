"""The page of a simulation by waves: map, distributions, spectra, slopes, convergence, and what is left out."""

from html import escape

import numpy as np

from analysis.colour import has_colour
from analysis.figures.curves import distributions, slopes, spectra
from analysis.figures.maps import colour_map
from analysis.figures.notation import with_uncertainty
from analysis.figures.page import bullets, figure
from analysis.figures.shown_colours import exposure_of
from analysis.results import SampleAnalysis
from goniometer.datasets.budget import COVERAGE_FACTOR
from simulators.choices import Kernel
from simulators.waves.convergence import CONVERGED, CONVERGED_SLOPE, Convergence, Figure
from simulators.waves.scan import Setup
from simulators.waves.simulation import MultiplePart, WaveSimulation, equivalent_aperture

_KERNELS = {
    Kernel.HARVEY_SHACK: "The kernel is the generalised Harvey-Shack theory. It is not reciprocal: source and detector "
    "cannot change places where both stand at different angles.",
    Kernel.RECIPROCAL: "The kernel is the generalised Harvey-Shack theory in its reciprocal form.",
    Kernel.KIRCHHOFF: "The kernel is the Kirchhoff approximation, each facet taken as a tangent plane.",
}

_LEFT_OUT = (
    "Light is a scalar wave; polarisation is averaged, with the Fresnel reflectance at the half vector.",
    "No facet lies in the shadow of another, which brightens grazing directions.",
    "Structures narrower than the wavelength are taken as facets of their own slope, though no wave resolves them.",
    "The plane of incidence is computed, and nothing outside it.",
)


_LEAST_SIGNAL = 10.0
"""Signal over standard error of a spectrum that is shown."""

_HEADS = {
    "half the step": "½ step",
    "twice the step": "2 × step",
    "every second height": "½ heights",
    "twice the window": "2 × window",
    "half the patches": "½ patches",
}


def page_body(analysis: SampleAnalysis, setup: Setup, found: WaveSimulation) -> list[str]:
    """Chapters of HTML; `analysis` holds the local fit and the global model of the simulated dataset."""
    return [
        _opening(setup, found),
        _colours(analysis),
        _slopes(analysis),
        *([] if found.multiple is None else [_multiple(setup, found.multiple)]),
        _converged(found),
        "<h2>What is left out</h2>"
        + bullets([*([_SINGLE] if found.multiple is None else []), _KERNELS[setup.kernel], *_LEFT_OUT]),
        _lineage(found),
    ]


_SINGLE = (
    "Light is reflected once. What meets the surface again, and may come back towards the lamp, is missing; "
    "--with-multiple adds it from rays."
)


def _opening(setup: Setup, found: WaveSimulation) -> str:
    middle = int(np.argmin(np.abs(setup.wavelengths - 600)))
    mean = found.computed.brdf[:, middle]
    error = float(np.median(found.computed.u_level[mean > 0, middle] / mean[mean > 0]))
    tiles = [
        ("directions", f"{setup.theta_in.size}"),
        ("wavelengths", f"{setup.wavelengths[0]:g} to {setup.wavelengths[-1]:g} nm"),
        ("patches", f"{found.computed.lineage['patches']}"),
        ("detector aperture", f"{equivalent_aperture(setup.coherence.s_um):.3g}°"),
        ("step of the heights", f"{found.sampling.pitch_um:.3g} µm"),
        ("error of the brightness", f"{100 * error:.2g} % (median)"),
    ]
    told = bullets([found.sampling.message])
    warn = f'<div class="verdict warn"><strong>⚠ Sampled too coarsely</strong>{told}</div>'
    return (
        "<p>Diffraction on the heights of a surface, averaged over all places that the detector can see, with one "
        "reflection of every wave. θ out counts positive on the far side, so θ out = θ in is the mirror direction and "
        "θ out = −θ in leads back to the lamp, where no instrument could look and this one does.</p>\n"
        + ("" if found.sampling.sufficient else warn)
        + '<dl class="facts">'
        + "".join(f"<div><dt>{name}</dt><dd>{value}</dd></div>" for name, value in tiles)
        + "</dl>"
    )


def _colours(analysis: SampleAnalysis) -> str:
    dataset = analysis.dataset
    parts = ["<h2>Colour and brightness</h2>"]
    if has_colour(dataset.wavelengths):
        exposure = exposure_of(dataset)
        maps = [
            colour_map(dataset, dataset.brdf, exposure, "waves", "As bright as simulated", measured=True),
            colour_map(dataset, dataset.brdf, None, "hue", "The same, all equally bright", measured=True),
        ]
        parts.append(
            figure(
                maps,
                "Each cell is one simulated spectrum in its own colour under daylight (D65, BT.709; exposure × "
                f"{exposure.factor:.2g}; {exposure.clipped} cells are brighter than the display), as in Fig. 5 of the "
                "paper. Dashed: mirror direction. Dotted: back to the lamp. Point at a cell for its BRDF.",
            )
        )
    else:
        parts.append("<p>A map of colours needs wavelengths from 400 to 700 nm.</p>")
    curves = [
        distributions(dataset, "distributions", dense=True),
        spectra(dataset, analysis.local, "spectra", least_signal=_LEAST_SIGNAL),
    ]
    parts.append(
        figure(
            curves,
            "Left: BRDF at 600 nm, one line for each incident angle; bands are expanded uncertainties (coverage factor "
            f"{COVERAGE_FACTOR}) from the spread of the patches. Right: spectra, each divided by its value at "
            f"{analysis.local.lambda_n:g} nm, as in Fig. 6 of the paper; lines are the local fit, Eq. 2. Rising to the "
            "right means reddish, falling bluish.",
        )
    )
    return "".join(parts)


def _slopes(analysis: SampleAnalysis) -> str:
    (fit,) = analysis.models
    trusted = "" if fit.verdict.trusted else " It is not to be trusted: " + " ".join(fit.verdict.reasons)
    return "<h2>Slope of the wavelength shift</h2>" + figure(
        slopes(analysis.dataset, analysis.local, fit, "slopes"),
        "Slope m of every spectrum (Eq. 2) over the reflected angle, one panel an incident angle, as in Fig. 9 of the "
        "paper; θm is half the distance from the mirror direction. Bars are expanded uncertainties, hollow dots are "
        f"unreliable. The line is the global model (Eq. 4-5).{escape(trusted)}",
        "three",
    )


def _multiple(setup: Setup, part: MultiplePart) -> str:
    rows = "".join(
        f'<tr><td class="number">{angle:.0f}°</td><td class="number">{100 * by_rays:.2f} %</td>'
        f'<td class="number">{100 * by_waves:.2f} %</td><td class="number">{_signed(slope)}</td></tr>'
        for angle, by_rays, by_waves, slope in zip(
            part.theta_in, part.again_by_rays, part.at_600(setup.wavelengths), part.slope, strict=True
        )
    )
    source = (
        "The slope follows from the energy balance: what single reflection loses at each wavelength, multiple "
        "reflection gets."
        if part.derived
        else "The slope was given."
    )
    head = "".join(
        f'<th class="number">{text}</th>' for text in ("θ in", "by rays", "by waves, 600 nm", "slope / (1/µm)")
    )
    return (
        "<h2>Light that is reflected more than once</h2>"
        "<p>How much light meets the surface again after its first reflection is known from rays and, for each "
        "wavelength, from diffraction. It is added as rays distribute it, with one shift for all directions. "
        f"{source} Rays see no roughness below the wavelength.</p>"
        f'<div class="wide"><table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody>'
        "<caption>Share of the light that meets the surface again, and the slope of its shift.</caption></table></div>"
    )


def _converged(found: WaveSimulation) -> str:
    """Table of the published figures, and the summary of all directions."""
    study = found.convergence
    head = "".join(f'<th class="number">{_HEADS[name]}</th>' for name in study.median)
    rows = "".join(_row(each) for each in study.figures)
    return (
        "<h2>Is it converged?</h2>"
        f"<p>{escape(found.sampling.message)} {study.patches} patches were computed again, with the step of their "
        "heights halved and doubled, with every second height of the topography forgotten and splines in its place, "
        "and through a window twice as wide, which resolves finer and shows more speckle. The last column takes every "
        "second patch alone. Median and 95 of 100 are over all directions that are not nearly dark. "
        f"A reflectance counts as converged when it changes by less than {100 * CONVERGED:g} %, a slope by less than "
        f"{CONVERGED_SLOPE:g} 1/µm, which changes a spectrum by as much at 200 nm from 600 nm.</p>"
        '<div class="wide"><table><thead><tr><th></th><th class="number">θ in → θ out</th><th class="number">value</th>'
        f"{head}</tr></thead>"
        f"<tbody>{_summary(study)}{rows}</tbody>"
        "<caption>Changes of f(600 nm) in per cent, of the slope m in 1/µm; ✓ converged, ✗ not yet, – not computed. "
        "Values with their standard error from the spread of the patches. All of this is of light that is reflected "
        "once.</caption></table></div>"
    )


def _summary(study: Convergence) -> str:
    rows = ""
    for name, values in (("median", study.median), ("95 of 100 below", study.p95)):
        cells = "".join(
            _cell(_percent(value), None if value is None else value < CONVERGED) for value in values.values()
        )
        rows += f'<tr><td>f</td><td class="number">{name}</td><td></td>{cells}</tr>'
    return rows


def _row(each: Figure) -> str:
    form, unit = (_signed_percent, "1/sr") if each.what == "f" else (_signed, "1/µm")
    cells = "".join(_cell(form(change), each.converged(name)) for name, change in each.changes.items())
    direction = f"{each.theta_in:.0f}° → {each.theta_out:.0f}°".replace("-", "−")
    value = f"{with_uncertainty(each.value, each.u)} {unit}"
    return f'<tr><td>{each.what}</td><td class="number">{direction}</td><td class="number">{value}</td>{cells}</tr>'


def _cell(text: str, fine: bool | None) -> str:
    if fine is None:
        return '<td class="mark open number">–</td>'
    return f'<td class="mark {"ok" if fine else "bad"} number">{text} {"✓" if fine else "✗"}</td>'


def _percent(change: float | None) -> str:
    """A relative change as a person reads it."""
    if change is None:
        return ""
    if abs(change) > 1:
        return "over 100 %"
    return "under 0.01 %" if abs(change) < 1e-4 else f"{100 * change:.2g} %"


def _signed_percent(change: float | None) -> str:
    if change is None or not 1e-4 <= abs(change) <= 1:
        return _percent(change)
    return f"{100 * change:+.2g} %".replace("-", "−")


def _signed(value: float | None) -> str:
    return "" if value is None else f"{value:+.2f}".replace("-", "−")


def _lineage(found: WaveSimulation) -> str:
    rows = "".join(
        f"<tr><th>{escape(name.replace('_', ' '))}</th><td>{escape(_said(value))}</td></tr>"
        for name, value in found.computed.lineage.items()
    )
    return f'<h2>Where the numbers come from</h2><div class="wide"><table><tbody>{rows}</tbody></table></div>'


def _said(value: object) -> str:
    """A lineage entry on one line."""
    if isinstance(value, dict):
        return ", ".join(f"{name.replace('_', ' ')} {item}" for name, item in value.items())
    if isinstance(value, list):
        return ", ".join(f"{item:.3g}" if isinstance(item, float) else str(item) for item in value)
    return str(value)
