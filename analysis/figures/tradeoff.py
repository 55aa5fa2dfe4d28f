"""Charts of speed against accuracy: both axes logarithmic, lower left is better, the front that nothing beats drawn."""

from collections.abc import Sequence
from html import escape
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from analysis.figures.page import figure as framed
from analysis.figures.svg import INK, Cell, line_colours, new_axes, style, to_svg
from analysis.tradeoff import Chart, Choice
from drivers.arrays import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_FEW_DECADES = 2.5
"""Over which there is room for ticks between the powers of ten."""

_MARKERS = "osD^vPX"
_REACH = 6.0
"""Half of the side of the square around a mark in which pointing at it tells about it, points."""
_APART = 4.0
"""Between two names, points."""
_PLACES = ((7, 0), (-7, 0), (0, 9), (0, -9), (7, 9), (7, -9), (-7, 9), (-7, -9), (12, 18), (12, -18), (-12, 18))
"""Where a name may stand relative to its mark, points, the best first."""


def tradeoff_chapter(chart: Chart) -> str:
    """Title, chart and table of one comparison, as HTML."""
    return (
        f"<h2>{escape(chart.title)}</h2>"
        + framed(
            [tradeoff_chart(chart)],
            f"{escape(chart.caption)} Better is to the left and below. The line joins those that no other one beats in "
            "both; they are filled. Bars are quartiles of the cost. Point at a mark for its setting.",
        )
        + _table(chart)
    )


def tradeoff_chart(chart: Chart) -> str:
    """The chart as SVG."""
    shown = [(i, c) for i, c in enumerate(chart.choices) if c.cost > 0 and c.error > 0 and np.isfinite(c.error)]
    families = list(dict.fromkeys(choice.family for _, choice in shown))
    colours = dict(zip(families, line_colours(len(families)), strict=True))
    front = chart.front
    label = f"{chart.title}: {len(shown)} choices, {chart.cost.label} across, {chart.error.label} up"
    with style():
        figure, axes = new_axes(640, 400, left=58, right=16, bottom=40, top=36)
        axes.set(xscale="log", yscale="log", xlabel=chart.cost.label, ylabel=chart.error.label)
        costs = [cost for _, c in shown for cost in (c.cost_low, c.cost_high)]
        axes.set(xlim=_limits(costs, 0.12), ylim=_limits([c.error for _, c in shown], 0.08))
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_formatter(_plain)
            axis.set_minor_formatter(_plain if _decades(*axis.get_view_interval()) < _FEW_DECADES else "")
        axes.grid(visible=True)
        axes.spines[["top", "right"]].set_visible(False)
        _draw_front(axes, [chart.choices[i] for i in front if any(i == j for j, _ in shown)])
        for family, marker in zip(families, _MARKERS * len(families), strict=False):
            mine = [(i, c) for i, c in shown if c.family == family]
            for best in (True, False):
                some = [c for i, c in mine if (i in front) == best]
                axes.errorbar(
                    [c.cost for c in some],
                    [c.error for c in some],
                    xerr=[[c.cost - c.cost_low for c in some], [c.cost_high - c.cost for c in some]],
                    fmt=marker,
                    color=colours[family],
                    markerfacecolor=colours[family] if best else "none",
                    markersize=5.5,
                    elinewidth=0.8,
                )
            axes.plot([], [], marker, color=colours[family], markersize=5.5, label=family)
        if len(families) > 1:
            figure.legend(loc="upper left", ncols=len(families), frameon=False, handletextpad=0.2)
        _write_names(figure, axes, [c for _, c in shown], [c for i, c in shown if i in front])
        cells = [_told(axes, c.cost, c.error, _tooltip(chart, i)) for i, c in shown]
        return to_svg(figure, f"tradeoff-{chart.kind}", label, (axes, cells), above=True)


def _plain(value: float, _: object = None) -> str:
    """A tick as a person would write it: 0.02, 10 000; few of the minor ones have room."""
    digit = round(value / 10 ** np.floor(np.log10(value)))
    return _in_words(value) if digit in {1, 2, 5} else ""


def _in_words(value: float) -> str:
    """Three digits, or all before the point; large ones in groups."""
    if value < 1e3:
        return f"{value:.3g}"
    return f"{value:,.0f}".replace(",", "\u202f") if value >= 1e4 else f"{value:.0f}"


def _decades(low: float, high: float) -> float:
    return float(np.log10(high / low))


def _draw_front(axes: "Axes", best: Sequence[Choice]) -> None:
    axes.step([c.cost for c in best], [c.error for c in best], where="post", color=INK, linewidth=1.0, alpha=0.55)


def _limits(values: Sequence[float], beyond: float) -> tuple[float, float]:
    """Limits of a logarithmic axis, with room for names."""
    low, high = np.log10(min(values)), np.log10(max(values))
    room = max(high - low, 0.5) * beyond + 0.08
    return float(10 ** (low - room)), float(10 ** (high + room))


