"""Surface topographies as height maps: levelling, filling, and their roughness after ISO 25178-2.

Between its points a height map is the surface of triangles that rays meet: each cell of the grid is cut in two along
the diagonal from its lowest indices to its highest. Slopes and areas here are those of the triangles.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy

from drivers.arrays import FloatArray
from simulators.errors import UnfitTopography

FALLEN_TO = 0.2
"""Autocorrelation at which the autocorrelation length is read (ISO 25178-2, default of Sal)."""


@dataclass(frozen=True)
class HeightField:
    """A topography on a square grid. Raises `UnfitTopography` unless it is one."""

    heights_um: FloatArray
    """[y, x] height of each grid point, um; NaN where nothing was measured."""
    pitch_um: float
    """Distance of neighbouring points along x and along y, um."""
    periodic: bool
    """Whether the first row and column follow the last ones, one pitch on, as in an endless surface of equal tiles."""

    def __post_init__(self) -> None:
        if self.heights_um.ndim != 2 or min(self.heights_um.shape) < 2:
            raise UnfitTopography(
                f"A topography has at least 2 x 2 heights, but this one has the shape {self.heights_um.shape}."
            )
        if not (np.isfinite(self.pitch_um) and self.pitch_um > 0):
            raise UnfitTopography(f"The pitch of a topography is a positive length, not {self.pitch_um:g} um.")
        if np.isinf(self.heights_um).any():
            raise UnfitTopography("A topography has an infinite height; mark what was not measured as NaN.")


@dataclass(frozen=True)
class Roughness:
    """Parameters of ISO 25178-2 of a surface as it is, without any filter: level it first."""

    sq_um: float
    """Sq, root mean square height about the mean, um."""
    sdq: float
    """Sdq, root mean square gradient of the triangles, a pure number."""
    sdr: float
    """Sdr, by how much the area of the triangles exceeds the area below them, as a fraction of the latter."""
    sal_um: float
    """Sal, autocorrelation length, um: the shortest way on which the autocorrelation falls to 0.2; NaN if it does not
    do so within half the patch, as on a flat surface."""


def complete(field: HeightField) -> FloatArray:
    """[y, x] heights, um; raises `UnfitTopography` where some are missing."""
    missing = int(np.isnan(field.heights_um).sum())
    if missing:
        raise UnfitTopography(f"The topography lacks {missing} of its {field.heights_um.size} heights; fill it first.")
    return field.heights_um


def levelled(field: HeightField) -> HeightField:
    """Without its mean and, unless it is periodic, without its least-squares plane; missing heights stay missing.

    Raises `UnfitTopography` where fewer than three heights are known.
    """
    heights = field.heights_um
    measured = ~np.isnan(heights)
    if measured.sum() < 3:
        raise UnfitTopography(f"The topography has {measured.sum()} heights, but three are needed to level it.")
    if field.periodic:
        return replace(field, heights_um=heights - heights[measured].mean())
    y, x = (np.linspace(-1, 1, count) for count in heights.shape)
    plane = np.stack(np.broadcast_arrays(1.0, x[None, :], y[:, None]), axis=-1)
    coefficients = np.linalg.lstsq(plane[measured], heights[measured], rcond=None)[0]
    return replace(field, heights_um=heights - plane @ coefficients)


def filled(field: HeightField) -> HeightField:
    """With missing heights as a membrane that is held by their neighbours: each is the mean of the four around it.

    That adds no hill or dale of its own, and across the edge of a patch that is not periodic it has no slope. Raises
    `UnfitTopography` if nothing was measured.
    """
    heights = field.heights_um
    missing = np.isnan(heights)
    if missing.all():
        raise UnfitTopography("The topography has no heights at all; nothing holds what is to be filled.")
    unknown = np.flatnonzero(missing)
    if not unknown.size:
        return field
    number = np.full(heights.size, -1)
    number[unknown] = np.arange(unknown.size)
    row, column = np.unravel_index(unknown, heights.shape)
    diagonal, right = np.zeros(unknown.size), np.zeros(unknown.size)
    off: list[tuple[np.ndarray, np.ndarray]] = []
    for down, along in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        y, x = row + down, column + along
        inside = field.periodic | ((y >= 0) & (y < heights.shape[0]) & (x >= 0) & (x < heights.shape[1]))
        neighbour = np.ravel_multi_index((y, x), heights.shape, mode="wrap")
        diagonal += inside
        coupled = inside & missing.ravel()[neighbour]
        off.append((np.flatnonzero(coupled), number[neighbour[coupled]]))
        held = inside & ~coupled
        right[held] += heights.ravel()[neighbour[held]]
    rows, columns = (np.concatenate(parts) for parts in zip(*off, strict=True))
    coupling = scipy.sparse.csc_array((np.ones(rows.size), (rows, columns)), shape=(unknown.size, unknown.size))
    membrane = scipy.sparse.csc_array(scipy.sparse.diags_array(diagonal) - coupling)
    whole = heights.ravel().copy()
    whole[unknown] = scipy.sparse.linalg.spsolve(membrane, right)
    return replace(field, heights_um=whole.reshape(heights.shape))


def around(field: HeightField) -> FloatArray:
    """[cells + 1 along y, cells + 1 along x] heights at the corners of all cells, um: a periodic one closes on itself.

    Raises `UnfitTopography` where heights are missing.
    """
    heights = complete(field)
    return np.pad(heights, ((0, 1), (0, 1)), mode="wrap") if field.periodic else heights


def slopes(field: HeightField) -> FloatArray:
    """[cells along y, cells along x, 2 triangles, (dz/dx, dz/dy)] slopes of the triangles, pure numbers.

    The first triangle of a cell is the one that has two corners in the row of lower index. Raises `UnfitTopography`
    where heights are missing.
    """
    corner = around(field)
    along_x, along_y = np.diff(corner, axis=1), np.diff(corner, axis=0)
    lower = np.stack([along_x[:-1], along_y[:, 1:]], axis=-1)
    upper = np.stack([along_x[1:], along_y[:, :-1]], axis=-1)
    return np.stack([lower, upper], axis=2) / field.pitch_um


def roughness(field: HeightField) -> Roughness:
    """Of the surface as it is; raises `UnfitTopography` where heights are missing."""
    steepness = (slopes(field) ** 2).sum(axis=-1)
    return Roughness(
        sq_um=float(np.std(complete(field))),
        sdq=float(np.sqrt(steepness.mean())),
        sdr=float(np.sqrt(1 + steepness).mean() - 1),
        sal_um=_autocorrelation_length(field),
    )


def every_second(field: HeightField) -> HeightField:
    """Every second point along x and along y: what the same surface tells on a grid of twice the pitch."""
    heights = field.heights_um[::2, ::2]
    even = not any(count % 2 for count in field.heights_um.shape)
    return HeightField(heights, 2 * field.pitch_um, field.periodic and even)


def quarters(field: HeightField) -> list[HeightField]:
    """The four patches of half the width and height, none of which is periodic."""
    rows, columns = (count // 2 for count in field.heights_um.shape)
    return [
        HeightField(field.heights_um[y : y + rows, x : x + columns], field.pitch_um, False)
        for y in (0, rows)
        for x in (0, columns)
    ]


def autocorrelation(field: HeightField) -> FloatArray:
    """[y, x] of the heights about their mean, one at lag zero, which is in the middle: at [ny // 2, nx // 2].

    Of a periodic patch that around it; of another that of the overlap of the patch with itself (ISO 25178-2, Sal).
    Lags go up to half the patch. NaN everywhere if the surface is flat. Raises `UnfitTopography` where heights are
    missing.
    """
    heights = complete(field)
    shape = heights.shape
    centred = heights - heights.mean()
    variance = float((centred**2).mean())
    if variance == 0:
        return np.full(shape, np.nan)
    size = shape if field.periodic else (2 * shape[0], 2 * shape[1])
    power = np.abs(np.fft.rfft2(centred, size)) ** 2
    products = np.fft.fftshift(np.fft.irfft2(power, size))
    if field.periodic:
        return products / (heights.size * variance)
    first = [s - s // 2 for s in shape]
    overlap = [s - np.abs(np.arange(s) - s // 2) for s in shape]
    inner = products[first[0] : first[0] + shape[0], first[1] : first[1] + shape[1]]
    return np.asarray(inner / (overlap[0][:, None] * overlap[1] * variance))


def _autocorrelation_length(field: HeightField) -> float:
    """um; read by linear interpolation along 180 directions, a quarter of a pitch apart."""
    correlation = autocorrelation(field)
    middle = [count // 2 for count in correlation.shape]
    lags = np.arange(0, min(middle) - 1 + 1e-9, 0.25)
    angle = np.pi * np.arange(180) / 180
    places = np.stack([middle[0] + np.outer(np.sin(angle), lags), middle[1] + np.outer(np.cos(angle), lags)])
    along = scipy.ndimage.map_coordinates(correlation, places, order=1)
    fallen = along <= FALLEN_TO
    direction = np.flatnonzero(fallen.any(axis=1))
    if not direction.size:
        return float("nan")
    after = np.argmax(fallen[direction], axis=1)
    above, below = along[direction, after - 1], along[direction, after]
    crossing = lags[after] - 0.25 * (FALLEN_TO - below) / (above - below)
    return float(crossing.min() * field.pitch_um)
