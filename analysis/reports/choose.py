"""The page of a choice: what the scene looks like by the measurement and by the model, and why this model."""

from dataclasses import dataclass
from html import escape
from typing import Literal

import numpy as np

from analysis.choices import MODEL_NAMES
from analysis.colour import display_encoded
from analysis.figures.page import bullets, figure, image_panel
from analysis.figures.svg import INK, SEQUENCE, new_axes, style, to_svg
from analysis.mitsuba.verify import Verification, cheaper
from analysis.scenes.asked import CARRIED, CELL
from analysis.scenes.choose import Choice, Judged, least_directions
from drivers.arrays import FloatArray

RUNG_NAMES = MODEL_NAMES | {"lambert": "Lambert", "tinted": "Tinted lobe", "table": "Table of the measurement"}
"""How a person reads the name of a rung."""

LEAST_MEASURABLE = 0.8
"""Share of a scene's weight below which the page warns that the answer rests on directions that were not measured."""

_STATES = {
    "meets": ("ok", "✓ meets"),
    "fails": ("bad", "✗ fails"),
    "undetermined": ("open", "? undetermined"),
    "not identified": ("bad", "✗ not identified"),
}


def summary(choice: Choice) -> list[str]:
    """The answer in sentences."""
    picture = choice.picture
    lines = [_answer(choice)]
    lines += [
        f"Refused: {RUNG_NAMES[judged.rung.name]}, mean dE00 {_spread(judged)}. {judged.why}"
        for judged in cheaper(choice)
    ]
    lines.append(
        f"{picture.clipped:.0%} of the pixels are brighter than the display and {picture.dark:.0%} are dark; in "
        "these a colour difference says little."
    )
    if choice.asked.measurable < LEAST_MEASURABLE:
        lines.append(
            f"Only {choice.asked.measurable:.0%} of what the scene asks for can be measured in the plane: the answer "
            "rests on how the measurement is continued beyond it."
        )
    lines.append(
        f"{choice.asked.cells} of {choice.asked.all_cells} cells of {CELL:g}° in theta_in and theta_out carry "
        f"{CARRIED:.0%} of what the scene asks for within reach; {choice.asked.out_of_plane:.1%} of it has no "
        f"direction in the plane, {choice.asked.grazing:.1%} lies beyond the bench's largest angle and "
        f"{choice.asked.blocked:.1%} where the detector blocks the light."
    )
    return lines


def _answer(choice: Choice) -> str:
    chosen = choice.chosen
    if chosen is None:
        open_ones = [RUNG_NAMES[j.rung.name] for j in choice.judged if j.state == "undetermined"]
        if open_ones:
            return f"Undetermined: no model is certain to meet dE00 {choice.tolerance:g}; {', '.join(open_ones)} may."
        return f"No model meets dE00 {choice.tolerance:g} in this scene."
    numbers = f"{chosen.parameters} parameters" if chosen.parameters != 1 else "1 parameter"
    return (
        f"{RUNG_NAMES[chosen.rung.name]} at {_wavelengths(chosen)}, with {numbers}, meets dE00 {choice.tolerance:g}: "
        f"mean {_spread(chosen)}, 95th percentile {chosen.score.p95:.2f}."
    )


def _spread(judged: Judged) -> str:
    return f"{judged.score.expected:.2f} ({judged.score.low:.2f} to {judged.score.high:.2f})"


def verified_lines(found: Verification) -> list[str]:
    """Predicted against rendered colour differences, in sentences."""
    return [
        f"Rendered by Mitsuba, {RUNG_NAMES[each.judged.rung.name]} at {_wavelengths(each.judged)} differs by a mean "
        f"dE00 of {each.mean:.2f} ± {each.u_render:.2f} (k = 1), 95th percentile {each.p95:.2f}; predicted were "
        f"{each.judged.score.mean:.2f} and {each.judged.score.p95:.2f}."
        for each in found.models
    ]


def _wavelengths(judged: Judged) -> str:
    count = judged.wavelengths.size
    return f"{count} wavelengths" if count > 1 else "1 wavelength"


