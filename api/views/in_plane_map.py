"""The in-plane map: every measured direction as a cell in its own colour, and what is known of the others."""

import numpy as np

from analysis.colour import brdf_to_xyz, has_colour
from analysis.figures.filled import at_nearest, filled_cells
from analysis.figures.maps import cell_edges
from analysis.figures.shown_colours import Exposure, exposure_of, shown_colours
from analysis.fits.noise import LEAST_SIGNAL_FOR_HUE, flag_words, hue_is_known
from api.bodies.base import number
from api.bodies.plots import SHOWN_AT, Edges, FilledCell, InPlaneMap, MapCell
from api.views.listing import flag_names
from api.views.opened import Opened
from drivers.arrays import FloatArray
from goniometer.datasets.angular import SAME_INCIDENCE, incidence_groups
from goniometer.datasets.dataset import Dataset
from goniometer.datasets.fill import Filled
from goniometer.datasets.sector import is_hidden
from goniometer.geometry import BLOCKED_HALF_WIDTH


def in_plane_map(opened: Opened, filled: Filled | None) -> InPlaneMap:
    """The map of a dataset, with what is `filled` in it."""
    dataset = opened.dataset
    exposure = exposure_of(dataset) if has_colour(dataset.wavelengths) else None
    measured = _colours(dataset.brdf, dataset.theta_in, dataset, exposure, hue_is_known(dataset, SHOWN_AT))
    luminance = np.full(dataset.theta_in.size, np.nan)
    if exposure is not None:
        luminance = brdf_to_xyz(dataset.brdf, dataset.theta_in, dataset.wavelengths)[:, 1]
    differences = opened.differences
    off = np.full(luminance.size, np.nan) if differences is None else differences.absolute
    edges = cell_edges(dataset)
    cells = [
        MapCell(
            point=i,
            theta_in_deg=float(dataset.theta_in[i]),
            theta_out_deg=float(dataset.theta_out[i]),
            edges=_edges(edges[i].tolist()),
            colour=measured[0][i],
            hue=measured[1][i],
            luminance=number(luminance[i]),
            flags=flag_names(int(dataset.flags[i])),
            flag_words=flag_words(int(dataset.flags[i])),
            dE00=number(off[i]),
        )
        for i in range(dataset.theta_in.size)
    ]
    return InPlaneMap(
        dataset=opened.entry.id,
        sample=dataset.sample,
        exposure=None if exposure is None else exposure.factor,
        clipped=0 if exposure is None else exposure.clipped,
        difference_model=None if differences is None or opened.shift is None else opened.shift.model,
        cells=cells,
        filled=[] if filled is None else _filled(dataset, filled, exposure, edges),
        not_filled=0 if filled is None else int(np.count_nonzero(~filled.tells)),
        blocked=_blocked(dataset, edges),
        blocked_half_width_deg=BLOCKED_HALF_WIDTH,
    )


def _colours(
    brdf: FloatArray, theta_in: FloatArray, dataset: Dataset, exposure: Exposure | None, has_hue: np.ndarray
) -> tuple[list[str | None], list[str | None]]:
    """Colours as bright as they are, and at one luminance."""
    if exposure is None:
        return [None] * theta_in.size, [None] * theta_in.size
    seen, hues = (shown_colours(brdf, theta_in, dataset.wavelengths, each, has_hue) for each in (exposure, None))
    return seen, hues


def _filled(dataset: Dataset, filled: Filled, exposure: Exposure | None, edges: FloatArray) -> list[FilledCell]:
    f, u = at_nearest(filled, SHOWN_AT)
    seen, hues = _colours(filled.brdf, filled.theta_in, dataset, exposure, f > LEAST_SIGNAL_FOR_HUE * u)
    rows = sorted({(bottom, top) for _, _, bottom, top in edges.tolist()})
    told = np.flatnonzero(filled.tells).tolist()
    # one cell for each that tells anything, in their order
    cells = filled_cells(filled, [""] * f.size, rows)
    return [
        FilledCell(
            theta_in_deg=float(filled.theta_in[i]),
            theta_out_deg=float(filled.theta_out[i]),
            edges=_edges([cell.left, cell.right, cell.bottom, cell.top]),
            by="reciprocity" if filled.by[i] == "reciprocity" else "interpolation",
            colour=seen[i],
            hue=hues[i],
            brdf=number(f[i]),
            u=number(u[i]),
            points=list(filled.points[i]),
        )
        for i, cell in zip(told, cells, strict=True)
    ]


def _blocked(dataset: Dataset, edges: FloatArray) -> list[Edges]:
    """The sectors of all incident angles that nobody saw."""
    groups = incidence_groups(dataset.theta_in, SAME_INCIDENCE)
    found = []
    for g in range(int(groups.max()) + 1):
        angle = float(dataset.theta_in[groups == g].mean())
        if is_hidden(dataset, angle):
            bottom, top = edges[groups == g][0, 2:].tolist()
            found.append(_edges([-angle - BLOCKED_HALF_WIDTH, -angle + BLOCKED_HALF_WIDTH, bottom, top]))
    return found


def _edges(values: list[float]) -> Edges:
    left, right, bottom, top = values
    return Edges(left=left, right=right, bottom=bottom, top=top)
