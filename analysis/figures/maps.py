"""In-plane maps of a dataset as SVG text, one panel each: reflected angle across, incident angle up.

Figure numbers are those of Clausen et al. 2022. Every function takes a `name` that is unique in the page.
"""

from collections.abc import Sequence

import numpy as np

from analysis.figures.filled import STEP, at_nearest, filled_cells, hatch
from analysis.figures.notation import with_uncertainty
from analysis.figures.shown_colours import Exposure, shown_colours
from analysis.figures.svg import Cell, hex_colour, new_axes, style, to_svg
from analysis.fits.noise import LEAST_SIGNAL_FOR_HUE, at_wavelength, flag_words, hue_is_known
from drivers.arrays import BoolArray, FloatArray
from goniometer.datasets.angular import SAME_INCIDENCE, incidence_groups
from goniometer.datasets.dataset import Dataset
from goniometer.datasets.fill import Filled
from goniometer.datasets.sector import is_hidden
from goniometer.geometry import BLOCKED_HALF_WIDTH

_LIMITS = (-90.0, 90.0)
_MISSING = "#80808026"


def cell_edges(dataset: Dataset) -> FloatArray:
    """[points, 4] left, right, bottom and top of each point's cell in (theta_out, theta_in), degrees.

    A cell reaches halfway to its neighbours of the same incident angle, not further than a sector that nobody saw,
    and at the end of a row as far as towards its only neighbour, 3 degrees at most.
    """
    theta_in, theta_out = dataset.theta_in, dataset.theta_out
    groups = incidence_groups(theta_in, SAME_INCIDENCE)
    rows = np.array([theta_in[groups == g].mean() for g in range(groups.max() + 1)])
    bottoms, tops = _halfway(rows, 5.0)
    edges = np.empty((theta_in.size, 4))
    for g, row in enumerate(rows):
        members = np.flatnonzero(groups == g)
        broken = is_hidden(dataset, float(row))
        sides = (theta_out[members] < -row, theta_out[members] >= -row) if broken else (np.ones(members.size, bool),)
        for side in sides:
            chosen = members[side]
            chosen = chosen[np.argsort(theta_out[chosen], kind="stable")]
            if not chosen.size:
                continue
            left, right = _halfway(theta_out[chosen], 3.0)
            if broken and theta_out[chosen[0]] < -row:
                right = np.minimum(right, -row - BLOCKED_HALF_WIDTH)
            elif broken:
                left = np.maximum(left, -row + BLOCKED_HALF_WIDTH)
            edges[chosen, 0], edges[chosen, 1] = left, right
        edges[members, 2], edges[members, 3] = bottoms[g], tops[g]
    return np.clip(edges, *_LIMITS)


def _halfway(places: FloatArray, largest_end: float) -> tuple[FloatArray, FloatArray]:
    """Lower and upper limits of cells around ascending `places`."""
    if places.size == 1:
        return places - largest_end, places + largest_end
    middle = 0.5 * (places[1:] + places[:-1])
    first = min(middle[0] - places[0], largest_end)
    last = min(places[-1] - middle[-1], largest_end)
    return np.concatenate([[places[0] - first], middle]), np.concatenate([middle, [places[-1] + last]])


def colour_map(
    dataset: Dataset,
    values: FloatArray,
    exposure: Exposure | None,
    name: str,
    title: str,
    *,
    measured: bool = False,
    filled: Filled | None = None,
) -> str:
    """In-plane map of `values` [points, wavelengths], 1/sr, as colours under D65 (Fig. 5).

    With `exposure` None every cell is shown at the same luminance, so that only its hue is left; cells whose
    signal at 600 nm is below twenty standard uncertainties of its counts stay pale then. Tooltips
    give the angles and, for `measured` values, the BRDF at 600 nm with its combined standard uncertainty (coverage
    factor 1) and what the point is flagged for; flagged cells are outlined then. What is `filled` and
    known well enough lies under the hatching of what was not measured, and its tooltip says so.
    """
    f, u = at_wavelength(dataset, 600.0)
    colours = shown_colours(values, dataset.theta_in, dataset.wavelengths, exposure, hue_is_known(dataset, 600.0))
    fills = [colour or _MISSING for colour in colours]
    if not measured:
        return _map(dataset, fills, [""] * f.size, name, title)
    words = [flag_words(int(flags)) for flags in dataset.flags]
    extra = [
        f"BRDF at 600 nm = {with_uncertainty(value, error)} 1/sr{'; ' if flagged else ''}{flagged}"
        for value, error, flagged in zip(f, u, words, strict=True)
    ]
    return _map(dataset, fills, extra, name, title, dataset.flags != 0, _unmeasured_cells(dataset, filled, exposure))


