"""Charts of series of photographs over the angle of the light, and photographs as pictures that stand in a page."""

import base64
import io
from collections.abc import Sequence
from html import escape
from math import ceil
from typing import TYPE_CHECKING

import numpy as np

from analysis.colour import display_encoded
from analysis.figures.svg import INK, Cell, hex_colour, line_colours, new_axes, style, to_svg
from analysis.photo_statistics import PhotoStatistics, as_srgb
from drivers.arrays import FloatArray
from goniometer.datasets.budget import COVERAGE_FACTOR
from goniometer.photographs.photos import Photo, PhotoSeries

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

BRIGHTNESS = 0.25
"""Luminance that the mean of an inset has on the display; pictures of speckle need room above it."""

REDNESS_LIMITS = (0.5, 2.0)
"""Of the chart of red over blue; what lies beyond is drawn at its edge."""

_ACROSS = 3
"""Entries of a legend side by side."""

_REDDISH, _BLUISH = "#c95a5a", "#3a7bd5"


def redness_chart(series: Sequence[PhotoSeries], found: Sequence[Sequence[PhotoStatistics]], name: str) -> str:
    """Red over blue over the angle of the light, one line a series with its expanded uncertainty as bars."""
    with style():
        figure, axes = _chart(series)
        low, high = REDNESS_LIMITS
        axes.axhspan(1, high, color=_REDDISH, alpha=0.10, linewidth=0)
        axes.axhspan(low, 1, color=_BLUISH, alpha=0.10, linewidth=0)
        axes.axhline(1, color=INK, linewidth=0.8)
        _mark_directions(axes, series)
        for one, statistics, colour in zip(series, found, line_colours(len(series)), strict=True):
            usable = [s for s in statistics if not s.overexposed and np.isfinite(s.red_over_blue)]
            angles = [s.angle for s in usable]
            ratio = np.array([s.red_over_blue for s in usable])
            bars = COVERAGE_FACTOR * np.array([s.u_red_over_blue for s in usable])
            axes.errorbar(
                angles, np.clip(ratio, low, high), yerr=bars, color=colour, linewidth=1.2, elinewidth=0.7, marker="o",
                markersize=3, label=one.sample, clip_on=True,
            )  # fmt: skip
        axes.set_yscale("log")
        axes.set(ylim=REDNESS_LIMITS, xlim=(-90, 90), xlabel="angle of the light, degrees", ylabel="red over blue")
        axes.set_yticks([0.5, 0.7, 1, 1.4, 2], ["0.5", "0.7", "1", "1.4", "2"])
        axes.minorticks_off()
        axes.set_xticks(range(-90, 91, 30))
        axes.text(0.015, 0.97, "reddish", transform=axes.transAxes, va="top", color=_REDDISH)
        axes.text(0.015, 0.03, "bluish", transform=axes.transAxes, va="bottom", color=_BLUISH)
        axes.grid(visible=True, axis="x")
        axes.spines[["top", "right"]].set_visible(False)
        _legend(axes, series)
        return to_svg(figure, name, "Red over blue over the angle of the light, one line a series")


def contrast_chart(series: Sequence[PhotoSeries], found: Sequence[Sequence[PhotoStatistics]], name: str) -> str:
    """Speckle contrast of the luminance over the angle of the light, one line a series."""
    with style():
        figure, axes = _chart(series)
        _mark_directions(axes, series)
        for one, statistics, colour in zip(series, found, line_colours(len(series)), strict=True):
            usable = [s for s in statistics if not s.overexposed]
            axes.plot(
                [s.angle for s in usable], [s.contrast for s in usable], color=colour, linewidth=1.2, marker="o",
                markersize=3, label=one.sample,
            )  # fmt: skip
        axes.set(ylim=(0, None), xlim=(-90, 90), xlabel="angle of the light, degrees", ylabel="speckle contrast")
        axes.set_xticks(range(-90, 91, 30))
        axes.grid(visible=True)
        axes.spines[["top", "right"]].set_visible(False)
        _legend(axes, series)
        return to_svg(figure, name, "Speckle contrast over the angle of the light, one line a series")


