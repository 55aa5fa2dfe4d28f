"""Geometric optics on a topography: rays over its triangles, and a gonioreflectometer that collects them (Fig. 11).

Each triangle is a perfect mirror; a ray is reflected until it leaves the surface, as often as that takes (paper,
section 3.5). The reflectance of each reflection is a weight on the ray, at all wavelengths at once. No ray is dropped:
each one escapes, is lost through the side of a patch that is not periodic, or is stopped at the limit of reflections,
and the three shares add up to one.
"""

from collections.abc import Iterator
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from drivers.arrays import BoolArray, CountArray, FloatArray
from simulators.errors import UnfitRays
from simulators.materials.surfaces import Reflectance
from simulators.topographies.heights import HeightField, around

LIMIT = 32
"""Reflections after which a path is given up, unless said otherwise."""

ORDERS = 4
"""How finely a virtual measurement is decomposed: by one, two, three, and four or more reflections."""

_AT_ONCE = 2**15
"""Rays that are traced together; each such batch has random numbers of its own."""

_NODES = 4097
"""Of the table of reflectance over the cosine: linear interpolation departs from aluminium's by less than 1e-6."""


Entry = tuple[float, float, float, float]
"""Rectangle through which light comes in, um, at the height of the highest point: lowest x and y, highest x and y."""


@dataclass(frozen=True)
class Terrain:
    """A height field, prepared for rays. Lengths are in pitches: a cell has side one."""

    heights: FloatArray
    """[cells + 1 along y, cells + 1 along x] of the corners of the cells, pitches."""
    blocks: FloatArray
    """[blocks along y, along x] highest corner of each 8 x 8 cells, pitches."""
    large_blocks: FloatArray
    """[large blocks along y, along x] of each 8 x 8 blocks, pitches."""
    pitch_um: float
    """Of the height field, um."""
    periodic: bool
    """Whether rays that leave at one side come in at the other."""

    @property
    def top(self) -> float:
        """The highest point, pitches."""
        return float(self.large_blocks.max())

    @property
    def size(self) -> tuple[int, int]:
        """Cells along x and along y."""
        return self.heights.shape[1] - 1, self.heights.shape[0] - 1

    @property
    def extent_um(self) -> Entry:
        """All of the patch, um."""
        return 0.0, 0.0, self.size[0] * self.pitch_um, self.size[1] * self.pitch_um


@dataclass(frozen=True)
class Paths:
    """What became of rays."""

    escaped: BoolArray
    """[rays] left the surface upwards."""
    lost: BoolArray
    """[rays] left a finite patch through its side, where nobody knows what they would have met."""
    stopped: BoolArray
    """[rays] would have been reflected more often than the limit allows."""
    reflections: CountArray
    """[rays] number of reflections."""
    directions: FloatArray
    """[rays, 3] the last direction, a unit vector."""
    cosines: FloatArray
    """[rays, limit] of the angle of incidence of each reflection; zero after the last."""


@dataclass(frozen=True)
class VirtualScan:
    """In-plane BRDF of a height field by geometric optics, decomposed by the number of reflections.

    "Order" is the number of reflections; in `brdf` the last order holds all higher ones. The shares are of the light
    that falls in, and `escaped` + `lost` + `stopped` add up to one.
    """

    theta_in: float
    """Degrees."""
    theta_out: FloatArray
    """[points] degrees, signed: positive is forward."""
    brdf: FloatArray
    """[points, orders, wavelengths] averaged over the detector's aperture, 1/sr; orders 1, 2, 3, ..."""
    u_brdf: FloatArray
    """[points, orders, wavelengths] standard error of that, 1/sr. No ray in a bin is no proof of zero: such a bin has
    the error that a single ray of weight one would have given it."""
    rays: int
    """How many were traced."""
    escaped: FloatArray
    """[limit + 1] share of the rays that escaped after 0, 1, 2, ... reflections; sum over all but `lost`, `stopped`."""
    lost: float
    """Share of the rays that were lost through the side of a finite patch: the BRDF is low by about as much."""
    stopped: float
    """Share of the rays that were stopped at the limit."""
    reflected: FloatArray
    """[limit + 1, wavelengths] share of the light that escaped after 0, 1, 2, ... reflections, after absorption."""
    forward: FloatArray
    """[limit + 1, wavelengths] part of `reflected` that left to the side of the mirror direction, over that half of
    the hemisphere; the rest left to the side where the light came from. What left along the normal counts half."""


