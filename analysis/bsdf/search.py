"""The smallest tables of a `.bsdf` file that keep an error budget: how many wavelengths, angles and nodes, and where.

Wavelength nodes and the nodes of directions are sought one after the other, because the tables are linear in both: half
of the budget is for the wavelengths, and the directions get what these leave of it in each direction. From a coarse
grid on, whichever of theta_i and the square gains more accuracy for its bytes gets more nodes until the error is small
enough; then nodes are taken away again where that does no harm.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from analysis.bsdf.error import FAINTEST, Probe, probe, read_back
from analysis.bsdf.fields import Grid, bsdf_fields, fine_lobe_table, size_of
from analysis.bsdf.measured_bsdf import read_bsdf
from analysis.bsdf.rendered_model import RenderedModel
from analysis.bsdf.tensor_file import encode
from analysis.choices import USUAL_COLOUR_ERROR, USUAL_ERROR
from drivers.arrays import FloatArray

INCIDENT_NODES = (6, 8, 10, 12, 14, 16, 18, 20, 24, 28, 32, 40, 48, 64, 80, 96)
TABLE_NODES = (8, 12, 16, 20, 24, 28, 32, 36, 40, 48, 56, 64, 72, 80, 96, 112, 128, 160)
"""Numbers of nodes that are tried."""

LARGEST_SIZE = 64_000_000
"""Bytes beyond which no file is written, however small the budget."""

_FINE_NODES = 189
_SHARE_OF_WAVELENGTHS = 0.5
_SHARE_OF_LOBE = 0.1
_FEW_PAIRS = 16
_FEW_WAVELENGTHS = 4


@dataclass(frozen=True)
class Budget:
    """How far a file may be from its model."""

    error: float = USUAL_ERROR
    """99th percentile over directions of the relative error, the worst of all wavelengths for each."""
    colour: float = USUAL_COLOUR_ERROR
    """99th percentile of CIEDE2000 with brightness; 1 is about what an eye can tell."""


USUAL_BUDGET = Budget()


class Layout(NamedTuple):
    """Where the nodes of a table are, and what it holds; see `Grid`."""

    share: float
    whole: bool


def wavelength_nodes(model: RenderedModel, budget: Budget) -> tuple[FloatArray, FloatArray]:
    """Few wavelengths, nm, between which a linear table keeps half of the budget, and what they spend of it.

    The latter is the relative error [pairs] at the pairs of `probe`, the worst of all wavelengths. Nodes are added
    where the error is largest, and those that proved needless are taken out again.
    """
    fine = np.linspace(*model.wavelengths, _FINE_NODES)
    everything = probe(model, fine)
    few = slice(None, None, _FEW_PAIRS)
    at = Probe(everything.incident[few], everything.reflected[few], fine, everything.exact[few])

    def between(nodes: list[int]) -> FloatArray:
        return np.stack([np.interp(fine, fine[nodes], row) for row in np.eye(len(nodes))])

    def judged(nodes: list[int]) -> tuple[bool, FloatArray]:
        table = at.exact[:, nodes] @ between(nodes)
        error, colour = at.relative(table).p99, float(np.percentile(at.colours(table), 99))
        within = error <= _SHARE_OF_WAVELENGTHS * budget.error and colour <= _SHARE_OF_WAVELENGTHS * budget.colour
        return within, at.spread(table).max(axis=0)

    nodes = [0, fine.size - 1]
    while not (state := judged(nodes))[0] and len(nodes) < fine.size:
        missing = np.setdiff1d(np.arange(fine.size), nodes)
        nodes = sorted([*nodes, int(missing[np.argmax(state[1][missing])])])
    for node in nodes[1:-1]:
        fewer = [other for other in nodes if other != node]
        if judged(fewer)[0]:
            nodes = fewer
    spent = everything.spread(everything.exact[:, nodes] @ between(nodes)).max(axis=1)
    return fine[nodes], np.asarray(spent)


def lobe_for(model: RenderedModel, wavelengths: FloatArray, budget: Budget) -> FloatArray:
    """The table ndf of a file with so small an error that the other tables may have the budget."""
    tolerance = _SHARE_OF_LOBE * budget.error
    return fine_lobe_table(model.reflectance, model.alpha, wavelengths, model.base, tolerance, 4 * FAINTEST)


def smallest_grid(
    model: RenderedModel,
    wavelengths: FloatArray,
    lobe: FloatArray,
    layout: Layout,
    spent: FloatArray,
    target: float,
    limit: int = LARGEST_SIZE,
) -> tuple[Grid, bool]:
    """The grid of the smallest tables whose 99th percentile of the relative error is below `target`, and whether it is.

    `spent` [pairs] as of `wavelength_nodes` adds to the error. Where no grid of less than `limit` bytes is good enough,
    it is the best of those that were tried.
    """
    few = wavelengths[np.unique(np.linspace(0, wavelengths.size - 1, _FEW_WAVELENGTHS).round().astype(int))]
    at = probe(model, few)
    known: dict[tuple[int, int], float] = {}

    def grid(place: tuple[int, int]) -> Grid:
        return Grid(INCIDENT_NODES[place[0]], TABLE_NODES[place[1]], layout.share, layout.whole)

    def size(place: tuple[int, int]) -> int:
        return size_of(grid(place), wavelengths.size, lobe.size)

    def error(place: tuple[int, int]) -> float:
        if place not in known:
            fields = bsdf_fields(model.reflectance, model.alpha, few, grid(place), lobe)
            worst = at.spread(read_back(read_bsdf(encode(fields)), at)).max(axis=-1)
            known[place] = float(np.percentile(worst + spent, 99))
        return known[place]

    def more(place: tuple[int, int]) -> list[tuple[int, int]]:
        steps = [(place[0] + 1, place[1]), (place[0], place[1] + 1)]
        return [
            step
            for step in steps
            if step[0] < len(INCIDENT_NODES) and step[1] < len(TABLE_NODES) and size(step) <= limit
        ]

    here = (2, 2)
    while error(here) > target and (steps := more(here)):
        gains = {step: math.log(error(here) / error(step)) / math.log(size(step) / size(here)) for step in steps}
        here = max(steps, key=lambda step: gains[step])
    if error(here) > target:
        return grid(min(known, key=lambda place: known[place])), False
    while fewer := [
        step for step in ((here[0] - 1, here[1]), (here[0], here[1] - 1)) if min(step) >= 0 and error(step) <= target
    ]:
        here = min(fewer, key=size)
    return grid(here), True
