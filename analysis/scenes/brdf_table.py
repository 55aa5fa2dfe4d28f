"""A measured BRDF as a table over the half vector, for directions out of the plane in which it was measured.

An isotropic surface of microfacets has f = V(i, o) Q(theta_h, theta_d): V the visibility, Smith's masking over
4 cos_i cos_o, and Q what light a facet reflects. A direction out of the plane takes Q from the one in the plane with
the same theta_h and theta_d, theta_in = theta_d + theta_h and theta_out = theta_d - theta_h (Rusinkiewicz 1998). A
surface that scatters below it as well has no such Q: in the place of V stands what a model without shift, fitted to it,
gives for i and o, and Q is by how much the measurement differs. Where the two angles exceed a right angle there is no
such direction: the table then continues with its last value, and what a scene asks of it there is said to be not
measurable (`analysis.scenes.asked`).
"""

import math
from dataclasses import dataclass

import numpy as np

from analysis.colour import COLOUR_RANGE, xyz_weights
from analysis.reflectance.directions import Directions, in_plane, round_aperture, through_aperture
from analysis.reflectance.distributions import lobe, ndf
from analysis.scenes.brdf_draws import DARKEST, DRAWS, drawn_errors
from analysis.scenes.vertices import Reflectance
from drivers.arrays import FloatArray
from goniometer.datasets.between import interpolate
from goniometer.datasets.dataset import Dataset
from goniometer.geometry import LARGEST_ANGLE

ROWS, COLUMNS = 72, 31
"""Nodes in theta_h, dense in the lobe, and in theta_d."""


@dataclass(frozen=True)
class BrdfTable:
    """ln Q at nodes, between which it is linear."""

    theta_h: FloatArray
    """[rows] degrees, ascending from 0."""
    theta_d: FloatArray
    """[columns] degrees, ascending from 0, even."""
    wavelengths: FloatArray
    """[wavelengths] nm."""
    log_q: FloatArray
    """[rows, columns, wavelengths]"""
    guide: Reflectance
    """What the BRDF is Q times of: a visibility, or a model."""

    def __call__(self, directions: Directions, wavelengths: FloatArray) -> FloatArray:
        """BRDF [vertices, wavelengths], 1/sr; linear between the table's wavelengths, constant beyond them."""
        place = between_nodes(self, directions)
        upper = np.clip(np.searchsorted(self.wavelengths, wavelengths), 1, self.wavelengths.size - 1)
        step = self.wavelengths[upper] - self.wavelengths[upper - 1]
        part = np.clip((wavelengths - self.wavelengths[upper - 1]) / step, 0, 1)
        at = self.log_q[..., upper - 1] * (1 - part) + self.log_q[..., upper] * part
        above = (directions.cos_i > 0) & (directions.cos_o > 0)
        return np.asarray(above[:, None] * self.guide(directions, wavelengths) * np.exp(at_nodes(at, place)))


@dataclass(frozen=True)
class Reference:
    """What a scene would look like by the measurement, and what the measurement does not know of it."""

    table: BrdfTable
    draws: FloatArray
    """[draws, rows, columns, 3] errors of ln X, ln Y and ln Z that are as probable as the measurement's uncertainty
    says."""


@dataclass(frozen=True)
class Visibility:
    """Smith's masking of GGX over 4 cos_i cos_o, the guide of a metal."""

    alpha: float

    def __call__(self, directions: Directions, wavelengths: FloatArray) -> FloatArray:
        """[vertices, wavelengths], 1/sr."""
        masking = lobe(directions, self.alpha) / ndf(np.maximum(directions.cos_m, 1e-3), self.alpha)
        return np.broadcast_to(masking[:, None], (masking.size, wavelengths.size))


Place = tuple[FloatArray, FloatArray]
"""Fractional row and column, [vertices] each."""


def between_nodes(table: BrdfTable, directions: Directions) -> Place:
    """Where directions lie in a table."""
    theta_h = np.degrees(np.arccos(np.clip(directions.cos_m, 0, 1)))
    theta_d = np.degrees(np.arccos(np.clip(directions.cos_d, 0, 1)))
    row = np.interp(theta_h, table.theta_h, np.arange(table.theta_h.size))
    return row, np.asarray(theta_d / table.theta_d[-1] * (table.theta_d.size - 1))


def at_nodes(values: FloatArray, place: Place) -> FloatArray:
    """Bilinear [vertices, ...] of values [rows, columns, ...]."""
    row = np.minimum(place[0].astype(int), values.shape[0] - 2)
    column = np.minimum(place[1].astype(int), values.shape[1] - 2)
    flat = values.reshape(values.shape[0] * values.shape[1], -1)
    r, c = (place[0] - row)[:, None], (place[1] - column)[:, None]
    first = row * values.shape[1] + column
    below = flat[first] * (1 - c) + flat[first + 1] * c
    above = flat[first + values.shape[1]] * (1 - c) + flat[first + values.shape[1] + 1] * c
    return np.asarray(below * (1 - r) + above * r).reshape(len(row), *values.shape[2:])


