"""Figures as SVG text that stands in a page: ink follows the page's text colour, nothing else is assumed.

Drawn with matplotlib's object interface. All ink is one sentinel colour that becomes `currentColor`, the
background is transparent, text stays text in the page's own font, ids are made unique, and what is drawn
cell by cell is written here directly, with a `<title>` that a browser shows as a tooltip.
"""

import io
import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.typing import RcKeyType

INK = "#010203"
"""The sentinel that becomes `currentColor`."""

SEQUENCE = ("#3a7bd5", "#7d6fd0", "#a862bd", "#c4558f", "#c95a5a", "#b8692a", "#94790f")
"""Anchors of the line colours: told apart by blue against yellow, which colour-blind eyes keep, and all of a
luminance that stands out against a white page and against a black one."""

_CELLS = "cells-stand-here"
_TOUCHING = 1e-6  # data units
_STYLE: "dict[RcKeyType, Any]" = {
    "svg.fonttype": "none",
    "font.family": "DejaVu Sans",  # measured in the widest of the usual fonts, so that no page's font is clipped
    "font.size": 9.0,
    "axes.labelsize": 9.0,
    "axes.titlesize": 9.5,
    "xtick.labelsize": 8.5,
    "ytick.labelsize": 8.5,
    "legend.fontsize": 8.5,
    "text.color": INK,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "grid.color": INK,
    "grid.alpha": 0.14,
    "grid.linewidth": 0.6,
    "axes.linewidth": 0.7,
    "xtick.major.width": 0.7,
    "ytick.major.width": 0.7,
    "axes.unicode_minus": True,
    "hatch.linewidth": 0.6,
    "figure.dpi": 72.0,  # one SVG unit is one point
}


@dataclass(frozen=True)
class Cell:
    """A filled rectangle in data coordinates."""

    left: float
    right: float
    bottom: float
    top: float
    fill: str
    """CSS colour."""
    title: str
    """Tooltip; may be empty."""
    outlined: bool = False
    """Whether a dashed line runs around it, and around its outlined neighbours in the row."""


@contextmanager
def style() -> Iterator[None]:
    """Within it a figure is drawn; matplotlib's settings are as before afterwards."""
    from matplotlib import rc_context  # noqa: PLC0415  (takes a second)

    with rc_context(_STYLE):
        yield


def new_axes(
    width: float, height: float, *, left: float = 46, right: float = 10, bottom: float = 36, top: float = 22
) -> tuple["Figure", "Axes"]:
    """A transparent figure of `width` x `height` points with one axes inside the given margins, points."""
    from matplotlib.figure import Figure  # noqa: PLC0415

    figure = Figure(figsize=(width / 72, height / 72), facecolor="none")
    box = (left / width, bottom / height, 1 - (left + right) / width, 1 - (bottom + top) / height)
    return figure, figure.add_axes(box, facecolor="none")


def to_svg(
    figure: "Figure",
    name: str,
    label: str,
    cells: tuple["Axes", Sequence[Cell]] | None = None,
    *,
    above: bool = False,
) -> str:
    """The figure as one `<svg>` element. `name` makes its ids unique in a page, `label` is read to the blind.

    `cells` are drawn beneath the lines of their axes, or `above` them. Call it within `style`.
    """
    from matplotlib import rc_context  # noqa: PLC0415

    if cells is not None:
        cells[0].plot([], [], zorder=9.0 if above else 0.5, gid=_CELLS)
    page = io.StringIO()
    with rc_context({"svg.hashsalt": name}):
        figure.savefig(page, format="svg", metadata=dict.fromkeys(("Creator", "Date", "Format", "Type")))
    text = page.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<!--.*?-->|<style.*?</style>|<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r"font-family: [^;\"]*;? ?", "", text).replace(INK, "currentColor")
    # coordinates are fine enough with two decimals, but not how far an image is stretched; what people read is left
    text = re.sub(r"<(?!image)[^>]+>", lambda tag: re.sub(r"(\d+\.\d\d)\d+", r"\1", tag[0]), text)
    text = _unique_ids(text, name)
    if cells is not None:
        drawn = "\n".join(_rectangle(cells[0], cell, figure.bbox.height) for cell in cells[1])
        drawn += "".join(_outline(cells[0], run, figure.bbox.height) for run in _runs(cells[1]))
        text = text.replace(f'<g id="{_CELLS}"/>', f'<g shape-rendering="crispEdges">\n{drawn}\n</g>')
    view = f"0 0 {figure.bbox.width:g} {figure.bbox.height:g}"
    opening = f'<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" viewBox="{view}" '
    text = opening + f'role="img" aria-label="{escape(label)}">' + text[text.index(">") + 1 :]
    return re.sub(r"\s*\n\s*", "\n", text).strip()


