"""What the measured directions beside the blocked sector say of what lies in it."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from drivers.arrays import FloatArray
from goniometer.datasets.angular import SAME_PLANNED_INCIDENCE
from goniometer.datasets.dataset import Dataset
from goniometer.geometry import BLOCKED_HALF_WIDTH, LARGEST_ANGLE, Geometry
from goniometer.interpolation.interpolant import Interpolant, Shape, predict_values

BESIDE = 1.5
"""Degrees from the sector's edge over which its slope is taken."""

_STAGES = 0.2
"""Degrees by which a point beside the sector may seem to stand in it."""

_EDGES = np.array([-1, -1, 1, 1]) * BLOCKED_HALF_WIDTH + np.array([-1, 0, 0, 1]) * BESIDE


def is_hidden(dataset: Dataset, theta_in: float) -> bool:
    """Whether nobody saw the sector of an incident angle, degrees; a simulation sees it, and so may other benches."""
    if dataset.simulated:
        return False
    inside = np.abs(dataset.theta_in + dataset.theta_out) < BLOCKED_HALF_WIDTH - _STAGES
    return not np.any(inside & (np.abs(dataset.theta_in - theta_in) < SAME_PLANNED_INCIDENCE))


def edges(incident: FloatArray) -> tuple[FloatArray, FloatArray]:
    """theta_in and theta_out [4 incident angles], degrees, of both edges of each sector and of directions beside.

    As far as `LARGEST_ANGLE`, where they meet.
    """
    theta_out = np.clip(_EDGES - incident[:, None], -LARGEST_ANGLE, LARGEST_ANGLE)
    return np.repeat(incident, _EDGES.size), theta_out.ravel()


def rise(shape: Shape, theta_in: FloatArray, theta_out: FloatArray, level: FloatArray) -> FloatArray:
    """[incident angles] how steeply ln f rises to the sector beyond what the lobes explain, per degree; not below zero.

    `level` is cos(theta_in) f, 1/sr, at the `edges`. A retro-reflection that was fitted explains nothing, for its peak
    is in the sector.
    """
    lobe = replace(shape.lobe, log_retro=-np.inf)
    excess = np.log(shape.offset + level) - np.log(shape.offset + lobe.cosine_brdf(theta_in, theta_out))
    steps = np.abs(np.diff(theta_out.reshape(-1, _EDGES.size)[:, [0, 1, 3, 2]]))[:, ::2]
    risen = np.diff(excess.reshape(-1, _EDGES.size)[:, [0, 1, 3, 2]])[:, ::2]
    known = steps > BESIDE / 2
    slopes = np.where(known, risen / np.where(known, steps, 1.0), 0.0)
    return np.asarray(np.maximum(slopes.sum(axis=1) / np.maximum(known.sum(axis=1), 1), 0.0))


def unseen(steepness: FloatArray, theta_in: FloatArray, theta_out: FloatArray) -> FloatArray:
    """[directions] standard uncertainty of ln f by what nobody sees in the sector; zero outside of it.

    Nothing in it is assumed to be steeper than at its edges: the truth lies between nothing and a rise on to the
    middle with the `steepness` [directions] of `rise`, a rectangular distribution of that half width.
    """
    inside = np.maximum(BLOCKED_HALF_WIDTH - np.abs(theta_in + theta_out), 0.0)
    return np.asarray(steepness * inside / np.sqrt(3))


def beside(
    process: Interpolant, incident: Sequence[float], tolerance: float, visited: Sequence[Geometry]
) -> list[Geometry]:
    """Directions beside the sectors of `incident` angles, degrees, that may hide more than the tolerance.

    They tell how steep the edge is; none of them is nearer to a `visited` one than half of its way from the edge. The
    `tolerance` is an error of ln(1 + cos(theta_in) f). Where the sector hides the mirror direction, the other incident
    angles show the lobe.
    """
    angles = np.array(incident)
    theta_in, theta_out = edges(angles)
    level = predict_values(process, theta_in, theta_out)[0].mean(axis=1)
    hidden = unseen(rise(process.shape, theta_in, theta_out, level), angles, -angles)
    edge = level.reshape(-1, _EDGES.size)[:, 1:3].max(axis=1)
    doubtful = (hidden * edge / (1 + edge) > tolerance) & (2 * angles >= BLOCKED_HALF_WIDTH)
    sides = theta_out.reshape(-1, _EDGES.size)[:, [0, -1]]
    wanted = [Geometry(incident[i], float(a)) for i in np.flatnonzero(doubtful).tolist() for a in sides[i]]
    return [
        g
        for g in wanted
        if not g.blocked
        and not any(g.theta_in == v.theta_in and abs(g.theta_out - v.theta_out) < BESIDE / 2 for v in visited)
    ]
