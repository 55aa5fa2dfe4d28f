"""What a scene asks of its material: directions in which its light meets the material, and what pixels make of it.

A vertex is one way of light from a lamp over the material into a pixel. Every model is evaluated on the same vertices,
so one trace of the scene serves all models and all wavelengths, and the noise of the trace is common to them.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.colour import delta_e_2000, observer, xyz_to_rgb
from analysis.reflectance.directions import Directions
from drivers.arrays import BoolArray, FloatArray

Reflectance = Callable[[Directions, FloatArray], FloatArray]
"""BRDF [vertices, wavelengths], 1/sr, at directions [vertices] and wavelengths, nm."""

DARK = 0.01
"""Y below which a pixel counts as dark, white being 1; at L = 9 a colour difference says little."""

BRIGHT = 99.0
"""Percentile of the target's Y that the exposure maps to 1 where the scene has none of its own."""

_CHUNK = 40_000


@dataclass(frozen=True)
class Vertices:
    """All ways of light into an image; the samples of each pixel fall into two independent halves."""

    rows: int
    columns: int
    pixel: NDArray[np.intp]
    """[vertices] row x columns + column."""
    half: NDArray[np.intp]
    """[vertices] 0 or 1."""
    directions: Directions
    """[vertices]"""
    weight: FloatArray
    """[vertices, components] radiance x cos(theta_in) / density / number of samples of its half and pixel: the sum of
    weight x BRDF over the vertices of a half is the radiance of a pixel."""
    wavelengths: FloatArray
    """[wavelengths] nm, at which the light is given."""
    light: FloatArray
    """[components, wavelengths] spectra of which the light of a vertex is a sum, with `weight`."""
    white: FloatArray
    """[wavelengths] spectrum of what is white: the scene's illuminant."""
    target: BoolArray
    """[pixels] which show the material and nothing else."""
    exposure: float | None
    """By which Y of the white of the illuminant is multiplied; None where the brightest pixels decide."""

    def colour_weights(self, nodes: FloatArray) -> FloatArray:
        """[components, nodes, 3] what turns reflectances at `nodes`, nm, into XYZ; the white has Y = 1.

        Light times observer stays as fine as it is; the reflectance alone is taken as linear between the nodes and as
        constant beyond them.
        """
        cmf = observer(self.wavelengths)
        white = float(self.white @ cmf[:, 1])
        if nodes.size == 1:
            hats = np.ones((1, self.wavelengths.size))
        else:
            hats = np.stack([np.interp(self.wavelengths, nodes, row) for row in np.eye(nodes.size)])
        return np.asarray(np.einsum("kw,nw,wc->knc", self.light, hats, cmf) / white)

    @property
    def white_xyz(self) -> FloatArray:
        """[3] XYZ of the illuminant with Y = 1."""
        xyz = self.white @ observer(self.wavelengths)
        return np.asarray(xyz / xyz[1])


def xyz_of_vertices(vertices: Vertices, reflectance: Reflectance, nodes: FloatArray) -> FloatArray:
    """[vertices, 3] XYZ that each vertex adds to its pixel, for a BRDF that is known at `nodes`, nm."""
    turned = vertices.colour_weights(nodes)
    found = np.empty((vertices.pixel.size, 3))
    for start in range(0, vertices.pixel.size, _CHUNK):
        part = slice(start, start + _CHUNK)
        values = reflectance(Directions(*(cosine[part] for cosine in vertices.directions)), nodes)
        found[part] = np.einsum("vn,vk,knc->vc", values, vertices.weight[part], turned, optimize=True)
    return found


def to_pixels(vertices: Vertices, xyz: FloatArray) -> FloatArray:
    """[2, target pixels, 3] XYZ of the pixels in each half, from that of the vertices [vertices, 3]."""
    count = vertices.rows * vertices.columns
    place = vertices.half * count + vertices.pixel
    sums = np.stack([np.bincount(place, xyz[:, c], 2 * count) for c in range(3)], axis=-1)
    return np.asarray(sums.reshape(2, count, 3)[:, vertices.target])


def image(vertices: Vertices, reflectance: Reflectance, nodes: FloatArray) -> FloatArray:
    """[2, target pixels, 3] XYZ of the material in each half of the samples."""
    return to_pixels(vertices, xyz_of_vertices(vertices, reflectance, nodes))


@dataclass(frozen=True)
class Display:
    """How an image is shown: one exposure, and white where the illuminant is."""

    exposure: float
    white: FloatArray
    """[3] XYZ of the illuminant with Y = 1."""

    def shown(self, xyz: FloatArray) -> FloatArray:
        """[..., 3] linear BT.709, clipped to what a display shows, of XYZ [..., 3]; the illuminant becomes D65."""
        d65 = observer_white()
        return np.clip(xyz_to_rgb(xyz * self.exposure * (d65 / self.white)), 0.0, 1.0)

    def difference(self, xyz: FloatArray, other: FloatArray) -> FloatArray:
        """[...] CIEDE2000 between what is shown of two XYZ [..., 3]."""
        back = np.linalg.inv(xyz_to_rgb(np.eye(3)))
        return delta_e_2000(self.shown(xyz) @ back, self.shown(other) @ back)


def observer_white() -> FloatArray:
    """[3] XYZ of D65 with Y = 1, for which RGB (1, 1, 1) is white."""
    return np.asarray(np.linalg.solve(xyz_to_rgb(np.eye(3)).T, np.ones(3)))


def display_for(vertices: Vertices, reference: FloatArray) -> Display:
    """The exposure of the scene, or else that which maps the 99th percentile of Y of the `reference` to 1.

    `reference` [target pixels, 3] is the XYZ of the image to which all others are compared.
    """
    exposure = vertices.exposure
    if exposure is None:
        bright = float(np.percentile(reference[:, 1], BRIGHT))
        exposure = 1 / bright if bright > 0 else 1.0
    return Display(exposure, vertices.white_xyz)