def terrain(field: HeightField) -> Terrain:
    """Prepare a height field; raises `UnfitTopography` where heights are missing."""
    heights = np.ascontiguousarray(around(field) / field.pitch_um)
    cells = np.maximum(
        np.maximum(heights[:-1, :-1], heights[:-1, 1:]),
        np.maximum(heights[1:, :-1], heights[1:, 1:]),
    )
    blocks = _highest(cells)
    return Terrain(heights, blocks, _highest(blocks), field.pitch_um, field.periodic)


def beam(
    surface: Terrain, theta_in: float, rays: int, seed: int, azimuth: float = 0.0
) -> tuple[FloatArray, FloatArray]:
    """Origins, um, and directions, both [rays, 3], of parallel light that fills the plane at the height of the top.

    `theta_in` in degrees, less than 90; `azimuth` degrees from x towards y to where a mirror sends the light.
    """
    return _beam(surface, theta_in, rays, np.random.default_rng(seed), azimuth, surface.extent_um)


def trace(surface: Terrain, origins_um: FloatArray, directions: FloatArray, limit: int = LIMIT) -> Paths:
    """Follow rays until each has ended.

    `origins_um` and `directions` are [rays, 3]; x, y lie within the patch, [0, cells x pitch], z at its highest point
    or above. `directions` are unit vectors. Raises `UnfitRays` where they are not. Meant for up to some 10^6 rays.
    """
    from simulators.rays.kernel import EDGE, ESCAPED, STOPPED, follow  # noqa: PLC0415  (compiles)

    origins = np.ascontiguousarray(origins_um / surface.pitch_um)
    directions = np.ascontiguousarray(directions, dtype=float)
    _check(surface, origins, directions)
    rays = len(origins)
    ends, reflections = (np.zeros(rays, dtype=np.uint32) for _ in range(2))
    out, cosines = np.empty((rays, 3)), np.zeros((limit, rays))
    follow(
        surface.heights,
        surface.blocks,
        surface.large_blocks,
        surface.top,
        surface.periodic,
        origins,
        directions,
        limit,
        ends,
        reflections,
        out,
        cosines,
    )
    return Paths(ends == ESCAPED, ends == EDGE, ends == STOPPED, reflections, out, cosines.T)


def weights(paths: Paths, table: FloatArray) -> FloatArray:
    """[rays, wavelengths] product of the reflectances of all reflections of each ray; `table` as of `tabulated`."""
    return _weights_of(paths, np.arange(len(paths.reflections)), table)


def tabulated(reflectance: Reflectance) -> FloatArray:
    """[nodes, wavelengths] of a reflectance, at cosines evenly from 0 to 1."""
    return np.ascontiguousarray(reflectance(np.linspace(0.0, 1.0, _NODES)[:, None]), dtype=float)


def virtual_scan(
    field: HeightField,
    theta_in: float,
    theta_out: FloatArray,
    reflectance: Reflectance,
    rays: int,
    seed: int,
    aperture: float = 1.0,
    azimuth: float = 0.0,
    limit: int = LIMIT,
    executor: Executor | None = None,
) -> VirtualScan:
    """Measure a height field with rays: `collected` from all of it, prepared anew.

    Raises `UnfitTopography` for a surface with holes, otherwise as `collected`.
    """
    surface, table = terrain(field), tabulated(reflectance)
    return collected(surface, theta_in, theta_out, table, rays, seed, aperture, azimuth, limit, executor=executor)


