"""What rays do on a surface, as pictures: the make-up of scattered light by the number of reflections (Fig. 11)."""

import numpy as np

from analysis.figures.svg import INK, new_axes, style, to_svg
from drivers.arrays import FloatArray
from goniometer.datasets.budget import COVERAGE_FACTOR

ORDER_COLOURS = ("#2b6cb8", "#8ec1ee", "#e0a04a", "#a8561d")
"""Of light that was reflected once, twice, three times, and more often: blue and light blue as the paper's."""

_WIDTH, _HEIGHT = 400.0, 232.0
_LABELS = ("once", "twice", "3 times", "4 or more")


def share_panel(theta_in: float, theta_out: FloatArray, share: FloatArray, u_share: FloatArray, name: str) -> str:
    """Share of the light in each direction that was reflected once, twice, three times, and more often.

    `theta_out` [bins] evenly spaced, degrees; `share` and its standard error [bins, 4], NaN where too little light
    arrives. Bars are stacked; the error bar is that of the share of single reflections. `name` is unique in a page.
    """
    width = float(np.diff(theta_out).min()) if theta_out.size > 1 else 5.0
    lit = np.isfinite(share).all(axis=1)
    with style():
        figure, axes = new_axes(_WIDTH, _HEIGHT, top=38)
        below = np.zeros(int(lit.sum()))
        for order, colour in enumerate(ORDER_COLOURS):
            part = 100 * share[lit, order]
            axes.bar(theta_out[lit], part, width, below, color=colour, linewidth=0, label=_LABELS[order])
            below = below + part
        axes.errorbar(
            theta_out[lit], 100 * share[lit, 0], 100 * COVERAGE_FACTOR * u_share[lit, 0],
            fmt="none", ecolor=INK, elinewidth=0.9, capsize=1.5, capthick=0.9,
        )  # fmt: skip
        for angle, text, dashes in ((theta_in, "mirror", (5, 3)), (-theta_in, "light", (1.5, 2))):
            axes.axvline(angle, color=INK, linewidth=0.9, dashes=dashes)
            if theta_in > 0 or text == "mirror":
                words = text if theta_in > 0 else "mirror and light"
                axes.annotate(
                    words, (angle, 1), xycoords=("data", "axes fraction"), xytext=(0, 2),
                    textcoords="offset points", ha="center", va="bottom", fontsize=8,
                )  # fmt: skip
        axes.set(xlim=(-90, 90), ylim=(0, 100), xlabel="θ out / °", ylabel="share of the light / %")
        axes.set_title(f"θ in = {theta_in:g}°", loc="left", pad=16)
        axes.set_xticks(range(-90, 91, 30))
        axes.spines[["top", "right"]].set_visible(False)
        figure.legend(
            loc="upper right", ncols=4, frameon=False, borderaxespad=0.2, columnspacing=0.9, handlelength=1, fontsize=8
        )
        return to_svg(figure, name, f"shares of light by number of reflections at an incident angle of {theta_in:g}°")


def halves_panel(theta_in: FloatArray, share: FloatArray, u_share: FloatArray, name: str) -> str:
    """Where the light goes that leaves the surface, over `theta_in` [incident], degrees, and how often reflected.

    `share` and its standard error are [incident, (once, more often), (back, forward)]. `name` is unique in a page.
    """
    kinds = (
        ((0, 1), ORDER_COLOURS[0], "-", "o", "once, forward"),
        ((0, 0), ORDER_COLOURS[0], "--", "s", "once, back"),
        ((1, 1), ORDER_COLOURS[2], "-", "o", "more often, forward"),
        ((1, 0), ORDER_COLOURS[2], "--", "s", "more often, back"),
    )
    with style():
        figure, axes = new_axes(_WIDTH, _HEIGHT, left=54, top=38)
        lowest = 100.0
        for (times, side), colour, line, marker, label in kinds:
            value, u = (100 * each[:, times, side] for each in (share, u_share))
            seen = value > 0
            lowest = min(lowest, *value[seen], 100.0)
            axes.plot(
                theta_in[seen], value[seen], line, marker=marker, markersize=3, color=colour, linewidth=1.3, label=label
            )
            floor = np.maximum(value - COVERAGE_FACTOR * u, value / 10)
            axes.fill_between(
                theta_in[seen], floor[seen], (value + COVERAGE_FACTOR * u)[seen], color=colour, alpha=0.25, linewidth=0
            )
        axes.set(yscale="log", xlim=(-2, 90), ylim=(0.6 * lowest, 150))
        axes.set(xlabel="θ in / °", ylabel="share of the light that leaves / %")
        axes.set_xticks(range(0, 91, 15))
        axes.yaxis.set_major_formatter("{x:g}")
        axes.minorticks_off()
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(visible=True)
        figure.legend(loc="upper right", ncols=2, frameon=False, borderaxespad=0.2, columnspacing=1.2, fontsize=8)
        return to_svg(figure, name, "single and multiple reflections forward and back over the incident angle")
