"""Which directions a scene asks of its material, and which of them a goniometer in the plane can measure."""

from dataclasses import dataclass

import numpy as np

from analysis.errors import SceneError
from analysis.scenes.brdf_table import folded
from analysis.scenes.vertices import Display, Vertices
from drivers.arrays import FloatArray
from goniometer.campaigns.scene_weights import SceneWeights, weights_on_nodes
from goniometer.geometry import BLOCKED_HALF_WIDTH, LARGEST_ANGLE

CELL = 5.0
"""Side of a cell in theta_in and theta_out, degrees."""

CARRIED = 0.95
"""Share of the weight that the fewest cells carry together."""

_STEP = 0.01


@dataclass(frozen=True)
class Asked:
    """What a scene asks; shares of its colour weight."""

    theta_h: FloatArray
    """[vertices] half vector to normal, degrees."""
    theta_d: FloatArray
    """[vertices] incident direction to half vector, degrees."""
    weight: FloatArray
    """[vertices] change of the image's mean dE00 by a relative change of the BRDF there alone."""
    cells: int
    """Cells of `CELL` degrees that carry `CARRIED` of what can be measured."""
    all_cells: int
    """That there are."""
    out_of_plane: float
    """Share with theta_h + theta_d > 90 degrees, which no direction in the plane stands for."""
    grazing: float
    """Share beyond the largest angle of the bench besides."""
    blocked: float
    """Share where the detector would stand in the light, which only the process between its edges can tell."""

    @property
    def measurable(self) -> float:
        """Share of the weight that falls where the bench can measure."""
        return 1 - self.out_of_plane - self.grazing - self.blocked

    @property
    def colour_slope(self) -> float:
        """Mean dE00 of the image where the BRDF is off by the same factor everywhere, by that factor's logarithm."""
        return float(self.weight.sum())


def asked(vertices: Vertices, xyz: FloatArray, display: Display) -> Asked:
    """What a scene asks; `xyz` [vertices, 3] is what the measurement gives each vertex.

    A vertex weighs by its share of the luminance of its pixel, times how much a relative change of the pixel shows: no
    more where the display clips.
    """
    count = vertices.rows * vertices.columns
    pixels = np.stack([np.bincount(vertices.pixel, xyz[:, c], count) for c in range(3)], axis=-1) / 2
    visible = display.difference(pixels, pixels * (1 + _STEP)) / _STEP / vertices.target.sum()
    share = xyz[:, 1] / 2 / np.maximum(pixels[vertices.pixel, 1], 1e-300)
    weight = share * visible[vertices.pixel]
    cosines = vertices.directions
    theta_h, theta_d = (np.degrees(np.arccos(np.clip(c, 0, 1))) for c in (cosines.cos_m, cosines.cos_d))
    total = max(float(weight.sum()), 1e-300)
    outside, far = theta_h + theta_d > 90, theta_h + theta_d > LARGEST_ANGLE
    near = 2 * theta_d < BLOCKED_HALF_WIDTH
    here = ~far & ~near
    theta_in, theta_out = folded(theta_h[here], theta_d[here])
    across = round(90 / CELL)
    place = (theta_in // CELL).astype(int) * 2 * across + ((theta_out + 90) // CELL).astype(int)
    sums = np.sort(np.bincount(place, weight[here], across * 2 * across))[::-1]
    enough = int(np.searchsorted(np.cumsum(sums), CARRIED * sums.sum())) + 1
    # of every pair that reciprocity makes one, theta_in is the larger angle
    possible = sum(2 * i + 1 for i in range(across))
    return Asked(
        theta_h,
        theta_d,
        weight,
        enough if here.any() else 0,
        possible,
        float(weight[outside].sum() / total),
        float(weight[far & ~outside].sum() / total),
        float(weight[near & ~far].sum() / total),
    )


def scene_weights(found: Asked, scene: str) -> SceneWeights:
    """What a scene asks for, as a campaign takes it; raises `SceneError` where nothing of it can be measured."""
    far = found.theta_h + found.theta_d > LARGEST_ANGLE
    here = ~far & (2 * found.theta_d >= BLOCKED_HALF_WIDTH)
    if not found.weight[here].sum() > 0:
        raise SceneError("The scene asks for no direction that can be measured in the plane.")
    table = weights_on_nodes(found.theta_h[here], found.theta_d[here], found.weight[here])
    rows = tuple(tuple(round(float(value), 8) for value in row) for row in table)
    return SceneWeights(scene=scene, colour_slope=found.colour_slope, weights=rows)
