"""How figures show what was filled: hatched in maps, dashed or hollow in curves, and never without saying so."""

from typing import TYPE_CHECKING

import numpy as np

from analysis.figures.notation import with_uncertainty
from analysis.figures.svg import INK, Cell
from drivers.arrays import BoolArray, FloatArray
from goniometer.datasets.budget import COVERAGE_FACTOR
from goniometer.datasets.fill import Filled
from goniometer.geometry import BLOCKED_HALF_WIDTH

if TYPE_CHECKING:
    from matplotlib.axes import Axes

STEP = 0.5
"""Degrees from one filled direction to the next in the blocked sector."""

_ELSEWHERE = 2.0
"""Width of the cell of a filled direction elsewhere, degrees."""


def in_sector(filled: Filled) -> BoolArray:
    """[directions] whether the detector would block the source."""
    return np.asarray(np.abs(filled.theta_in + filled.theta_out) < BLOCKED_HALF_WIDTH)


def at_nearest(filled: Filled, wavelength: float) -> tuple[FloatArray, FloatArray]:
    """BRDF [directions] and its standard uncertainty at the wavelength nearest to one, nm, 1/sr."""
    middle = int(np.argmin(np.abs(filled.wavelengths - wavelength)))
    return filled.brdf[:, middle], filled.u[:, middle]


def filled_cells(filled: Filled, fills: list[str], rows: list[tuple[float, float]]) -> list[Cell]:
    """Cells of a map, in colours `fills` [directions] and `rows` (bottom, top; degrees); without what tells nothing."""
    f, u = at_nearest(filled, 600.0)
    half = np.where(in_sector(filled), STEP, _ELSEWHERE) / 2
    cells = []
    for i in np.flatnonzero(filled.tells).tolist():
        t_in, t_out = float(filled.theta_in[i]), float(filled.theta_out[i])
        bottom, top = min(rows, key=lambda row: abs(0.5 * (row[0] + row[1]) - t_in))
        words = (
            f"θ in {t_in:.1f}°, θ out {t_out:.1f}°; BRDF at 600 nm = {with_uncertainty(float(f[i]), float(u[i]))} "
            f"1/sr, filled by {filled.by[i]}, not measured"
        )
        cells.append(Cell(t_out - float(half[i]), t_out + float(half[i]), bottom, top, fills[i], words))
    return cells


def hatch(axes: "Axes", left: float, right: float, bottom: float, top: float, *, on_colour: bool) -> None:
    """Hatching of a place where nothing was measured, degrees; on cells of any colour black on white."""
    for ink, width in (("white", 1.8), ("black", 0.6)) if on_colour else ((INK, 0.6),):
        drawn = axes.fill_between(
            [left, right], bottom, top, facecolor="none", edgecolor=ink, hatch="/////", linewidth=0, alpha=0.55
        )
        drawn.set_hatch_linewidth(width)


def draw_filled(axes: "Axes", filled: Filled, angle: float, wavelength: float, colour: str) -> None:
    """What fills one incident angle, degrees, in a diagram over theta_out: dashed in the sector, hollow elsewhere."""
    f, u = at_nearest(filled, wavelength)
    expanded = COVERAGE_FACTOR * u
    mine = filled.tells & (np.abs(filled.theta_in - angle) < STEP) & (f > 0)
    inside = np.flatnonzero(mine & in_sector(filled))
    inside = inside[np.argsort(filled.theta_out[inside])]
    theta, low, high = filled.theta_out[inside], (f - expanded)[inside], (f + expanded)[inside]
    axes.fill_between(theta, np.maximum(low, 0.5 * f[inside]), high, color=colour, alpha=0.25, linewidth=0)
    axes.plot(theta, f[inside], color=colour, linewidth=1.2, dashes=(2, 1.5))
    other = np.flatnonzero(mine & ~in_sector(filled))
    axes.errorbar(
        filled.theta_out[other], f[other], expanded[other],
        fmt="o", color=colour, markersize=2.6, markerfacecolor="none", markeredgewidth=0.7, elinewidth=0.7,
    )  # fmt: skip


def filled_legend(axes: "Axes", filled: Filled) -> None:
    """Above the diagram, what is dashed and what is hollow, where there is any."""
    from matplotlib.lines import Line2D  # noqa: PLC0415

    inside = in_sector(filled)
    handles = []
    if (filled.tells & inside).any():
        handles.append(
            Line2D([], [], color=INK, linewidth=1.2, dashes=(2, 1.5), label="filled by interpolation, not measured")
        )
    if (filled.tells & ~inside).any():
        by = sorted({by for by, shown in zip(filled.by, filled.tells & ~inside, strict=True) if shown}, reverse=True)
        label = f"filled by {' or '.join(by)}, not measured"
        handles.append(Line2D([], [], color=INK, marker="o", markersize=3, markerfacecolor="none", ls="", label=label))
    if handles:
        legend = axes.legend(handles=handles, loc="lower left", bbox_to_anchor=(0, 1), frameon=False, borderpad=0.1)
        axes.add_artist(legend)
