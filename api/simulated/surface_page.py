"""The page of `goniometer simulate surface`."""

from html import escape

from analysis.figures.page import bullets, figure
from analysis.figures.topographies import (
    autocorrelation_figure,
    height_histogram,
    perspective,
    slope_distribution,
    top_view,
)
from api.simulated.surface_facts import Described, how_made, remark, shown
from simulators.topographies.heights import FALLEN_TO, autocorrelation, slopes

_OVERVIEW = 252.0
"""Width of a figure, points, where four stand side by side."""


def title(found: list[Described]) -> str:
    """Title of the page."""
    return f"Topography of {found[0].surface.name}" if len(found) == 1 else f"Topographies of {len(found)} surfaces"


def one_surface(found: Described) -> list[str]:
    """Pieces of HTML on one surface: roughness, views, distributions."""
    surface = found.surface
    heights, pitch = surface.field.heights_um, surface.field.pitch_um
    rows = [
        [
            row.symbol,
            shown(row.value, row.unit),
            "" if row.paper is None else shown(row.paper, row.unit),
            _percent(row.at_twice_the_pitch, "+"),
            _percent(row.relative_error),
            row.meaning,
        ]
        for row in found.parameters.values()
    ]
    spike = " The spike is the polished surface that no bead met." if "dents" in surface.origin else ""
    return [
        bullets([*how_made(surface), remark(found)]),
        _table(
            ["", "value", "paper", "at twice the pitch", "standard error of the patch", "meaning"], rows, words=(5,)
        ),
        figure(
            [top_view(heights, pitch, "top"), perspective(heights, pitch, "side")],
            "The surface from above, its colours from the 0.1 to the 99.9 per cent quantile of the heights, and from "
            "the side, lit from the left, with stretched heights (compare the paper's Fig. 2).",
        ),
        figure(
            [
                height_histogram(heights, "heights"),
                slope_distribution(slopes(surface.field).reshape(-1, 2), "slopes"),
                autocorrelation_figure(
                    autocorrelation(surface.field), pitch, found.parameters["sal_um"].value, FALLEN_TO, "correlation"
                ),
            ],
            "How heights and slopes are distributed, beside normal distributions of the same rms; the slopes are those "
            f"of the triangles that rays meet.{spike} Last, how far heights resemble those a lag away; the circle is "
            "Sal.",
            "three",
        ),
    ]


def several_surfaces(found: list[Described]) -> list[str]:
    """Pieces of HTML that show surfaces side by side, as the paper's Fig. 2 does."""
    above, aside = (
        [
            draw(s.surface.field.heights_um, s.surface.field.pitch_um, f"{kind}{i}", s.surface.name, _OVERVIEW)
            for i, s in enumerate(found)
        ]
        for kind, draw in (("top", top_view), ("side", perspective))
    )
    rows = [
        [one.surface.name]
        + [
            text
            for row in one.parameters.values()
            for text in (
                shown(row.value, row.unit),
                *([] if row.symbol in _NEVER_IN_PAPER else ["" if row.paper is None else shown(row.paper, row.unit)]),
            )
        ]
        + [_percent(max((row.at_twice_the_pitch for row in one.parameters.values()), key=abs), "+")]
        for one in found
    ]
    heads = ["surface"]
    for row in found[0].parameters.values():
        heads += [row.symbol] if row.symbol in _NEVER_IN_PAPER else [row.symbol, "paper"]
    meanings = [f"{row.symbol}: {row.meaning}." for row in found[0].parameters.values()]
    return [
        figure(
            above,
            "Heights from above. x and y in µm, the colour bars in µm, each from the 0.1 to the 99.9 per cent quantile "
            "of the heights (compare the paper's Fig. 2).",
            "four",
        ),
        figure(aside, "The same from the side. Heights are stretched as each figure says.", "four"),
        "<h2>Roughness</h2>",
        _table([*heads, "most that changes at twice the pitch"], rows),
        bullets(meanings),
        "<h2>Where they come from</h2>",
        bullets([f"{one.surface.name}: {' '.join(how_made(one.surface))} {remark(one)}" for one in found]),
    ]


_NEVER_IN_PAPER = ("Sdq", "Sal")


def _percent(value: float, sign: str = "") -> str:
    return f"{100 * value:{sign}.1f} %".replace("-", "−")


def _table(heads: list[str], rows: list[list[str]], words: tuple[int, ...] = ()) -> str:
    """A table of text; the first column and `words` stand to the left, the others to the right."""

    def cells(tag: str, texts: list[str]) -> str:
        style = ["" if i == 0 or i in words else ' class="number"' for i in range(len(texts))]
        return "".join(f"<{tag}{s}>{escape(text)}</{tag}>" for s, text in zip(style, texts, strict=True))

    body = "".join(f"<tr>{cells('td', row)}</tr>" for row in rows)
    return f'<div class="wide"><table><thead><tr>{cells("th", heads)}</tr></thead><tbody>{body}</tbody></table></div>'
