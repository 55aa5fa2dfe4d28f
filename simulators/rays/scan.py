"""A whole in-plane scan with the virtual gonioreflectometer: spectra, their errors, and their make-up by reflections.

Each patch of a surface is lit window by window, each window by two halves of the rays. Windows are areas of their own,
so the spread between them is the error of the mean: it holds the number of rays and the sample of the surface alike.
The halves tell what more rays would change.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial
from itertools import chain, islice, product

import numpy as np
from numpy.typing import NDArray

from drivers.arrays import FloatArray
from simulators.errors import UnfitRays
from simulators.materials.surfaces import Reflectance
from simulators.rays.rays import LIMIT, ORDERS, Entry, Terrain, collected, tabulated

HIGHEST = 85.0
"""Farthest from the normal that light comes from, and that the detector looks from, degrees."""

WINDOWS = 4
"""Windows along each side of a patch."""

_HALVES = 2

_AT_ONCE = 2**18
"""Rays of a task, if not more: about 0.15 s of work."""


@dataclass(frozen=True)
class Goniometer:
    """What is to be measured, and how.

    Raises `UnfitRays` for angles that are not distinct, or beyond `HIGHEST`.
    """

    theta_in: FloatArray
    """[incident] degrees, ascending."""
    theta_out: FloatArray
    """[outgoing] degrees, signed, ascending."""
    wavelengths: FloatArray
    """[wavelengths] nm, ascending."""
    reflectance: Reflectance
    """Of a facet at these wavelengths."""
    decomposed_at: int
    """Index of the wavelength at which light is decomposed by its number of reflections."""
    rays: int
    """For each incident angle, all patches together."""
    seed: int
    aperture: float
    """Full angle, degrees."""
    azimuth: float
    """Degrees from x towards y to where a mirror sends the light, the same for all patches."""

    def __post_init__(self) -> None:
        for name, angles, lowest, highest in (
            ("incident", self.theta_in, 0.0, HIGHEST),
            ("detector", self.theta_out, -HIGHEST, HIGHEST),
        ):
            if not (angles.size and np.all(np.diff(angles) > 0) and angles[0] >= lowest and angles[-1] <= highest):
                raise UnfitRays(
                    f"A scan needs {name} angles that differ, from {lowest:g} to {highest:g} deg, but they are "
                    f"{', '.join(f'{angle:g}' for angle in angles[:5])}{' ...' if angles.size > 5 else ''}."
                )


@dataclass(frozen=True)
class RayScan:
    """What was found. A part is a window of a patch; parts of a patch follow each other.

    "Order" is the number of reflections; the last order holds all higher ones.
    """

    asked: Goniometer
    brdf: FloatArray
    """[incident, outgoing, wavelengths] averaged over the aperture, 1/sr."""
    u_level: FloatArray
    """[incident, outgoing, wavelengths] standard error that all wavelengths share, 1/sr."""
    u_spectral: FloatArray
    """[incident, outgoing, wavelengths] standard error of each wavelength by itself, 1/sr."""
    by_order: FloatArray
    """[parts, halves, incident, outgoing, orders] BRDF at the wavelength of the decomposition, 1/sr."""
    light: FloatArray
    """[parts, halves, incident, orders, (back, forward), wavelengths] share of the light that left the surface."""
    ends: NDArray[np.int64]
    """[incident, (escaped, lost, stopped)] how many rays ended so; they add up to `traced`."""
    escaped: NDArray[np.int64]
    """[incident, limit + 1] rays that escaped after 0, 1, 2, ... reflections."""
    traced: int
    """Rays for each incident angle; not less than were asked for."""


def ray_scan(
    surfaces: Sequence[Terrain],
    asked: Goniometer,
    executor: Executor,
    progress: Callable[[float], None] = lambda share: None,
) -> RayScan:
    """Scan patches of one kind of surface; `progress` hears the share of the work that is done.

    Tasks of `executor` are some windows each. The result depends on nothing but `surfaces` and `asked`.
    """
    table = tabulated(asked.reflectance)
    windows = len(surfaces) * WINDOWS**2
    rays = max(2, -(-asked.rays // (windows * _HALVES)))
    shape = (windows, _HALVES)
    places = list(product(asked.theta_in.tolist(), range(len(surfaces)), range(WINDOWS**2)))
    together = -(-_AT_ONCE // (rays * _HALVES))
    batches = [places[first : first + together] for first in range(0, len(places), together)]
    traced = chain.from_iterable(executor.map(partial(_windows, surfaces, asked, table, rays), batches))
    found = []
    for place in range(asked.theta_in.size):
        measured = []
        for number, halves in enumerate(islice(traced, windows)):
            measured += halves
            progress((place + (number + 1) / windows) / asked.theta_in.size)
        total, by_order, light, ends, escaped = (np.stack(each) for each in zip(*measured, strict=True))
        # a direction that no ray met is no proof of darkness: one ray of weight one would have given this
        alone = 1 / (rays * windows * _HALVES * np.cos(np.radians(asked.theta_out)) * _solid_angle(asked.aperture))
        spectra = _mean_and_errors(total.reshape(*shape, *total.shape[1:]).mean(axis=1), alone)
        found.append((*spectra, by_order, light, ends.sum(axis=0), escaped.sum(axis=0)))
    brdf, u_level, u_spectral, by_order, light, ends, escaped = (np.stack(each) for each in zip(*found, strict=True))
    return RayScan(
        asked=asked,
        brdf=brdf,
        u_level=u_level,
        u_spectral=u_spectral,
        by_order=np.moveaxis(by_order, 0, 1).reshape(*shape, *by_order.shape[:1], *by_order.shape[2:]),
        light=np.moveaxis(light, 0, 1).reshape(*shape, *light.shape[:1], *light.shape[2:]),
        ends=ends,
        escaped=escaped,
        traced=rays * windows * _HALVES,
    )


def window(surface: Terrain, number: int, theta_in: float, azimuth: float) -> Entry:
    """Where light comes in that falls, at the mean height, on window `number` of WINDOWS^2, um.

    The windows cover a periodic patch, and of another one what is so far within that light from the mean height may
    leave it as low as `HIGHEST` without meeting its side, but at least the middle half of each side.
    """
    low_x, low_y, high_x, high_y = surface.extent_um
    if surface.periodic:
        shift = margin = 0.0
    else:
        above = (surface.top - float(surface.heights.mean())) * surface.pitch_um
        margin = min(above * np.tan(np.radians(HIGHEST)), min(high_x, high_y) / 4)
        shift = min(above * np.tan(np.radians(theta_in)), margin)
    row, column = divmod(number, WINDOWS)
    back_x, back_y = shift * np.cos(np.radians(azimuth)), shift * np.sin(np.radians(azimuth))
    x = low_x + margin - back_x + (high_x - low_x - 2 * margin) * np.array([column, column + 1]) / WINDOWS
    y = low_y + margin - back_y + (high_y - low_y - 2 * margin) * np.array([row, row + 1]) / WINDOWS
    return float(x[0]), float(y[0]), float(x[1]), float(y[1])


_Half = tuple[FloatArray, FloatArray, FloatArray, NDArray[np.int64], NDArray[np.int64]]
"""[outgoing, wavelengths] BRDF, that by orders, light by orders, rays by their ends and by orders: of one half."""


def _windows(
    surfaces: Sequence[Terrain],
    asked: Goniometer,
    table: FloatArray,
    rays: int,
    places: Sequence[tuple[float, int, int]],
) -> list[list[_Half]]:
    """Both halves of windows: incident angle, patch and number of each; a pure function of its arguments."""
    return [
        [_half(surfaces[patch], asked, table, rays, theta_in, patch, number, half) for half in range(_HALVES)]
        for theta_in, patch, number in places
    ]


def _half(
    surface: Terrain,
    asked: Goniometer,
    table: FloatArray,
    rays: int,
    theta_in: float,
    patch: int,
    number: int,
    half: int,
) -> _Half:
    key = [asked.seed, patch, number, half, round(1000 * theta_in)]
    scan = collected(
        surface,
        theta_in,
        asked.theta_out,
        table,
        rays,
        int(np.random.SeedSequence(key).generate_state(1)[0]),
        asked.aperture,
        asked.azimuth,
        LIMIT,
        window(surface, number, theta_in, asked.azimuth),
    )
    by_side = np.stack([scan.reflected - scan.forward, scan.forward], axis=1)[1:]
    light = np.concatenate([by_side[: ORDERS - 1], by_side[ORDERS - 1 :].sum(axis=0, keepdims=True)])
    escaped = np.rint(scan.escaped * rays).astype(int)
    ends = np.array([escaped.sum(), round(scan.lost * rays), round(scan.stopped * rays)])
    return scan.brdf.sum(axis=1), scan.brdf[..., asked.decomposed_at], light, ends, escaped


def _mean_and_errors(parts: FloatArray, alone: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """[outgoing, wavelengths] mean of `parts` [parts, outgoing, wavelengths], and its error: of level, of spectrum.

    The level of a part is its mean over the wavelengths; the rest is what its spectrum departs from the mean one at
    this level. `alone` [outgoing] is the error of a direction without light.
    """
    mean = parts.mean(axis=0)
    level = parts.mean(axis=-1, keepdims=True)
    spectrum = np.divide(mean, mean.mean(axis=-1, keepdims=True), out=np.ones_like(mean), where=mean > 0)
    of_level, of_rest = (each.std(axis=0, ddof=1) / len(parts) ** 0.5 for each in (level, parts - level * spectrum))
    return mean, *(np.where(mean > 0, each, alone[:, None]) for each in (of_level * spectrum, of_rest))


def _solid_angle(aperture: float) -> float:
    return float(2 * np.pi * (1 - np.cos(np.radians(aperture / 2))))
