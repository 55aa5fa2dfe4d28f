"""The uncertainty budget of a dataset as figures: what it consists of over wavelength, and over the reflected angle."""

from html import escape
from typing import TYPE_CHECKING

import numpy as np

from analysis.figures.notation import superscript, uncertainty, with_uncertainty
from analysis.figures.page import figure, titled_page
from analysis.figures.svg import INK, new_axes, style, to_svg
from analysis.wording import words
from drivers.arrays import FloatArray
from goniometer.datasets.angular import SAME_PLANNED_INCIDENCE
from goniometer.datasets.budget import (
    COVERAGE,
    COVERAGE_FACTOR,
    USUAL_WAVELENGTH,
    Budget,
    by_part,
    nearest_point,
    nearest_wavelength,
)
from goniometer.datasets.dataset import Dataset
from goniometer.datasets.sector import is_hidden
from goniometer.geometry import BLOCKED_HALF_WIDTH

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LOOKS: dict[str, tuple[str, str, str]] = {
    "random": ("#3a7bd5", "", "-"),
    "dark": ("#7a848c", "....", ":"),
    "reference": ("#c9772b", "", "-"),
    "non-linearity": ("#9a7f00", "\\\\\\\\", "--"),
    "angle": ("#b0559f", "", "-"),
    "wavelength": ("#1f8f80", "////", "--"),
    "drift": ("#8b64d6", "", "-."),
    "aperture": ("#d0484f", "xxxx", "-."),
    "stray light": ("#4f8f2f", "", "--"),
    "footprint": ("#8c6d5a", "----", ":"),
}
"""Colour, hatch of the area and dashes of the line of every part of a budget. Neighbours differ in more than hue, for
eyes that see no difference between some of these."""

_PANELS = (
    "Areas: what the variance consists of, wavelength by wavelength. Lines: relative standard uncertainty (coverage "
    "factor 1) over the reflected angle; dots are {done} directions{blocked}."
)


def panels_in_words(dataset: Dataset) -> str:
    """What the panels show."""
    blocked = "" if dataset.simulated else ", grey is blocked by the detector"
    return _PANELS.format(done=words(dataset).done, blocked=blocked)


SMALLEST_SHARE = 0.005
"""Of the variance: parts that stay below it at all wavelengths have no area of their own."""

_DECADES = 4.0
"""Shown below the largest relative uncertainty."""


def budget_panels(
    dataset: Dataset, theta_in: float, theta_out: float, wavelength: float = USUAL_WAVELENGTH
) -> list[str]:
    """Two SVG panels: shares of the variance over wavelength, and relative uncertainties over theta_out.

    The first is drawn for the point nearest to a direction (degrees), the second at its incident angle for the
    wavelength nearest to `wavelength`, nm. Raises `GeometryError` and `InputError` as
    `goniometer.datasets.budget.budget`.
    """
    point = nearest_point(dataset, theta_in, theta_out)
    column = nearest_wavelength(dataset, wavelength)
    parts = by_part(dataset)
    return [_shares(dataset, parts, point), _over_angle(dataset, parts, point, column)]


def _shares(dataset: Dataset, parts: dict[str, FloatArray], point: int) -> str:
    """Stacked shares of the variance over wavelength at one point."""
    variances = {part: u[point] ** 2 for part, u in parts.items()}
    known = np.isfinite(dataset.brdf[point])
    total = np.where(known, sum(variances.values()), np.nan)
    shares = {part: variance / total for part, variance in variances.items()}
    large = {part: share for part, share in shares.items() if np.nanmax(share) >= SMALLEST_SHARE}
    theta_in, theta_out = float(dataset.theta_in[point]), float(dataset.theta_out[point])
    with style():
        figure, axes = new_axes(430, 290, left=46, right=112)
        bottom = np.zeros(dataset.wavelengths.size)
        for part, share in large.items():
            colour, hatch, _ = LOOKS[part]
            axes.fill_between(
                dataset.wavelengths, 100 * bottom, 100 * (bottom + share),
                facecolor=colour, edgecolor=INK, hatch=hatch, linewidth=0.4, label=part,
            )  # fmt: skip
            bottom = bottom + share
        axes.set(xlim=(dataset.wavelengths[0], dataset.wavelengths[-1]), ylim=(0, 100))
        axes.set(xlabel="wavelength / nm", ylabel="share of the variance / %")
        axes.set_title(_direction(theta_in, theta_out))
        _legend(axes, [part for part in parts if part not in large])
        words = f"shares of the variance over wavelength at incident {theta_in:.1f}, reflected {theta_out:.1f} degrees"
        return to_svg(figure, "budget-shares", words)


