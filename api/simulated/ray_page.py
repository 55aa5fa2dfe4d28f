"""The page of a scan with rays: its figures, where the energy went, and how far all of it converged."""

from html import escape

import numpy as np

from analysis.figures.page import bullets, figure
from analysis.figures.rays import halves_panel, share_panel
from goniometer.datasets.budget import COVERAGE_FACTOR
from simulators.rays.decomposition import BIN, CONVERGED, FEWEST, Change, halves, shares
from simulators.rays.scan import HIGHEST, WINDOWS, RayScan
from simulators.topographies.heights import Roughness

_PANELS = 5
"""Incident angles that Fig. 11 shows."""


def chosen(count: int, most: int) -> list[int]:
    """At most `most` of `count` places, the first and the last among them, evenly spread.

    >>> chosen(9, 5), chosen(2, 5)
    ([0, 2, 4, 6, 8], [0, 1])
    """
    return sorted({round(place) for place in np.linspace(0, count - 1, min(count, most))})


def chapters(
    scan: RayScan, changes: tuple[Change, ...], warnings: list[str], rough: Roughness, patches: int, *, periodic: bool
) -> list[str]:
    """Chapters of HTML."""
    asked = scan.asked
    nm = asked.wavelengths[asked.decomposed_at]
    lit = (
        f"{patches} {'patch' if patches == 1 else 'patches'} with Sq = {rough.sq_um:.3g} µm, Sdq = {rough.sdq:.3g}, "
        f"Sdr = {100 * rough.sdr:.3g} % and Sal = {rough.sal_um:.3g} µm (the first); {scan.traced:,} rays for each of "
        f"{asked.theta_in.size} incident angles; detector of {asked.aperture:g}° (full angle)."
    )
    how = (
        "Every triangle of the height map is a perfect mirror, and a ray is reflected until it leaves. Each reflection "
        "takes Fresnel's share of it, at all wavelengths at once. Neither diffraction nor polarisation is in it, and a "
        "facet finer than the wavelength reflects as if it were large."
    )
    edges = (
        "The patches repeat without an edge, so no ray is lost at a side."
        if periodic
        else f"The patch has edges. Light comes in so far within them that it could leave as low as {HIGHEST:g}° from "
        "the normal over its top; what still leaves through a side is lost, and the energy balance says how much."
    )
    box = f'<div class="verdict warn"><strong>Mind</strong>{bullets(warnings)}</div>' if warnings else ""
    return [
        f"<p>{escape(lit)}</p>",
        box,
        f"<p>{how}</p><p>{edges}</p>",
        f"<h2>Light by the number of reflections</h2>{_decomposition(scan, float(nm))}",
        f"<h2>Where the energy goes</h2>{_balance(scan, float(nm))}",
        f"<h2>Convergence</h2>{_convergence(scan, changes)}",
    ]


def _decomposition(scan: RayScan, nm: float) -> str:
    found, over = shares(scan), halves(scan)
    panels = [
        share_panel(float(scan.asked.theta_in[i]), found.theta_out, found.share[i], found.u_share[i], f"share-{number}")
        for number, i in enumerate(chosen(scan.asked.theta_in.size, _PANELS))
    ]
    panels.append(halves_panel(scan.asked.theta_in, over.share, over.u_share, "halves"))
    caption = (
        f"The paper's Fig. 11: of the light that reaches the detector in directions {BIN:g}° wide, how much was "
        f"reflected how often, at {nm:g} nm. Bars of error (k = {COVERAGE_FACTOR}) are those of the share reflected "
        f"once. Where fewer than {FEWEST} rays arrived nothing is shown: it is dark there. Facets that lie "
        "level shine into the mirror direction alone, and then make the single reflections there stand out. Last: the "
        f"same over the whole hemisphere, forward and back being its two halves; bands are k = {COVERAGE_FACTOR}."
    )
    return figure(panels, caption)


def _balance(scan: RayScan, nm: float) -> str:
    light = scan.light[..., scan.asked.decomposed_at].mean(axis=(0, 1))
    rows = []
    for i, theta_in in enumerate(scan.asked.theta_in):
        escaped, lost, stopped = scan.ends[i] / scan.traced
        by_order = light[i].sum(axis=1)
        values = (*by_order, escaped - by_order.sum(), lost, stopped)
        cells = "".join(f'<td class="number">{100 * value:.3f}</td>' for value in values)
        counts = " + ".join(f"{count:,}" for count in scan.ends[i])
        rows.append(f'<tr><td class="number">{theta_in:g}°</td>{cells}<td class="number">{counts}</td></tr>')
    names = ("θ in", "once", "twice", "3 times", "4 or more", "absorbed", "lost", "stopped", "rays")
    head = "".join(f'<th class="number">{name}</th>' for name in names)
    return (
        f"<p>Shares of the light that falls in, in per cent, at {nm:g} nm; each row adds up to 100. Rays are counted: "
        f"escaped + lost through a side + stopped after {scan.escaped.shape[1] - 1} reflections = {scan.traced:,}. "
        "Lost and stopped rays count whole, though facets had taken a part of them already.</p>"
        f'<div class="wide"><table><thead><tr>{head}</tr></thead><tbody>{"".join(rows)}</tbody></table></div>'
    )


def _convergence(scan: RayScan, changes: tuple[Change, ...]) -> str:
    rows = []
    for change in changes:
        unit = "%" if change.is_share else "% of it"
        value = f"{100 * change.value:.3f} ± {100 * change.u:.3f} %" if change.is_share else _brdf(change)
        steps = "".join(
            f'<td class="number">{_signed(100 * each)}</td>' for each in (change.rays, change.area, change.pitch)
        )
        good = change.largest < CONVERGED
        verdict = f'<td class="mark {"ok" if good else "bad"}">{"converged" if good else "not below 1 %"}</td>'
        rows.append(
            f'<tr><td>{escape(change.figure)}</td><td class="number">{change.theta_in:g}°</td>'
            f'<td class="number">{value}</td>{steps}<td class="mark">{unit}</td>{verdict}</tr>'
        )
    done = sum(change.largest < CONVERGED for change in changes)
    return (
        f"<p>{done} of {len(changes)} published figures change by less than {100 * CONVERGED:g} % when the rays, the "
        "area of the surface, or its points along each side are doubled to what they are here. Errors are standard "
        f"errors, from the spread between {WINDOWS**2} windows of each patch, {len(scan.by_order)} in all; they hold "
        f"the number of rays and the sample of the surface. “Around” a direction is {BIN:g}° wide.</p>"
        '<div class="wide"><table><thead><tr><th>figure</th><th class="number">θ in</th><th class="number">found</th>'
        '<th class="number">rays ×2</th><th class="number">area ×2</th><th class="number">pitch ÷2</th><th></th>'
        "<th></th></tr></thead>"
        f"<tbody>{''.join(rows)}</tbody></table></div>"
    )


def _brdf(change: Change) -> str:
    return f"{change.value:.4g} ± {change.u:.2g}"


def _signed(value: float) -> str:
    """With two decimals and a sign, unless it is zero then."""
    text = f"{value:+.2f}".replace("-", "−")
    return text if text[1:] != "0.00" else "0"