def choice_body(choice: Choice, sample: str, scene: str, rendered: Verification | None) -> list[str]:
    """Pieces of HTML for the page of a choice."""
    answer, *rest = summary(choice)
    refused, others = rest[: len(cheaper(choice))], rest[len(cheaper(choice)) :]
    sure = choice.chosen is not None and choice.asked.measurable >= LEAST_MEASURABLE
    kind = "" if sure else " warn"
    return [
        f'<p class="soft">{escape(sample)} in the scene {escape(scene)}</p>',
        f'<div class="verdict{kind}"><strong>{escape(answer)}</strong></div>',
        "<p>Every model is seen on the same ways of light from the lamps over the material into the camera as the "
        "measurement. Its error is the mean colour difference CIEDE2000 over the pixels that show the material, "
        "expected over all that the uncertainty of the measurement leaves possible; the interval holds 90 % of that. "
        "The table's own error is what the measurement itself does not know. A model meets the tolerance, or fails, "
        "only if it does so beyond the noise of the trace.</p>",
        pictures(choice),
        figure(
            [ladder_chart(choice)],
            "Mean colour difference of each model in this scene, all wavelengths; bars reach over the interval.",
            "alone",
        ),
        bullets(refused),
        _table(choice),
        *([] if rendered is None else [_rendered(choice, rendered)]),
        "<h2>What the scene asks for</h2>",
        *(f"<p>{escape(line)}</p>" for line in others),
    ]


def pictures(choice: Choice) -> str:
    """The scene by the measurement and by the chosen model, and their difference."""
    panels = [image_panel(each.image, each.words) for each in shaded(choice)]
    caption = "The scene by the measurement; no model was chosen."
    if len(panels) > 1:
        caption = "The scene by the measurement and by the chosen model with one exposure, and CIEDE2000 between them."
    return figure(panels, caption, "three")


@dataclass(frozen=True)
class Panel:
    """An image with what it is."""

    name: Literal["measurement", "model", "difference"]
    words: str
    image: FloatArray
    """[rows, columns, 4], display-encoded; clear where something else is seen than the material."""
    top: float | None = None
    """Of a difference: the dE00 that is drawn brightest."""


def shaded(choice: Choice) -> list[Panel]:
    """The scene by the measurement and, where one was chosen, by the model, and their difference; shaded here."""
    picture = choice.picture
    if picture.chosen is None or choice.chosen is None:
        return [Panel("measurement", "by the measurement", _rgb(choice, picture.reference))]
    difference = picture.display.difference(picture.reference, picture.chosen)
    model = RUNG_NAMES[choice.chosen.rung.name]
    return _panels(choice, picture.reference, picture.chosen, difference, f"by {model}", "by the measurement")


def rendered_panels(choice: Choice, rendered: Verification) -> list[Panel]:
    """The same as Mitsuba has rendered it."""
    valid = rendered.valid
    difference = np.zeros(valid.size)
    difference[valid] = choice.picture.display.difference(rendered.reference[valid], rendered.chosen[valid])
    images = np.nan_to_num(rendered.reference), np.nan_to_num(rendered.chosen)
    return _panels(choice, *images, difference, "rendered by the model", "rendered by the measurement")


def _panels(
    choice: Choice, reference: FloatArray, chosen: FloatArray, difference: FloatArray, model: str, measurement: str
) -> list[Panel]:
    top = max(2 * choice.tolerance, float(np.percentile(difference, 99)))
    heat = _heat(choice, difference / top)
    return [
        Panel("measurement", measurement, _rgb(choice, reference)),
        Panel("model", model, _rgb(choice, chosen)),
        Panel("difference", f"difference, dark 0 to bright {top:.2g}", heat, top),
    ]


def _rendered(choice: Choice, rendered: Verification) -> str:
    """The chapter of the rendering."""
    panels = [image_panel(each.image, each.words) for each in rendered_panels(choice, rendered)]
    return (
        "<h2>Rendered</h2>"
        + figure(panels, "The same scene and exposure, rendered by Mitsuba with the same random numbers.", "three")
        + bullets(verified_lines(rendered))
    )