def collected(
    surface: Terrain,
    theta_in: float,
    theta_out: FloatArray,
    table: FloatArray,
    rays: int,
    seed: int,
    aperture: float = 1.0,
    azimuth: float = 0.0,
    limit: int = LIMIT,
    entry_um: Entry | None = None,
    executor: Executor | None = None,
) -> VirtualScan:
    """What falls into a round aperture around each in-plane direction.

    Angles in degrees; `aperture` is the full angle, and apertures of neighbouring `theta_out` may overlap. With w the
    weight of a ray and theta its angle to the mean surface, `f = sum(w / cos theta) / (rays x solid angle)`, the mean
    of the BRDF over the aperture. `table` is the reflectance as of `tabulated`; light comes in through `entry_um`, and
    through the whole patch without. The same `seed` gives the same result, whatever `executor` traces the batches;
    threads do well, as tracing does not hold the interpreter. Raises `UnfitRays` for directions at or beyond the
    horizon.
    """
    if not (0 <= theta_in < 90 and np.all(np.abs(theta_out) + aperture / 2 < 90)):
        raise UnfitRays(
            f"A virtual scan looks from above, but theta_in is {theta_in:g} deg and theta_out reaches "
            f"{np.abs(theta_out).max():g} deg with an aperture of {aperture:g} deg; both must stay below 90 deg."
        )
    if rays < 2 or limit < 1:
        raise UnfitRays(f"A virtual scan needs two rays and one reflection, not {rays} and {limit}.")
    entry = surface.extent_um if entry_um is None else entry_um
    batch = partial(_batch, surface, theta_in, theta_out, table, seed, aperture, azimuth, limit, entry)
    sizes = [min(_AT_ONCE, rays - first) for first in range(0, rays, _AT_ONCE)]
    counted: Iterator[_Sums] = (map if executor is None else executor.map)(batch, range(len(sizes)), sizes)
    total = next(counted)
    for further in counted:
        total = tuple(a + b for a, b in zip(total, further, strict=True))
    first, second, escaped, lost, stopped, reflected, forward = total
    solid_angle = 2 * np.pi * (1 - np.cos(np.radians(aperture / 2)))
    mean = first / rays
    error = np.sqrt(np.maximum(second / rays - mean**2, 0) / (rays - 1))
    alone = 1 / (rays * np.cos(np.radians(theta_out)))[:, None, None]
    return VirtualScan(
        theta_in=theta_in,
        theta_out=theta_out,
        brdf=mean / solid_angle,
        u_brdf=np.where(second == 0, alone, error) / solid_angle,
        rays=rays,
        escaped=escaped / rays,
        lost=float(lost / rays),
        stopped=float(stopped / rays),
        reflected=reflected / rays,
        forward=forward / rays,
    )


_Sums = tuple[FloatArray, ...]
"""Of x and of x^2 [points, orders, wavelengths], of escaped rays [limit + 1], of lost and of stopped ones, and of the
weights of escaped ones, all and those that went forward [limit + 1, wavelengths]; x is weight / cos theta."""


def _batch(
    surface: Terrain,
    theta_in: float,
    theta_out: FloatArray,
    table: FloatArray,
    seed: int,
    aperture: float,
    azimuth: float,
    limit: int,
    entry_um: Entry,
    number: int,
    rays: int,
) -> _Sums:
    """Trace batch `number` and sum up what escapes; a pure function of its arguments."""
    origins, incident = _beam(surface, theta_in, rays, np.random.default_rng([seed, number]), azimuth, entry_um)
    paths = trace(surface, origins, incident, limit)
    escaped = np.bincount(paths.reflections[paths.escaped], minlength=limit + 1).astype(float)
    east, north = np.cos(np.radians(azimuth)), np.sin(np.radians(azimuth))
    x, y, z = paths.directions.T
    along, sideways = east * x + north * y, east * y - north * x
    ahead, upright, behind = (
        _weight_by_order(paths, table, paths.escaped & side) for side in (along > 0, along == 0, along < 0)
    )
    half = np.radians(aperture / 2)
    near = np.flatnonzero(paths.escaped & (np.abs(sideways) <= np.sin(half)) & (paths.reflections > 0))
    looking = np.radians(theta_out)
    cosine = np.outer(along[near], np.sin(looking)) + np.outer(z[near], np.cos(looking))
    ray, point = np.nonzero(cosine >= np.cos(half))
    order = np.minimum(paths.reflections[near[ray]], ORDERS).astype(int) - 1
    value = (_weights_of(paths, near, table) / z[near, None])[ray]
    first, second = (np.zeros((theta_out.size, ORDERS, table.shape[1])) for _ in range(2))
    np.add.at(first, (point, order), value)
    np.add.at(second, (point, order), value**2)
    lost, stopped = (np.asarray(ended.sum()) for ended in (paths.lost, paths.stopped))
    return first, second, escaped, lost, stopped, ahead + upright + behind, ahead + upright / 2