def side_by_side(panels: list[str]) -> str:
    """Panels as one SVG file of their own, which is light or dark as its reader's system."""
    sizes = [tuple(map(float, re.findall(r'viewBox="0 0 (\S+) (\S+)"', panel)[0])) for panel in panels]
    width, height = sum(size[0] for size in sizes), max(size[1] for size in sizes)
    placed, left = [], 0.0
    for panel, size in zip(panels, sizes, strict=True):
        at = f'<svg x="{left:g}" y="0" width="{size[0]:g}" height="{size[1]:g}"'
        placed.append(panel.replace("<svg", at, 1))
        left += size[0]
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" '
        f'width="{width:g}" height="{height:g}" viewBox="0 0 {width:g} {height:g}" font-family="sans-serif">\n'
        "<style>:root { color-scheme: light dark; background: Canvas; color: CanvasText; }</style>\n"
        + "\n".join(placed)
        + "\n</svg>\n"
    )


def hex_colour(rgb: Iterable[float]) -> str:
    """CSS colour of three display-encoded values in [0, 1]."""
    return "#" + "".join(f"{round(255 * min(max(v, 0.0), 1.0)):02x}" for v in rgb)


def line_colours(count: int) -> list[str]:
    """`count` colours along `SEQUENCE`."""
    from matplotlib.colors import LinearSegmentedColormap  # noqa: PLC0415

    ramp = LinearSegmentedColormap.from_list("sequence", SEQUENCE)
    return [hex_colour(ramp(v)[:3]) for v in np.linspace(0, 1, max(count, 2))[:count]]


def _rectangle(axes: "Axes", cell: Cell, height: float) -> str:
    """The cell as `<rect>`."""
    # a hair wider than it is, or the page shows through between two cells
    title = f"<title>{escape(cell.title)}</title>" if cell.title else ""
    return f'<rect {_place(axes, cell, height, 0.25)} fill="{cell.fill}">{title}</rect>'


def _runs(cells: Sequence[Cell]) -> list[Cell]:
    """The outlined cells, those that touch each other in a row made one."""
    runs: list[Cell] = []
    for cell in sorted((c for c in cells if c.outlined), key=lambda c: (c.bottom, c.left)):
        if runs and runs[-1].bottom == cell.bottom and abs(runs[-1].right - cell.left) < _TOUCHING:
            runs[-1] = replace(runs[-1], right=cell.right)
        else:
            runs.append(cell)
    return runs


def _outline(axes: "Axes", cell: Cell, height: float) -> str:
    """A line just inside the cell, black dashes on white, so that it is seen on cells of any colour."""
    place = _place(axes, cell, height, 0.0, inset=0.5)
    return "".join(
        f'\n<rect {place} fill="none" pointer-events="none" stroke="{colour}" stroke-width="1"{dashes}/>'
        for colour, dashes in (("#fff", ""), ("#000", ' stroke-dasharray="2 2"'))
    )


def _place(axes: "Axes", cell: Cell, height: float, wider: float, inset: float = 0.0) -> str:
    """Attributes of a `<rect>` that tell where a cell is; SVG's y axis points down."""
    x0, y0 = axes.transData.transform((cell.left, cell.bottom))
    x1, y1 = axes.transData.transform((cell.right, cell.top))
    width, tall = max(x1 - x0 - 2 * inset, 0.1) + wider, max(y1 - y0 - 2 * inset, 0.1)
    return f'x="{x0 + inset:.2f}" y="{height - y1 + inset:.2f}" width="{width:.2f}" height="{tall:.2f}"'


def _unique_ids(text: str, name: str) -> str:
    """Keep only ids that something refers to, numbered as they come and prefixed with `name`.

    matplotlib makes ids of what is drawn, to the last bit: the same figure would differ from process to process.
    """
    referring = r'(url\(#|href="#)([^)"]+)'
    used = dict.fromkeys(each for _, each in re.findall(referring, text))
    numbers = {each: f"{name}-{i}" for i, each in enumerate(used)}

    def renamed(found: re.Match[str]) -> str:
        if found[1] == _CELLS:
            return found[0]
        return f' id="{numbers[found[1]]}"' if found[1] in numbers else ""

    text = re.sub(r' id="([^"]+)"', renamed, text)
    return re.sub(referring, lambda found: found[1] + numbers[found[2]], text)
