"""What gratings of many spacings do to light: directions, binned spectra and their slopes (paper, Fig. 7).

Every function takes plain arrays and a `name` that is unique in the page.
"""

from collections.abc import Mapping

import numpy as np

from analysis.figures.svg import INK, SEQUENCE, line_colours, new_axes, style, to_svg
from drivers.arrays import FloatArray

_MARKS = ("o", "s", "^", "D")


def orders_over_spacing(
    periods_um: FloatArray, angles: FloatArray, wavelengths: FloatArray, shown: float, name: str
) -> str:
    """Angles [wavelengths, periods], degrees, between the mirror direction and the first order, over the spacing.

    `wavelengths` are in nm; angles up to `shown` are in view (paper, Fig. 7a).
    """
    with style():
        figure, axes = new_axes(460, 300)
        for nm, curve, colour in zip(wavelengths, angles, line_colours(len(wavelengths)), strict=True):
            axes.plot(periods_um, curve, color=colour, linewidth=1.3, label=f"{nm:g} nm")
        axes.set(
            xlim=(0, periods_um[-1]),
            ylim=(0, shown),
            xlabel="spacing of the grating, µm",
            ylabel="diffraction angle, degrees",
        )
        axes.grid(visible=True)
        axes.spines[["top", "right"]].set_visible(False)
        axes.legend(frameon=False, loc="upper right", reverse=True)
        return to_svg(figure, name, "Diffraction angle of the first order over the spacing, one line per wavelength")


def binned_spectra_figure(wavelengths: FloatArray, spectra: FloatArray, edges: FloatArray, name: str) -> str:
    """`spectra` [bins, wavelengths], each over its own maximum, of diffraction angles between `edges` [bins + 1].

    `wavelengths` are in nm, `edges` in degrees (paper, Fig. 7b). A bin without light is left out.
    """
    with style():
        figure, axes = new_axes(460, 300, right=76)
        places = []
        for spectrum, colour, low, high in zip(spectra, line_colours(len(spectra)), edges[:-1], edges[1:], strict=True):
            if spectrum.max() > 0:
                axes.plot(wavelengths, spectrum / spectrum.max(), color=colour, linewidth=1.3)
                places.append((float(spectrum[-1] / spectrum.max()), f"{low:g}–{high:g}°", colour))
        for height, text, colour in _apart(places, 0.052):
            axes.annotate(
                text,
                (1.0, height),
                xycoords=("axes fraction", "data"),
                textcoords="offset points",
                xytext=(6, 0),
                color=colour,
                va="center",
                fontsize=8.5,
                annotation_clip=False,
            )
        axes.set(
            xlim=(wavelengths[0], wavelengths[-1]),
            ylim=(0, 1.05),
            xlabel="wavelength, nm",
            ylabel="light in the bin over its maximum",
        )
        axes.grid(visible=True)
        axes.spines[["top", "right"]].set_visible(False)
        return to_svg(figure, name, "Spectra of bins of diffraction angle, each over its maximum")


def slopes_over_angle(edges: FloatArray, slopes: Mapping[str, FloatArray], lambda_n: float, name: str) -> str:
    """Relative slopes [bins], 1/um, of each way to spread the spacings, over the diffraction angle.

    Lines show the slopes of spectra that are proportional to the wavelength, constant, and inversely proportional, at
    `lambda_n`, nm. Bins between `edges`, degrees.
    """
    middle = (edges[:-1] + edges[1:]) / 2
    unit = 1e3 / lambda_n
    with style():
        figure, axes = new_axes(460, 300, right=76)
        for (label, values), mark, colour in zip(slopes.items(), _MARKS, SEQUENCE[::2], strict=False):
            axes.plot(middle, values, color=colour, marker=mark, markersize=4.5, linewidth=0.9, label=label)
        for height, text in ((unit, "∝ λ"), (0.0, "constant"), (-unit, "∝ 1/λ")):
            axes.axhline(height, color=INK, linewidth=0.7, linestyle=":", zorder=0)
            axes.annotate(
                text,
                (1.0, height),
                xycoords=("axes fraction", "data"),
                textcoords="offset points",
                xytext=(6, 0),
                va="center",
                fontsize=8.5,
            )
        lowest = min((float(np.nanmin(v)) for v in slopes.values() if np.isfinite(v).any()), default=0.0)
        axes.set(
            xlim=(edges[0], edges[-1]),
            ylim=(min(lowest, -3.6 * unit) * 1.05, 1.6 * unit),
            xlabel="diffraction angle, degrees",
            ylabel=f"slope at {lambda_n:g} nm, 1/µm",
        )
        axes.grid(visible=True)
        axes.spines[["top", "right"]].set_visible(False)
        axes.legend(frameon=False, loc="lower right")
        return to_svg(figure, name, "Slope of the binned spectra over the diffraction angle")


def _apart(places: list[tuple[float, str, str]], distance: float) -> list[tuple[float, str, str]]:
    """Labels in order of their height, moved upwards until none is nearer than `distance` to the next, from below."""
    moved: list[tuple[float, str, str]] = []
    for height, text, colour in sorted(places, key=lambda place: round(place[0], 2)):
        lowest = moved[-1][0] + distance if moved else height
        moved.append((max(height, lowest), text, colour))
    over = max(moved[-1][0] - 1.05, 0.0) if moved else 0.0
    down: list[tuple[float, str, str]] = []
    for height, text, colour in reversed(moved):
        highest = down[-1][0] - distance if down else height - over
        down.append((min(height, highest), text, colour))
    return down
