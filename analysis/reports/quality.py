"""The chapters of a report that say how good the measurement is: warnings, checks, flags, uncertainty budget."""

from html import escape

import numpy as np

from analysis.figures.budget import budget_panels, budget_table, panels_in_words
from analysis.figures.page import bullets, figure
from analysis.wording import words
from drivers.arrays import BoolArray
from goniometer.datasets.angular import SAME_INCIDENCE, incidence_groups
from goniometer.datasets.budget import USUAL_INCIDENT, USUAL_WAVELENGTH, budget, usual_direction
from goniometer.datasets.dataset import IN_FITS, MEANING, Check, Dataset, Flag
from goniometer.errors import GeometryError, InputError

_MARKS = {True: ("ok", "✓ passed"), False: ("bad", "✗ failed"), None: ("open", "? not known")}
_MOST_ROWS = 4
"""Incident angles that a row of the flags names; the colour map shows the rest."""


def warnings(dataset: Dataset) -> str:
    """Banners of what a reader must know before any number: an overridden certificate, failed checks."""
    banners = []
    override = dataset.lineage.get("certificate_override")
    if override:
        banners.append(
            f'<div class="verdict warn"><strong>⚠ The certificate of the reference was overridden</strong>'
            f"{bullets([str(override)])}</div>"
        )
    failed = [check for check in dataset.checks if check.passed is False]
    if failed:
        names = ", ".join(escape(check.name) for check in failed)
        banners.append(
            f'<div class="verdict warn"><strong>⚠ A check of this {words(dataset).result} failed: {names}</strong>'
            f"{bullets([check.message for check in failed])}</div>"
        )
    return "\n".join(banners)


def quality_chapter(dataset: Dataset, too_noisy: str) -> str:
    """All checks and all flags of a dataset, and a sentence on points that missed the wanted signal-to-noise ratio."""
    return (
        "<h2>Quality</h2>"
        "<p>Every dataset is asked the same questions. A failed one is a reason to look before the numbers are used; "
        "a flagged direction is kept in every picture and file, and the table says what the fits do with it.</p>"
        + _checks(dataset.checks)
        + _flags(dataset)
        + (f"<p>{escape(too_noisy)}</p>" if too_noisy else "")
    )


def _checks(checks: tuple[Check, ...]) -> str:
    rows = []
    for check in checks:
        kind, words = _MARKS[check.passed]
        rows.append(
            f'<tr><td class="mark {kind}">{words}</td><td>{escape(check.name)}</td>'
            f"<td>{escape(check.message)}</td></tr>"
        )
    if not rows:
        return "<p>Nobody has asked this dataset yet: it carries no checks.</p>"
    return (
        '<div class="wide"><table><thead><tr><th>result</th><th>check</th><th>what was found</th></tr></thead>'
        f"<tbody>{''.join(rows)}</tbody></table></div>"
    )


def _flags(dataset: Dataset) -> str:
    rows = []
    for flag in Flag:
        marked = dataset.flagged(flag)
        if marked.any():
            rows.append(
                f"<tr><td>{MEANING[flag]}</td>"
                f'<td class="number">{int(marked.sum())} of {marked.size}</td><td>{_where(dataset, marked)}</td>'
                f"<td>{IN_FITS[flag]}</td></tr>"
            )
    if not rows:
        return "<p>No direction is flagged.</p>"
    return (
        '<h3>Flagged directions</h3><div class="wide"><table><thead><tr><th>flag</th><th class="number">directions</th>'
        f"<th>where</th><th>in the fits</th></tr></thead><tbody>{''.join(rows)}</tbody>"
        "<caption>In the colour map these cells have a dashed outline.</caption></table></div>"
    )


def _where(dataset: Dataset, marked: BoolArray) -> str:
    """The marked directions: how many at which incident angle, and between which reflected angles."""
    groups = incidence_groups(dataset.theta_in, SAME_INCIDENCE)
    lines = []
    for group in np.unique(groups[marked]):
        members = marked & (groups == group)
        low, high = dataset.theta_out[members].min(), dataset.theta_out[members].max()
        span = f"{low:.1f}°" if members.sum() == 1 else f"{low:.1f}° to {high:.1f}° ({members.sum()})"
        lines.append(f"θ in {dataset.theta_in[members].mean():.0f}°: θ out {span}".replace("-", "−"))
    more = len(lines) - _MOST_ROWS
    shown = lines[:_MOST_ROWS] + ([f"and at {more} more incident angles"] if more > 0 else [])
    return "<br>".join(shown)


def budget_chapter(dataset: Dataset) -> str:
    """What the uncertainty of one value is made of, in the `usual_direction`."""
    theta_in, theta_out = usual_direction(dataset)
    title = "<h2>Uncertainty budget</h2>"
    try:
        found = budget(dataset, theta_in, theta_out, USUAL_WAVELENGTH)
    except (GeometryError, InputError) as fault:
        return f"{title}<p>There is none for the usual direction: {escape(str(fault))}.</p>"
    return (
        f"{title}<p>What makes one value uncertain, as near as was {words(dataset).done} to the mirror direction "
        f"at the incident angle nearest {USUAL_INCIDENT:g}°, and at the wavelength nearest {USUAL_WAVELENGTH:g} nm.</p>"
        + budget_table(found)
        + figure(budget_panels(dataset, theta_in, theta_out), panels_in_words(dataset))
    )