def reference_table(dataset: Dataset, alpha: float, guides: tuple[Reflectance, ...] = (), seed: int = 1) -> Reference:
    """The BRDF that a dataset measured, read between its points by the process that interpolates it.

    `alpha` is about the roughness: the table is dense in such a lobe. `guides` are models of what scatters below its
    surface, too, of which the one is taken that the measured points differ from most evenly; without any it is a metal.
    What the aperture did to the BRDF is undone as for the guide, or GGX. Raises `CalibrationError` for too few points,
    and `OutOfRange` for wavelengths that a colour cannot be told from.
    """
    xyz_weights(dataset.wavelengths)  # which refuses those without a colour
    seen = _visible(dataset)
    theta_h, theta_d = table_nodes(alpha)
    in_angle, out_angle = folded(*(grid.ravel() for grid in np.meshgrid(theta_h, theta_d, indexing="ij")))
    read = interpolate(seen, in_angle, out_angle)
    brdf = np.maximum(read.brdf, DARKEST)
    guide = _most_even(seen, guides) if guides else None
    if dataset.aperture > 0:
        brdf = brdf * _sharper(in_angle, out_angle, seen, alpha, guide)
    form = guide or Visibility(alpha)
    log_q = np.log(brdf / np.maximum(form(in_plane(in_angle, out_angle), seen.wavelengths), DARKEST))
    shape = (theta_h.size, theta_d.size)
    table = BrdfTable(theta_h, theta_d, seen.wavelengths, log_q.reshape(*shape, -1), form)
    return Reference(table, drawn_errors(seen, read, seed).reshape(DRAWS, *shape, 3))


def _most_even(dataset: Dataset, guides: tuple[Reflectance, ...]) -> Reflectance:
    """The guide to which the ratio of the measured BRDF, one number for each direction, varies least."""
    usable = np.flatnonzero(dataset.usable)
    directions = in_plane(dataset.theta_in[usable], dataset.theta_out[usable])
    measured = np.maximum(np.nan_to_num(dataset.brdf[usable]), 0.0).mean(axis=1)

    def unevenness(guide: Reflectance) -> float:
        of_guide = guide(directions, dataset.wavelengths).mean(axis=1)
        return float(np.std(np.log(np.maximum(measured, DARKEST) / of_guide)))

    return min(guides, key=unevenness)


def _sharper(
    theta_in: FloatArray, theta_out: FloatArray, dataset: Dataset, alpha: float, guide: Reflectance | None
) -> FloatArray:
    """[points, wavelengths or 1] by how much a direction is brighter than its mean over the aperture."""
    aperture = round_aperture(dataset.aperture, rings=12, spokes=24)
    through, centre = through_aperture(theta_in, theta_out, aperture), in_plane(theta_in, theta_out)
    if guide is None:
        return np.asarray((lobe(centre, alpha) / (lobe(through, alpha) @ aperture.weights))[:, None])
    middle = dataset.wavelengths[[dataset.wavelengths.size // 2]]
    flat = Directions(*(np.broadcast_to(cosine, through.cos_o.shape).ravel() for cosine in through))
    mean = guide(flat, middle).reshape(through.cos_o.shape) @ aperture.weights
    return np.asarray(guide(centre, middle) / np.maximum(mean, DARKEST)[:, None])


def folded(theta_h: FloatArray, theta_d: FloatArray) -> tuple[FloatArray, FloatArray]:
    """theta_in and theta_out, degrees, of the direction in the plane with these angles; the nearest where none has.

    >>> [angles.tolist() for angles in folded(np.array([10.0, 40.0]), np.array([30.0, 70.0]))]
    [[40.0, 85.0], [20.0, 5.0]]
    """
    h = np.minimum(theta_h, LARGEST_ANGLE)
    d = np.minimum(theta_d, LARGEST_ANGLE - h)
    return h + d, d - h


def table_nodes(alpha: float) -> tuple[FloatArray, FloatArray]:
    """theta_h [rows] and theta_d [columns] of a table for a lobe of about this roughness, degrees."""
    width = max(math.degrees(math.atan(alpha)), 0.25)
    warped = np.linspace(0, np.arcsinh(90 / width), ROWS)
    theta_h = width * np.sinh(warped)
    theta_h[-1] = 90.0
    return theta_h, np.linspace(0, 90, COLUMNS)


def _visible(dataset: Dataset) -> Dataset:
    """The dataset at the wavelengths that make a colour, and at points that have all of them."""
    first = int(np.searchsorted(dataset.wavelengths, COLOUR_RANGE[0], side="right")) - 1
    bands = np.arange(first, int(np.searchsorted(dataset.wavelengths, COLOUR_RANGE[1])) + 1)
    # some of a fine grid: reflectances are smooth, and light and observer are not thinned
    stride = max(1, int(10.0 / np.median(np.diff(dataset.wavelengths[bands]))))
    bands = np.union1d(bands[::stride], bands[-1:])
    return dataset.at_wavelengths(bands)
