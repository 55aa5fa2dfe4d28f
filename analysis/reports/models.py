"""The chapter of a report that says what the fitted models are worth."""

from html import escape

import numpy as np

from analysis.choices import BRDF_MODELS, MODEL_NAMES
from analysis.figures.albedo import albedo_curves
from analysis.figures.maps import colour_map, difference_map, difference_scale
from analysis.figures.notation import roughly, uncertainty, with_uncertainty
from analysis.figures.page import figure
from analysis.figures.shown_colours import exposure_of
from analysis.fits.misfit import PARTS_OF_FITS
from analysis.reflectance.distributions import lobe_width
from analysis.results import ModelFit, SampleAnalysis
from analysis.wording import words
from goniometer.datasets.budget import COVERAGE_FACTOR

_UNIT = {"1": "", "1/um": "/µm"}
"""How a person reads the unit of a parameter."""

_OF_BRIGHTNESS = set(BRDF_MODELS)
"""Models that say how bright a direction is, and not its hue alone."""

_MEANING = {
    "alpha": "roughness of the surface",
    "eta": "refractive index",
    "h": "height of the slope's cosine",
    "w": "how fast the slope changes with θm",
    "t_y": "slope that all directions share",
    "p": "exponent of the Fresnel term: how often light was reflected",
    "kappa": "how much of what is reflected more than once goes back to the lamp",
    "sharpness": "how suddenly multiple reflections take over",
    "threshold": "where they take over",
}


def models_chapter(analysis: SampleAnalysis) -> str:
    """Colour differences, parameters and their uncertainty, and the fits beside the measurement."""
    dataset, named = analysis.dataset, words(analysis.dataset)
    exposure = exposure_of(dataset)
    plain, shifted = analysis.model("cook-torrance"), analysis.model("cook-torrance-shift")
    pictures = [
        colour_map(dataset, plain.fitted, exposure, "ct", "Cook-Torrance"),
        colour_map(dataset, dataset.brdf, exposure, "colours-again", named.done.capitalize(), measured=True),
        colour_map(dataset, shifted.fitted, exposure, "cts", "Cook-Torrance with shift"),
    ]
    others = [fit for fit in analysis.models if fit.distribution and fit not in (plain, shifted)]
    pictures += [colour_map(dataset, fit.fitted, exposure, fit.model, MODEL_NAMES[fit.model]) for fit in others]
    shown = {
        name: ("absolute", MODEL_NAMES[name]) if name in _OF_BRIGHTNESS else ("chromatic", f"{MODEL_NAMES[name]}, hue")
        for name in analysis.differences
    }
    values = {name: getattr(analysis.differences[name], kind) for name, (kind, _) in shown.items()}
    known = [v[np.isfinite(v)] for v in values.values()]
    largest = max([1.0, *(float(np.percentile(v, 99)) for v in known if v.size)])
    maps = [
        difference_map(
            dataset,
            values[name],
            largest,
            f"difference-{name}",
            f"{title}: mean {_difference(analysis.differences[name].statistics(kind)['mean'])}",
        )
        for name, (kind, title) in shown.items()
    ]
    return (
        "<h2>What the models say</h2>"
        "<p>Cook-Torrance describes a rough surface as tiny mirrors that point in all directions around the normal. "
        f"One number, the roughness alpha, says how widely{_lobe(shifted)}. With shift, the same model is multiplied "
        "by the straight line of the chapter above, whose slope is h cos(w θm). The metal of all models but the "
        f"dielectrics is <code>{escape(analysis.conductor.name)}</code> of refractiveindex.info.</p>"
        + _difference_table(analysis)
        + _verdict_table(analysis)
        + _parameter_table(analysis)
        + _error_table(analysis)
        + f"<h3>Fits beside the {named.result}</h3>"
        + figure(pictures, "Colours as in the first picture, with the same exposure.", "three")
        + _albedo_figure(analysis)
        + "<h3>How far off the fits are</h3>"
        + f'<div class="scale">{difference_scale(largest, "scale")}</div>'
        + figure(
            maps,
            f"Colour difference CIEDE2000 between fit and {named.result}, cell by cell, all on one scale. The local "
            "and global fits describe the hue only and are compared after dividing both spectra by their value at "
            f"{analysis.local.lambda_n:g} nm; the Cook-Torrance fits are compared as they are.",
        )
    )