def _unmeasured_cells(dataset: Dataset, filled: Filled | None, exposure: Exposure | None) -> list[Cell]:
    if filled is None:
        return []
    f, u = at_nearest(filled, 600.0)
    known = f > LEAST_SIGNAL_FOR_HUE * u
    colours = shown_colours(filled.brdf, filled.theta_in, filled.wavelengths, exposure, known)
    fills = [colour or _MISSING for colour in colours]
    rows = {(bottom, top) for _, _, bottom, top in cell_edges(dataset).tolist()}
    return filled_cells(filled, fills, sorted(rows))


def difference_map(dataset: Dataset, differences: FloatArray, largest: float, name: str, title: str) -> str:
    """In-plane map of CIEDE2000 `differences` [points] on a scale from 0 to `largest` (Figs. 8, 13)."""
    fills = [_scale_colour(v / largest) if np.isfinite(v) else _MISSING for v in differences]
    extra = [f"dE00 = {v:.2f}" if np.isfinite(v) else "no value" for v in differences]
    return _map(dataset, fills, extra, name, title)


def difference_scale(largest: float, name: str) -> str:
    """The colour bar that belongs to `difference_map`."""
    with style():
        figure, axes = new_axes(330, 46, left=20, right=20, bottom=30, top=4)
        axes.set(xlim=(0, largest), ylim=(0, 1), yticks=[], xlabel="colour difference dE00 (1 is just noticeable)")
        steps = np.linspace(0, largest, 65)
        middle = 0.5 * (steps[1:] + steps[:-1]) / largest
        cells = [Cell(a, b, 0, 1, _scale_colour(m), "") for a, b, m in zip(steps[:-1], steps[1:], middle, strict=True)]
        return to_svg(figure, name, f"colour scale from 0 to {largest:g}", (axes, cells))


def _scale_colour(share: float) -> str:
    from matplotlib import colormaps  # noqa: PLC0415

    return hex_colour(colormaps["cividis"](float(np.clip(share, 0, 1)))[:3])


def _map(
    dataset: Dataset,
    fills: list[str],
    extra: list[str],
    name: str,
    title: str,
    outlined: BoolArray | None = None,
    unmeasured: Sequence[Cell] = (),
) -> str:
    edges = cell_edges(dataset)
    marked = np.zeros(len(fills), dtype=bool) if outlined is None else outlined
    cells = [
        Cell(
            edge[0],
            edge[1],
            edge[2],
            edge[3],
            fill,
            f"θ in {t_in:.1f}°, θ out {t_out:.1f}°{'; ' if more else ''}{more}",
            bool(mark),
        )
        for edge, fill, t_in, t_out, more, mark in zip(
            edges.tolist(), fills, dataset.theta_in, dataset.theta_out, extra, marked, strict=True
        )
        if edge[1] > edge[0]
    ]
    label = f"{title}: {len(cells)} cells, reflected angle across, incident angle up"
    cells += unmeasured
    groups = incidence_groups(dataset.theta_in, SAME_INCIDENCE)
    low, high = float(edges[:, 2].min()), float(edges[:, 3].max())
    with style():
        figure, axes = new_axes(330, 235)
        axes.set(xlim=_LIMITS, ylim=(low, high), title=title)
        axes.set(xlabel="reflected angle θ out / °", ylabel="incident angle θ in / °", xticks=range(-90, 91, 30))
        for g in range(groups.max() + 1):
            centre = -float(dataset.theta_in[groups == g].mean())
            bottom, top = edges[groups == g][0, 2:]
            if not is_hidden(dataset, -centre):
                continue
            hatch(
                axes, centre - BLOCKED_HALF_WIDTH, centre + BLOCKED_HALF_WIDTH, bottom, top, on_colour=bool(unmeasured)
            )
        for cell in unmeasured:
            if cell.right - cell.left > STEP:  # outside the sector
                hatch(axes, cell.left, cell.right, cell.bottom, cell.top, on_colour=True)
        line = np.array([low, high])
        for side, dashes in ((1, (4, 3)), (-1, (1.5, 2.5))):
            # black on white, so that the line is seen on cells of any colour
            axes.plot(side * line, line, color="white", linewidth=1)
            axes.plot(side * line, line, color="black", linewidth=1, dashes=dashes)
        return to_svg(figure, name, label, (axes, cells))
