"""The same rays on the same triangles by Embree, an independent tracer: single precision, a hierarchy of boxes."""

import time
from typing import NamedTuple

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene

from drivers.arrays import FloatArray
from simulators.topographies.heights import HeightField

CLEARANCE = 1e-3
"""How far off its triangle a reflected ray starts, pitches: Embree would find the triangle again."""


class Traced(NamedTuple):
    """What Embree found."""

    escaped: np.ndarray
    """[limit + 1] rays that escaped after 0, 1, 2, ... reflections."""
    lost: int
    """Rays that left through the side, below the highest point."""
    inside: float
    """Processor time within Embree, s."""
    whole: float
    """Processor time of all, reflecting in NumPy included, s."""


def triangles(field: HeightField) -> FloatArray:
    """[triangles, 3 corners, 3] of a patch that is not periodic, pitches, its centre at x = y = 0."""
    heights = field.heights_um / field.pitch_um
    y, x = np.indices(heights.shape, dtype=float)
    points = np.stack([x - (x.max() / 2), y - (y.max() / 2), heights], axis=-1)
    corner = points[:-1, :-1], points[:-1, 1:], points[1:, 1:], points[1:, :-1]
    lower = np.stack([corner[0], corner[1], corner[2]], axis=-2)
    upper = np.stack([corner[0], corner[2], corner[3]], axis=-2)
    return np.stack([lower, upper], axis=2).reshape(-1, 3, 3)


def embree(field: HeightField, origins_um: FloatArray, directions: FloatArray, limit: int) -> Traced:
    """Trace rays over a patch that is not periodic."""
    faces = triangles(field)
    normal = np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    scene = EmbreeScene()
    TriangleMesh(scene, faces.astype(np.float32))
    ny, nx = field.heights_um.shape
    extent = np.array([nx - 1, ny - 1]) / 2
    top = field.heights_um.max() / field.pitch_um
    origin = origins_um / field.pitch_um - np.append(extent, 0.0)
    origin[:, 2] += CLEARANCE
    direction = np.array(directions)
    scene.run(origin[:1].astype(np.float32), direction[:1].astype(np.float32))  # builds the hierarchy
    escaped, lost, inside = np.zeros(limit + 1, dtype=int), 0, 0.0
    begin = time.process_time()
    for count in range(limit + 1):
        started = time.process_time()
        found = scene.run(origin.astype(np.float32), direction.astype(np.float32))
        inside += time.process_time() - started
        out = found < 0
        flat = direction[out, :2] == 0  # never reaches that side
        aside = np.where(flat, 1.0, direction[out, :2])
        to_side = np.where(flat, np.inf, (np.sign(aside) * extent - origin[out, :2]) / aside).min(axis=1)
        to_top = (top - origin[out, 2]) / direction[out, 2]
        below = (direction[out, 2] <= 0) | (to_side < to_top)
        lost += int(below.sum())
        escaped[count] = int((~below).sum())
        origin, direction, found = origin[~out], direction[~out], found[~out]
        if not found.size:
            break
        n, at = normal[found], faces[found, 0]
        along = (direction * n).sum(axis=1, keepdims=True)
        origin = origin + ((at - origin) * n).sum(axis=1, keepdims=True) / along * direction + CLEARANCE * n
        direction = direction - 2 * along * n
    return Traced(escaped, lost, inside, time.process_time() - begin)