def _rgb(choice: Choice, xyz: FloatArray) -> FloatArray:
    """[rows, columns, 4] of target pixels [pixels, 3], and what lies between them is clear."""
    return _spread_out(choice, display_encoded(choice.picture.display.shown(xyz)))


def _heat(choice: Choice, values: FloatArray) -> FloatArray:
    from matplotlib import colormaps  # noqa: PLC0415

    return _spread_out(choice, np.asarray(colormaps["cividis"](np.clip(values, 0, 1)))[:, :3])


def _spread_out(choice: Choice, rgb: FloatArray) -> FloatArray:
    vertices = choice.vertices
    whole = np.zeros((vertices.rows * vertices.columns, 4))
    whole[vertices.target] = np.column_stack([rgb, np.ones(len(rgb))])
    shown = whole.reshape(vertices.rows, vertices.columns, 4)
    rows, columns = (np.flatnonzero(shown[..., 3].any(axis=axis)) for axis in (1, 0))
    return shown[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]


def ladder_chart(choice: Choice) -> str:
    """Error and interval of every rung beside the tolerance."""
    with style():
        figure_, axes = new_axes(470, 34 + 26 * len(choice.judged) + 30, left=170, top=10, bottom=36)
        for row, judged in enumerate(choice.judged):
            score = judged.score
            colour = SEQUENCE[0] if judged.state == "meets" else SEQUENCE[4]
            low, mean, high = (max(v, 0.02) for v in (score.low, score.expected, score.high))
            axes.plot([low, high], [row, row], color=colour, linewidth=5, alpha=0.45, solid_capstyle="butt")
            axes.plot([mean], [row], marker="o" if judged.state == "meets" else "X", color=colour, markersize=5)
        axes.axvline(choice.tolerance, color=INK, linewidth=1.0, dashes=(4, 3))
        axes.set(xscale="log", xlim=(0.02, None), ylim=(len(choice.judged) - 0.5, -0.5))
        axes.set_xlabel("mean dE00 in the scene; dashed: tolerance; ● meets, x refused")
        axes.set_yticks(range(len(choice.judged)), [RUNG_NAMES[j.rung.name] for j in choice.judged])
        ticks = [v for v in (0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50) if v <= axes.get_xlim()[1]]
        axes.set_xticks(ticks, [f"{v:g}" for v in ticks])
        axes.minorticks_off()
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(visible=True, axis="x")
        return to_svg(figure_, "ladder", "Colour error of every model of the ladder")


def _table(choice: Choice) -> str:
    numbers = ("dE00", "interval", "mean", "p95", "λ", "numbers", "bytes", "directions", "ns")
    head = "".join(f'<th class="number">{name}</th>' for name in numbers)
    rows = [*choice.judged, *choice.tried, *([] if choice.chosen is None else [choice.chosen])]
    body = "".join(_row(choice, judged) for judged in rows)
    return (
        f'<div class="wide"><table><caption>Every model at {choice.judged[0].wavelengths.size} wavelengths, then the '
        "chosen one at fewer. dE00 is the expected mean over pixels; mean and p95 are those of an exact measurement. "
        "λ: wavelengths; numbers: parameters; bytes: their size in single precision; directions: how many must be "
        "measured at the least; ns: what one direction at one wavelength takes on this computer.</caption>"
        f"<tr><th>Model</th><th></th>{head}</tr>{body}</table></div>"
    )


def _row(choice: Choice, judged: Judged) -> str:
    score, (kind, word) = judged.score, _STATES[judged.state]
    numbers = (
        f"{score.expected:.2f}",
        f"{score.low:.2f} – {score.high:.2f}",
        f"{score.mean:.2f}",
        f"{score.p95:.2f}",
        f"{judged.wavelengths.size}",
        f"{judged.parameters}",
        f"{judged.size}",
        f"{least_directions(choice, judged)}",
        f"{judged.nanoseconds:.0f}",
    )
    cells = "".join(f'<td class="number">{number}</td>' for number in numbers)
    return f'<tr><td>{escape(RUNG_NAMES[judged.rung.name])}</td><td class="mark {kind}">{word}</td>{cells}</tr>'