def _difference(value: float) -> str:
    """A colour difference, of which there is none where every spectrum has a gap."""
    return f"{value:.2f}" if np.isfinite(value) else "not known"


def _lobe(fit: ModelFit) -> str:
    """How wide the lobe is, unless the data do not tell."""
    if "alpha" in fit.verdict.undetermined or fit.distribution is None:
        return ""
    width = lobe_width(fit.value("alpha"), fit.distribution)
    return f": here the lobe is {width:.2g}° wide (full width at half maximum)"


def _difference_table(analysis: SampleAnalysis) -> str:
    means = {n: [d.statistics(k)["mean"] for k in ("absolute", "chromatic")] for n, d in analysis.differences.items()}
    rows = []
    named = words(analysis.dataset)
    of_brightness = [name for name in means if name in _OF_BRIGHTNESS]
    for name in [*of_brightness, *(name for name in reversed(means) if name not in of_brightness)]:
        statistics = analysis.differences[name].statistics("absolute")
        cells = [*means[name], statistics["median"], statistics["p95"], statistics["max"]]
        # the local fit and the global model take their brightness from the measurement
        best = np.isfinite(means[name][0]) and name == min(of_brightness, key=lambda n: means[n][0])
        rows.append(
            f"<tr{' class=best' if best else ''}><td>{MODEL_NAMES[name]}</td>"
            + "".join(f'<td class="number">{_difference(value)}</td>' for value in cells)
            + "</tr>"
        )
    counts = [analysis.differences["cook-torrance"].statistics(kind)["count"] for kind in ("absolute", "chromatic")]
    head = "".join(f'<th class="number">{t}</th>' for t in ("mean", "mean, hue only", "median", "95 %", "largest"))
    return (
        f"<h3>Mean colour difference to the {named.result}</h3>"
        f'<div class="wide"><table><thead><tr><th>model</th>{head}</tr></thead><tbody>{"".join(rows)}</tbody>'
        f"<caption>CIEDE2000 over {counts[0]} {named.done} directions; 1 is just noticeable. Values compare "
        "cos(θ in) × BRDF under D65, white being 1; “hue only” compares spectra divided by their value at "
        f"{analysis.local.lambda_n:g} nm, where they stand clear of their noise ({counts[1]} directions). The global "
        f"model and the local fit take their brightness from the {named.result}, so only their hue is a test.</caption>"
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
            unit = "" if parameter.unit == "1" else f" {_UNIT[parameter.unit]}"
            if parameter.name in fit.verdict.undetermined:
                value = "not determined"
            elif fit.verdict.trusted:
                value = with_uncertainty(parameter.value, parameter.standard_error) + escape(unit)
            else:
                value = roughly(parameter.value) + escape(unit)
            rows.append(
                f"<tr>{first}<td><code>{escape(parameter.name)}</code></td>"
                f'<td class="number">{value}</td><td>{_MEANING.get(parameter.name, "")}</td></tr>'
            )
            first = ""
    return (
        "<h3>Parameters</h3>"
        '<div class="wide"><table><thead><tr><th>model</th><th>parameter</th><th class="number">value</th>'
        f"<th>meaning</th></tr></thead><tbody>{''.join(rows)}</tbody>"
        "<caption>In brackets: standard uncertainty (coverage factor 1) of the last digits, propagated from all errors "
        "of the data, each shared by those points and wavelengths that share it. A value with ≈ belongs to a "
        "fit that is not to be trusted; “not determined” is what the data do not tell.</caption></table></div>"
    )


def _verdict_table(analysis: SampleAnalysis) -> str:
    """What speaks for each model: its fit, and what it gains over the simpler one."""
    rows = []
    for fit in analysis.models:
        gains = ["–", "–", "–"]
        if fit.comparison is not None:
            gained = fit.comparison
            gains = [MODEL_NAMES[gained.simpler], f"{gained.bic:.0f}", _difference(gained.dE00)]
        cells = [f"{fit.r2:.4f}", *(gain.replace("-", "−") for gain in gains[1:])]
        how = fit.cost if fit.distribution is None else f"{fit.cost}; {fit.distribution}"
        rows.append(
            f'<tr><td>{MODEL_NAMES[fit.model]}<br><span class="soft">{escape(how)}; {fit.engine}</span></td>'
            f"<td>{'yes' if fit.verdict.trusted else '⚠ no'}</td>"
            f'<td class="number">{cells[0]}</td><td>{gains[0]}</td>'
            + "".join(f'<td class="number">{cell}</td>' for cell in cells[1:])
            + "</tr>"
        )
    return (
        "<h3>What speaks for each model</h3>"
        '<div class="wide"><table><thead><tr><th>model, cost, engine</th><th>trusted</th><th class="number">r²</th>'
        '<th>against the simpler</th><th class="number">BIC falls by</th><th class="number">mean dE00 falls by</th>'
        f"</tr></thead><tbody>{''.join(rows)}</tbody>"
        "<caption>r² of ln(1 + cos(θ in) × BRDF), for models of the slopes that of the slopes. A model with more "
        "parameters has to earn them: by more than 10 in the Bayesian information criterion, in which residuals that "
        "repeat their neighbours count as few. The banners at the top say why a fit is not trusted.</caption>"
        "</table></div>"
    )


def _albedo_figure(analysis: SampleAnalysis) -> str:
    """The diffuse albedos of dielectrics, where such models were fitted."""
    fits = [fit for fit in analysis.models if fit.albedo is not None]
    if not fits:
        return ""
    curves = figure(
        [albedo_curves(fits, "albedo")],
        "Light that enters and comes out again in all directions, of each dielectric model. Bands: expanded "
        f"uncertainty (coverage factor {COVERAGE_FACTOR}); none where the albedo stands at zero.",
    )
    return f'<h3>Diffuse albedo</h3><div class="alone">{curves}</div>'


def _error_table(analysis: SampleAnalysis) -> str:
    """What each part of the budget gives to the standard errors of the trusted fits."""
    fits = [fit for fit in analysis.models if fit.verdict.trusted]
    found = {part for fit in fits for parameter in fit.parameters for part in parameter.error_by_part}
    parts = [part for part in PARTS_OF_FITS if part in found]
    if not parts:
        return ""
    rows = []
    for fit in fits:
        # a row of its own: beside the numbers it would make the table wider than the page
        rows.append(f'<tr><td colspan="{1 + len(parts)}"><strong>{MODEL_NAMES[fit.model]}</strong></td></tr>')
        for parameter in fit.parameters:
            largest = max(parameter.error_by_part.values(), default=0.0)
            cells = []
            for part in parts:
                error = parameter.error_by_part.get(part, 0.0)
                most = " most" if 0 < error == largest else ""
                shown = uncertainty(error) if error >= 1e-3 * parameter.standard_error else "–"
                cells.append(f'<td class="number{most}">{shown}</td>')
            unit = "" if parameter.unit == "1" else f" in {_UNIT[parameter.unit]}"
            rows.append(f"<tr><td><code>{escape(parameter.name)}</code>{unit}</td>{''.join(cells)}</tr>")
    head = "".join(f'<th class="number">{part}</th>' for part in parts)
    return (
        "<h3>What the parameters' uncertainty is made of</h3>"
        f'<div class="wide"><table class="dense"><thead><tr><th>parameter</th>{head}</tr></thead>'
        f"<tbody>{''.join(rows)}</tbody>"
        "<caption>Standard uncertainty (coverage factor 1) that each part of the budget gives to a parameter, in the "
        "parameter's unit; the root of the sum of their squares stands in brackets above. Bold: the largest; –: below "
        "a thousandth of the whole.</caption></table></div>"
    )
