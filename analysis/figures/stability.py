"""The map of where fits converge and whether they say when they do not, as one picture."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from analysis.figures.svg import INK, Cell, hex_colour, new_axes, style, to_svg

_RIGHT = (0.16, 0.47, 0.78)
_WRONG = (0.87, 0.56, 0.18)
_UNKNOWN = "#80808040"
_ROW, _COLUMN, _LEFT, _TOP = 15.0, 58.0, 250.0, 104.0
_RIGHT_MARGIN = 30.0
"""Points; the last name leans over it."""

_DARK, _LIGHT = "#111111", "#ffffff"


@dataclass(frozen=True)
class MapCell:
    """One level of a regime with one method."""

    right: float
    """Share that came out right; NaN where nothing has a truth."""
    trusted: float
    """Share with a good verdict."""
    silent: int
    """How many failed without a word."""
    tooltip: str


def stability_map(
    rows: Sequence[tuple[str, str]], columns: Sequence[str], found: dict[tuple[str, str, str], MapCell], name: str
) -> str:
    """Regimes and their levels down, methods across; `found` by regime, level and method.

    A cell says which share came out right, and after the stroke which share of the verdicts is good; its colour goes
    from orange (none right) over pale to blue (all right). Grey is what has no truth. A cross in a frame marks failures
    that nothing said. `name` is unique in a page.
    """
    height = _TOP + _ROW * len(rows) + 8
    width = _LEFT + _COLUMN * len(columns) + _RIGHT_MARGIN
    cells = []
    with style():
        figure, axes = new_axes(width, height, left=_LEFT, right=_RIGHT_MARGIN, bottom=8, top=_TOP)
        axes.set(xlim=(0, len(columns)), ylim=(len(rows), 0))
        axes.axis("off")
        for i, column in enumerate(columns):
            axes.text(i + 0.35, -0.5, column, rotation=45, ha="left", va="bottom", rotation_mode="anchor")
        for j, (regime, level) in enumerate(rows):
            first = j == 0 or rows[j - 1][0] != regime
            if first:
                axes.plot([-_LEFT / _COLUMN, len(columns)], [j, j], color=INK, linewidth=0.5, alpha=0.5, clip_on=False)
                axes.text(-_LEFT / _COLUMN + 0.05, j + 0.5, regime, ha="left", va="center", fontweight="bold")
            axes.text(-0.1, j + 0.5, level, ha="right", va="center", fontsize=8)
            for i, column in enumerate(columns):
                cell = found.get((regime, level, column))
                if cell is None:
                    continue
                fill, ink = _colours(cell.right)
                cells.append(Cell(i + 0.02, i + 0.98, j + 0.95, j + 0.05, fill, cell.tooltip))
                shown = "–" if math.isnan(cell.right) else f"{100 * cell.right:.0f}"
                text = f"{shown} / {100 * cell.trusted:.0f}"
                marked = f"✕{cell.silent}  {text}" if cell.silent else text
                axes.text(i + 0.5, j + 0.52, marked, ha="center", va="center", color=ink, fontsize=7.5)
                if cell.silent:
                    axes.plot(
                        [i + 0.03, i + 0.97, i + 0.97, i + 0.03, i + 0.03],
                        [j + 0.08, j + 0.08, j + 0.92, j + 0.92, j + 0.08],
                        color=INK,
                        linewidth=1.6,
                    )
        return to_svg(figure, name, f"Map of {len(rows)} difficulties and {len(columns)} methods", (axes, cells))


def _colours(right: float) -> tuple[str, str]:
    """CSS colours of a cell and of what is written on it."""
    if math.isnan(right):
        return _UNKNOWN, INK
    end, share = (_RIGHT, 2 * right - 1) if right >= 0.5 else (_WRONG, 1 - 2 * right)
    mixed = [0.95 + share * (channel - 0.95) for channel in end]
    luminance = 0.2126 * mixed[0] + 0.7152 * mixed[1] + 0.0722 * mixed[2]
    return hex_colour(mixed), _LIGHT if luminance < 0.5 else _DARK
