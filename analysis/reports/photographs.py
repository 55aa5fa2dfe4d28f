"""The page of series of photographs: Figs. 1 and 4 of the paper, and what the photographs say in numbers."""

from collections.abc import Sequence
from html import escape

from analysis.figures.page import bullets, figure, page
from analysis.figures.photographs import BRIGHTNESS, colour_strip, contrast_chart, redness_chart, triptych
from analysis.photo_statistics import BACKWARD_TILT, FORWARD_TILT, PhotoStatistics, shown_photo
from goniometer.datasets.budget import COVERAGE_FACTOR
from goniometer.photographs.photos import SATURATED, PhotoSeries

UNEVEN = 0.05
"""Unevenness of the panel above which it is worth a word."""


def photo_page(series: Sequence[PhotoSeries], found: Sequence[Sequence[PhotoStatistics]]) -> str:
    """A self-contained page of one or more series and what `photo_statistics` found in each."""
    title = "Macro photographs" if len(series) > 1 else f"Macro photographs of {series[0].sample}"
    body = [f"<h1>{escape(title)}</h1>", _introduction(series)]
    for one, statistics in zip(series, found, strict=True):
        body += [f"<h2>{escape(one.sample)}</h2>", _remarks(one, statistics), _pictures(one, statistics)]
    body += [
        "<h2>Colour and speckle over the angle of the light</h2>",
        figure(
            [colour_strip(series, found, "colours")],
            "Mean colours of the details, all made equally bright; gaps are overexposed.",
        ),
        figure(
            [redness_chart(series, found, "redness"), contrast_chart(series, found, "contrast")],
            "Left: red over blue of the white-balanced camera signals on a logarithmic scale; bars are the expanded "
            f"uncertainty (k = {COVERAGE_FACTOR:g}) from the number of speckles in the detail; what lies beyond the "
            "scale is drawn at its edge. Right: standard deviation over mean of the luminance, without slow variation.",
        ),
    ]
    body += [_table(one, statistics) for one, statistics in zip(series, found, strict=True)]
    return page(title, body)


def photo_remarks(series: PhotoSeries, found: Sequence[PhotoStatistics]) -> list[str]:
    """What a person should know of a series before they believe it, in sentences."""
    remarks = []
    over = [f"{s.angle:g}°" for s in found if s.overexposed]
    if over:
        remarks.append(
            f"Overexposed, more than {100 * SATURATED:g} % of the detail saturated, and left out of charts and "
            f"pictures: {', '.join(over)}."
        )
    some = [s for s in found if not s.overexposed and s.saturated]
    if some:
        most = max(s.saturated for s in some)
        remarks.append(f"{len(some)} more have single saturated pixels, {100 * most:.2g} % of the detail at most.")
    if series.unevenness > UNEVEN:
        remarks.append(
            f"The panel's brightness varies by {100 * series.unevenness:.2g} % over the detail; there is no flat "
            f"field, so take a smaller one where that matters."
        )
    if series.colour_matrix is None:
        remarks.append("No colour matrix was stated: the camera's red, green and blue are taken for those of sRGB.")
    return remarks


def _introduction(series: Sequence[PhotoSeries]) -> str:
    angles = {one.camera_angle for one in series}
    where = f"at {angles.pop():g}°" if len(angles) == 1 else "at a fixed angle"
    return (
        f'<p class="soft">A camera {where} to the surface normal looks at a surface under a collimated light that '
        "moves around it; colours are relative to a Spectralon panel under the same light. With the light on the other "
        "side of the normal, at positive angles for a camera at a positive one, it sees forward scattering.</p>"
        '<p class="soft">Pictures are a detail, the whole photograph, and the mean colour of the detail. Each is '
        f"exposed to a mean of {100 * BRIGHTNESS:g} % of the display's luminance; what exceeds it is clipped.</p>"
    )


def _remarks(series: PhotoSeries, found: Sequence[PhotoStatistics]) -> str:
    remarks = photo_remarks(series, found)
    return f'<div class="verdict note">{bullets(remarks)}</div>' if remarks else ""


def _pictures(series: PhotoSeries, found: Sequence[PhotoStatistics]) -> str:
    pictures = []
    for what, tilt in (("Forward scattering", FORWARD_TILT), ("Backward scattering", BACKWARD_TILT)):
        index = shown_photo(series, tilt)
        if index is not None and found[index].luminance > 0:
            pictures.append(triptych(series, series.photos[index], found[index], what))
    if not pictures:
        return "<p>All photographs are overexposed or dark; there is nothing to show.</p>"
    return f'<div class="pair">{"".join(pictures)}</div>'


def _table(series: PhotoSeries, found: Sequence[PhotoStatistics]) -> str:
    heads = (
        "light, °",
        "exposure, s",
        "luminance over panel",
        "red over blue",
        "x",
        "y",
        "ΔE00 from neutral",
        "contrast",
        "R, G, B",
        "speckles",
        "saturated, %",
    )
    rows = []
    for photo, s in zip(series.photos, found, strict=True):
        cells = (
            f"{s.angle:g}",
            _shutter(photo.exposure),
            f"{s.luminance:.3g}",
            f"{s.red_over_blue:.3f} ± {COVERAGE_FACTOR * s.u_red_over_blue:.3f}",
            f"{s.chromaticity[0]:.4f}",
            f"{s.chromaticity[1]:.4f}",
            f"{s.delta_e:.1f}",
            f"{s.contrast:.2f}",
            ", ".join(f"{c:.2f}" for c in s.contrast_rgb),
            f"{s.speckles:.0f}",
            f"{100 * s.saturated:.2g}" + (" (left out)" if s.overexposed else ""),
        )
        shown = (cell.replace("-", "−") for cell in cells)
        rows.append("<tr>" + "".join(f'<td class="number">{cell}</td>' for cell in shown) + "</tr>")
    head = "".join(f'<th class="number">{escape(text)}</th>' for text in heads)
    return (
        f"<details><summary>All numbers of {escape(series.sample)}</summary>"
        f'<div class="wide"><table><thead><tr>{head}</tr></thead><tbody>{"".join(rows)}</tbody></table></div></details>'
    )


def _shutter(exposure: float) -> str:
    """An exposure time as photographers write it."""
    return f"1/{1 / exposure:.0f}" if exposure < 0.3 else f"{exposure:.2g}"