def _over_angle(dataset: Dataset, parts: dict[str, FloatArray], point: int, column: int) -> str:
    """Relative standard uncertainty of every part over theta_out at the incident angle of a point."""
    row = np.flatnonzero(
        (np.abs(dataset.theta_in - dataset.theta_in[point]) < SAME_PLANNED_INCIDENCE)
        & np.isfinite(dataset.brdf[:, column])
        & (dataset.brdf[:, column] > 0)
    )
    row = row[np.argsort(dataset.theta_out[row])]
    theta_in, wavelength = float(dataset.theta_in[point]), float(dataset.wavelengths[column])
    theta_out, brdf = dataset.theta_out[row], dataset.brdf[row, column]
    blocked = is_hidden(dataset, theta_in)
    gap = int(np.searchsorted(theta_out, -theta_in))

    def broken(values: FloatArray) -> FloatArray:
        """The lines break in the blocked directions."""
        return np.insert(values, gap, np.nan) if blocked else values

    total = 100 * dataset.u[row, column] / brdf
    top = float(np.nanmax(total, initial=1e-3))
    with style():
        figure, axes = new_axes(430, 290, left=56, right=112)
        if blocked:
            sector = -theta_in - BLOCKED_HALF_WIDTH, -theta_in + BLOCKED_HALF_WIDTH
            axes.axvspan(*sector, color=INK, alpha=0.1, linewidth=0)
        for part, u in parts.items():
            colour, _, dashes = LOOKS[part]
            relative = 100 * np.where(u[row, column] > 0, u[row, column], np.nan) / brdf
            axes.plot(
                broken(theta_out), broken(relative),
                color=colour, linestyle=dashes, linewidth=1.5, label=part,
            )  # fmt: skip
        axes.plot(
            broken(theta_out), broken(total),
            color=INK, linewidth=2, marker="o", markersize=3.4, label="combined",
        )  # fmt: skip
        axes.set(yscale="log", xlim=(-90, 90), ylim=(top * 1.6 / 10**_DECADES, top * 1.6), xticks=range(-90, 91, 30))
        axes.set(xlabel="reflected angle θ out / °", ylabel="relative standard uncertainty (k = 1) / %")
        axes.set_title(f"θ in = {theta_in:.1f}°, {wavelength:.0f} nm")
        axes.yaxis.set_major_formatter(_decade)
        axes.yaxis.set_minor_formatter(lambda _value, _: "")
        axes.grid(True)
        _legend(axes, [])
        words = f"relative uncertainty of every part over the reflected angle at incident {theta_in:.1f} degrees"
        return to_svg(figure, "budget-angles", words)


def _decade(value: float, _position: object) -> str:
    """Tick of a logarithmic axis in per cent."""
    power = round(np.log10(value))
    return f"{value:g}" if power >= -2 else f"10{superscript(power)}"


def _legend(axes: "Axes", negligible: list[str]) -> None:
    """A legend beside the axes, top to bottom as areas are stacked, with what is too small to be seen."""
    handles, labels = axes.get_legend_handles_labels()
    axes.legend(
        handles[::-1], labels[::-1], loc="upper left", bbox_to_anchor=(1.02, 1.02),
        frameon=False, handlelength=1.8, borderaxespad=0,
    )  # fmt: skip
    if negligible:
        text = f"below {100 * SMALLEST_SHARE:g} %:\n" + "\n".join(negligible)
        axes.text(1.03, 0.0, text, transform=axes.transAxes, va="bottom", fontsize=8)


def _direction(theta_in: float, theta_out: float) -> str:
    return f"θ in = {theta_in:.1f}°, θ out = {theta_out:.1f}°".replace("-", "−")


def budget_page(found: Budget, panels: list[str], caption: str) -> str:
    """An HTML page of its own with a budget as a table and its panels above their caption."""
    return titled_page(f"{found.sample}: uncertainty budget", [budget_table(found), figure(panels, caption)])


def budget_table(found: Budget) -> str:
    """A budget as an HTML table: every part, its sources beneath, and the combined and the expanded uncertainty."""
    rows = []
    for part in found.parts:
        single = part.sources[0].shared if len(part.sources) == 1 else ""
        rows.append(_row(f"<strong>{escape(part.name)}</strong>", part.u, part.relative, part.share, single))
        rows += [
            _row(
                f'<span class="soft">{escape(s.name.removeprefix(f"{part.name}: "))}</span>',
                s.u,
                s.relative,
                s.share,
                s.shared,
            )
            for s in part.sources
            if not single
        ]
    rows.append(_row("<strong>combined, k = 1</strong>", found.u, found.u / found.brdf, 1.0, ""))
    rows.append(
        _row(f"<strong>expanded, k = {COVERAGE_FACTOR}</strong>", found.expanded, found.expanded / found.brdf, None, "")
    )
    head = "".join(
        f'<th class="number">{name}</th>' for name in ("standard uncertainty / (1/sr)", "relative", "of variance")
    )
    return (
        f'<div class="wide"><table><thead><tr><th>source of error</th>{head}<th>the same for</th></tr></thead>'
        f"<tbody>{''.join(rows)}</tbody><caption>{_direction(found.theta_in, found.theta_out)}, "
        f"{found.wavelength:.1f} nm: BRDF = {with_uncertainty(found.brdf, found.u)} 1/sr (k = 1); expanded uncertainty "
        f"± {uncertainty(found.expanded)} 1/sr (k = {COVERAGE_FACTOR}: {COVERAGE}).</caption></table></div>"
    )


def relative_in_words(relative: float) -> str:
    """Size of a relative uncertainty in per cent, two digits."""
    return f"{100 * abs(relative):.2g} %" if abs(relative) >= 1e-4 else "< 0.01 %"


def share_in_words(share: float) -> str:
    """A share of the variance in per cent."""
    return f"{100 * share:.1f} %" if share >= 0.0005 else "< 0.1 %"


def _row(name: str, u: float, relative: float, share: float | None, shared: str) -> str:
    of_variance = "" if share is None else escape(share_in_words(share))
    numbers = (uncertainty(abs(u)), escape(relative_in_words(relative)), of_variance)
    cells = "".join(f'<td class="number">{number}</td>' for number in numbers)
    return f'<tr><td>{name}</td>{cells}<td class="soft">{shared}</td></tr>'