def _weight_by_order(paths: Paths, table: FloatArray, chosen: BoolArray) -> FloatArray:
    """[limit + 1, wavelengths] sum of the weights of `chosen` rays [rays] after 0, 1, 2, ... reflections."""
    limit, last = paths.cosines.shape[1], table.shape[0] - 1
    total = np.zeros((limit + 1, table.shape[1]))
    total[0] = np.count_nonzero(chosen & (paths.reflections == 0))
    # Most rays are reflected once. Interpolation is linear, so that the table is asked for all of them together.
    place = np.minimum(paths.cosines[chosen & (paths.reflections == 1), 0], 1.0) * last
    node = np.minimum(place.astype(int), last - 1)
    share = np.bincount(node, node + 1 - place, last + 1) + np.bincount(node + 1, place - node, last + 1)
    total[1] = share @ table
    more = np.flatnonzero(chosen & (paths.reflections > 1))
    np.add.at(total, paths.reflections[more], _weights_of(paths, more, table))
    return total


def _weights_of(paths: Paths, chosen: NDArray[np.intp], table: FloatArray) -> FloatArray:
    """[chosen, wavelengths] as `weights`, of the rays of these numbers."""
    from simulators.rays.kernel import weigh  # noqa: PLC0415  (compiles)

    product = np.ones((chosen.size, table.shape[1]))
    weigh(paths.reflections[chosen], np.ascontiguousarray(paths.cosines.T[:, chosen]), table, product)
    return product


def _beam(
    surface: Terrain,
    theta_in: float,
    rays: int,
    random: np.random.Generator,
    azimuth: float,
    entry_um: Entry,
) -> tuple[FloatArray, FloatArray]:
    tilt, turn = np.radians(theta_in), np.radians(azimuth)
    low, high = np.array(entry_um[:2]), np.array(entry_um[2:])
    origins = np.empty((rays, 3))
    origins[:, :2] = low + random.random((rays, 2)) * (high - low)
    origins[:, 2] = surface.top * surface.pitch_um
    direction = np.array([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), -np.cos(tilt)])
    return origins, np.broadcast_to(direction, (rays, 3))


def _highest(values: FloatArray) -> FloatArray:
    """Maxima of blocks of 8 x 8, of smaller ones at the upper ends."""
    rows = np.maximum.reduceat(values, np.arange(0, values.shape[0], 8), axis=0)
    return np.ascontiguousarray(np.maximum.reduceat(rows, np.arange(0, values.shape[1], 8), axis=1))


def _check(surface: Terrain, origins: FloatArray, directions: FloatArray) -> None:
    """Of origins in pitches."""
    inside = np.all((origins[:, :2] >= 0) & (origins[:, :2] <= surface.size), axis=1)
    above = origins[:, 2] >= surface.top - 1e-9 * max(1.0, abs(surface.top))
    unit = np.abs((directions**2).sum(axis=1) - 1) < 1e-9
    fit = inside & above & unit
    if not fit.all():
        ray = int(np.argmin(fit))
        why = "within the patch" if not inside[ray] else "above its highest point" if not above[ray] else ""
        what = f"starts {why}" if why else "has a direction of length one"
        raise UnfitRays(f"Ray {ray} of {len(fit)} is none that can be traced; see to it that it {what}.")