def _write_names(figure: "Figure", axes: "Axes", marks: Sequence[Choice], best: Sequence[Choice]) -> None:
    """Each name beside its mark, where it covers the least of other marks, names, and the line through the `best`."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: PLC0415

    renderer = FigureCanvasAgg(figure).get_renderer()  # type: ignore[no-untyped-call]
    scale = 72.0 / figure.dpi
    places = axes.transData.transform([(c.cost, c.error) for c in marks]) * scale
    ends = [axes.transData.transform([(c.cost_low, c.error), (c.cost_high, c.error)])[:, 0] * scale for c in marks]
    taken = [
        np.array([min(x - 4, low), y - 4, max(x + 4, high), y + 4])
        for (x, y), (low, high) in zip(places, ends, strict=True)
    ]
    corners = sorted(axes.transData.transform([(c.cost, c.error) for c in best]) * scale, key=lambda place: place[0])
    for (x, y), (after, below) in pairwise(corners):
        taken += [np.array([x, y - 1, after, y + 1]), np.array([after - 1, below, after + 1, y])]
    inside = np.array(axes.get_window_extent().extents) * scale
    for choice, (x, y) in zip(marks, places, strict=True):
        text = axes.annotate(
            choice.name, (choice.cost, choice.error), xytext=(0, 0), textcoords="offset points", fontsize=8
        )
        size = text.get_window_extent(renderer)
        width, height = size.width * scale, size.height * scale
        place, least = _PLACES[0], np.inf
        for dx, dy in _PLACES:
            box = _box(x + dx, y + dy, dx, width, height)
            covered = sum(_overlap(box, other) for other in taken) + 3 * (width * height - _overlap(box, inside))
            if covered < least - 1e-9:
                place, least = (dx, dy), covered
        dx, dy = place
        text.set(position=place, ha="left" if dx > 0 else "right" if dx < 0 else "center", va="center")
        left, bottom, right, top = _box(x + dx, y + dy, dx, width, height)
        taken.append(np.array([left - _APART, bottom, right + _APART, top]))


def _box(x: float, y: float, side: float, width: float, height: float) -> FloatArray:
    """[left, bottom, right, top] of a text that begins, ends or is centred at x."""
    left = x if side > 0 else x - width if side < 0 else x - width / 2
    return np.array([left, y - height / 2, left + width, y + height / 2])


def _overlap(one: FloatArray, other: FloatArray) -> float:
    """Area that two boxes share."""
    size = np.minimum(one[2:], other[2:]) - np.maximum(one[:2], other[:2])
    return float(np.prod(np.maximum(size, 0)))


def _told(axes: "Axes", cost: float, error: float, title: str) -> Cell:
    """A square around a mark that tells about it when pointed at."""
    scale = 72.0 / axes.figure.dpi
    x, y = axes.transData.transform((cost, error))
    (left, bottom), (right, top) = axes.transData.inverted().transform(
        [(x - _REACH / scale, y - _REACH / scale), (x + _REACH / scale, y + _REACH / scale)]
    )
    return Cell(left, right, bottom, top, "transparent", title)


def _tooltip(chart: Chart, index: int) -> str:
    choice = chart.choices[index]
    more = "".join(f"; {name} {value:.3g}" for name, value in choice.more.items())
    return (
        f"{choice.setting}: {chart.cost.name} {choice.cost:.3g} {chart.cost.unit}, "
        f"{chart.error.name} {choice.error:.3g} {chart.error.unit}".rstrip()
        + more
    )


def _table(chart: Chart) -> str:
    """All choices by rising cost."""
    columns = list(dict.fromkeys(name for choice in chart.choices for name in choice.more))
    head = "".join(f"<th>{escape(name)}</th>" for name in columns)
    timed = any(choice.cost_low < choice.cost_high for choice in chart.choices)
    rows = []
    for index in sorted(range(len(chart.choices)), key=lambda i: chart.choices[i].cost):
        choice = chart.choices[index]
        more = "".join(f"<td>{_number(choice.more.get(name))}</td>" for name in columns)
        rows.append(
            f"<tr><td>{'●' if index in chart.front else ''}</td><th>{escape(choice.family)}: {escape(choice.name)}</th>"
            f"<td>{escape(choice.setting)}</td><td>{_in_words(choice.cost)}</td>"
            + f"<td>{_in_words(choice.cost_low)} to {_in_words(choice.cost_high)}</td>" * timed
            + f"<td>{_in_words(choice.error)}</td>{more}</tr>"
        )
    return (
        '<div class="wide"><table><thead><tr><th>front</th><th>choice</th><th>setting</th>'
        f"<th>{escape(chart.cost.label)}</th>{'<th>quartiles</th>' * timed}<th>{escape(chart.error.label)}</th>{head}"
        f"</tr></thead>"
        f"<tbody>{''.join(rows)}</tbody></table></div>"
    )


def _number(value: float | None) -> str:
    return "" if value is None else _in_words(value)
