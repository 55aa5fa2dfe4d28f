"""Two materials side by side in the vase's scene, as pictures, numbers and a page."""

from html import escape

import numpy as np

from analysis.colour import display_encoded
from analysis.figures.page import bullets, figure, image_panel
from analysis.figures.svg import hex_colour
from analysis.mitsuba.vase_render import Comparison
from drivers.arrays import FloatArray

DIFFERENCE_MAP = "cividis"
"""Colours of a picture of differences, which the colour-blind see as well."""


def shown(comparison: Comparison) -> tuple[FloatArray, FloatArray]:
    """[rows, columns, 3] both pictures, display-encoded."""
    first, second = (
        display_encoded(comparison.display.shown(np.nan_to_num(xyz))) for xyz in (comparison.first, comparison.second)
    )
    return first, second


def largest_drawn(comparison: Comparison) -> float:
    """The dE00 that is drawn brightest."""
    return max(1.0, float(np.nanpercentile(comparison.difference, 99)))


def difference_picture(comparison: Comparison) -> FloatArray:
    """[rows, columns, 4] dE00, clear where none is taken."""
    share = np.nan_to_num(comparison.difference) / largest_drawn(comparison)
    return np.asarray(np.concatenate([_heat(share), comparison.covered[..., None]], axis=-1), dtype=float)


def comparison_figure(comparison: Comparison, seconds: FloatArray, names: tuple[str, str]) -> str:
    """Both pictures with their render times [rounds, 2], s, and their difference, as Fig. 14 of the paper."""
    top = largest_drawn(comparison)
    words = [f"{name}, {each:.2g} s" for name, each in zip(names, np.median(seconds, axis=0), strict=True)]
    panels = [image_panel(image, each) for image, each in zip(shown(comparison), words, strict=True)]
    stops = ", ".join(hex_colour(rgb) for rgb in _heat(np.linspace(0, 1, 9)))
    scale = (
        f'<div style="height:.6rem;border-radius:3px;background:linear-gradient(to right,{stops})"></div>'
        f'<div class="soft" style="display:flex;justify-content:space-between"><span>0</span><span>{top:.2g}</span>'
        "</div>"
    )
    panels.append(f"<div>{image_panel(difference_picture(comparison), 'dE00 between them')}{scale}</div>")
    caption = (
        "A vase under a spot light of D65, with one exposure for both pictures and the same random numbers. "
        f"dE00 is CIEDE2000 of what is shown, brighter than {top:.2g} drawn as that; single pixels are noisy."
    )
    return figure(panels, caption, "three")


def comparison_lines(comparison: Comparison, names: tuple[str, str]) -> list[str]:
    """What the pictures say in numbers, in sentences."""
    return [
        f"{names[1]} against {names[0]}: mean dE00 {comparison.mean:.2f} ± {comparison.u_mean:.2f} (k = 1, by the "
        f"samples of the rendering), 95th percentile {comparison.p95:.2f}, over {int(comparison.covered.sum())} pixels "
        "that show nothing else.",
        f"{comparison.clipped:.0%} of these are brighter than the display and {comparison.dark:.0%} dark; in them a "
        "colour difference says little.",
    ]


def time_line(seconds: FloatArray, names: tuple[str, str]) -> str:
    """Render times [rounds, 2], s, in a sentence."""
    first, second = (float(v) for v in np.median(seconds, axis=0))
    return (
        f"A picture took {first:.3g} s with {names[0]} and {second:.3g} s with {names[1]}, the median of "
        f"{len(seconds)} that were rendered by turns."
    )


def comparison_body(
    comparison: Comparison,
    seconds: FloatArray,
    names: tuple[str, str],
    sample: str,
    lines: list[str],
    notes: list[str],
    trusted: bool,
) -> list[str]:
    """Pieces of HTML for the page; `seconds` [rounds, 2] of rendering, `lines` and `notes` are sentences.

    `trusted` says whether both fits are.
    """
    answer = (
        f"The shift changes what is seen by a mean dE00 of {comparison.mean:.2f}, and by more than "
        f"{comparison.p95:.2f} in 5 % of the pixels."
    )
    if not trusted:
        answer += " Not both fits are to be trusted, see below."
    return [
        f'<p class="soft">{escape(sample)}, as it was fitted, rendered by Mitsuba</p>',
        f'<div class="verdict{"" if trusted else " warn"}"><strong>{escape(answer)}</strong></div>',
        comparison_figure(comparison, seconds, names),
        bullets(lines),
        *(["<h2>What to know of it</h2>", bullets(notes)] if notes else []),
    ]


def _heat(share: FloatArray) -> FloatArray:
    """[..., 3] display-encoded colours of shares from 0 to 1."""
    from matplotlib import colormaps  # noqa: PLC0415  (takes a second)

    return np.asarray(colormaps[DIFFERENCE_MAP](np.clip(share, 0, 1)))[..., :3]