def colour_strip(series: Sequence[PhotoSeries], found: Sequence[Sequence[PhotoStatistics]], name: str) -> str:
    """The mean colours of all photographs over the angle of the light, one row a series, all equally bright."""
    with style():
        left = 12 + 6.2 * max(len(one.sample) for one in series)
        figure, axes = new_axes(940, 46 + 26 * len(series), left=min(left, 240), bottom=38, top=4)
        cells = []
        for row, statistics in enumerate(found):
            angles = np.array([s.angle for s in statistics])
            halves = np.diff(angles) / 2
            lower, upper = np.append(halves[:1], halves), np.append(halves, halves[-1:])
            for s, below, above in zip(statistics, lower, upper, strict=True):
                if s.overexposed or not np.isfinite(s.srgb).all():
                    continue
                text = f"{s.angle:g}°: R/B {s.red_over_blue:.3f}, ΔE00 from neutral {s.delta_e:.1f}"
                fill = hex_colour(display_encoded(BRIGHTNESS * s.srgb))
                cells.append(Cell(s.angle - below, s.angle + above, -row - 0.42, -row + 0.42, fill, text))
        axes.set(xlim=(-90, 90), ylim=(-len(series) + 0.5, 0.5), xlabel="angle of the light, degrees")
        axes.set_yticks([-row for row in range(len(series))], [one.sample for one in series])
        axes.set_xticks(range(-90, 91, 15))
        axes.tick_params(axis="y", length=0)
        axes.spines[["top", "right", "left"]].set_visible(False)
        return to_svg(figure, name, "Mean colours over the angle of the light, one row a series", (axes, cells))


def picture(image: FloatArray, series: PhotoSeries, scale: float, label: str) -> str:
    """An `<img>` of white-balanced signals [y, x, 3] times `scale`, in sRGB; `label` is read to the blind."""
    from matplotlib.image import imsave  # noqa: PLC0415  (takes a second)

    encoded = display_encoded(scale * as_srgb(image, series.colour_matrix))
    file = io.BytesIO()
    imsave(file, np.round(255 * encoded).astype(np.uint8), format="png")
    data = base64.b64encode(file.getvalue()).decode("ascii")
    return f'<img src="data:image/png;base64,{data}" alt="{escape(label)}">'


def triptych(series: PhotoSeries, photo: Photo, found: PhotoStatistics, what: str) -> str:
    """Detail, photograph and mean colour side by side, as in Fig. 4 of the paper, with a line of HTML below."""
    scale = BRIGHTNESS / found.luminance
    side, (height, width) = series.inset_side, photo.overview.shape[:2]
    share = side * min(height, width)
    frame = (
        f"left:{50 - 50 * share / width:.2f}%;top:{50 - 50 * share / height:.2f}%;"
        f"width:{100 * share / width:.2f}%;height:{100 * share / height:.2f}%"
    )
    whole = picture(photo.overview.astype(float), series, scale, f"{series.sample}, {what}: photograph")
    detail = picture(photo.inset.astype(float), series, scale, f"{series.sample}, {what}: detail")
    mean = hex_colour(display_encoded(BRIGHTNESS * found.srgb))
    text = (
        f"{escape(what)}, light at {found.angle:g}°: red over blue {found.red_over_blue:.3f} ± "
        f"{COVERAGE_FACTOR * found.u_red_over_blue:.3f}, speckle contrast {found.contrast:.2f}, "
        f"ΔE00 from neutral {found.delta_e:.1f}".replace("-", "−")
    )
    return (
        f'<figure><div class="photos"><div class="photo">{detail}</div>'
        f'<div class="photo">{whole}<span style="{frame}"></span></div>'
        f'<div class="photo swatch" style="background:{mean}"></div></div><figcaption>{text}</figcaption></figure>'
    )


def _chart(series: Sequence[PhotoSeries]) -> "tuple[Figure, Axes]":
    """Axes with room above for a legend of all series."""
    top = 18 + 14 * ceil(len(series) / _ACROSS) if len(series) > 1 else 18
    return new_axes(460, 266 + top, right=12, top=top, bottom=38)


def _legend(axes: "Axes", series: Sequence[PhotoSeries]) -> None:
    if len(series) > 1:
        axes.legend(frameon=False, loc="lower center", ncols=_ACROSS, bbox_to_anchor=(0.5, 1.03), handlelength=1.2)


def _mark_directions(axes: "Axes", series: Sequence[PhotoSeries]) -> None:
    """Where a camera is in the mirror direction, and where it stands itself."""
    for camera in sorted({one.camera_angle for one in series}):
        for angle, text in ((camera, "mirror"), (-camera, "camera")):
            axes.axvline(angle, color=INK, linewidth=0.7, linestyle=(0, (4, 3)), alpha=0.6)
            axes.annotate(
                text, (angle, 1), xycoords=("data", "axes fraction"), xytext=(0, 2), textcoords="offset points",
                ha="center", va="bottom", fontsize=8,
            )  # fmt: skip
