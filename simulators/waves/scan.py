"""What waves make of several patches of a surface: their mean, and from their spread how well it is known.

Patches of a synthesised surface are made from other seeds, those of a measured map are its tiles. Each is refined as
`simulators.waves.sampling` asks, and averaged over all places of the coherence window.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from math import isqrt, sqrt
from pathlib import Path

import numpy as np

from analysis.reflectance.fresnel import Conductor
from drivers.arrays import FloatArray
from goniometer.errors import InputError
from simulators.choices import FEWEST, PITCH_UM, SIDE_UM, STEP_UM, Kernel
from simulators.topographies.heights import HeightField
from simulators.topographies.synthesis import MICRO_CORRELATION_UM
from simulators.topographies.topography import topography
from simulators.waves.diffraction import Coherence
from simulators.waves.power_spectrum import power_spectrum
from simulators.waves.sampling import Sampling, refined, sampling
from simulators.waves.waves import Averaged, averaged_brdf, scattering_vectors

MOST_POINTS = 32_000_000
"""Points up to which a patch is refined; its computation takes some gigabytes then."""

DARK = 1e-12
"""Error that the transform leaves in directions that should be dark, 1/sr, see `simulators.waves.power_spectrum`."""

Make = Callable[[], HeightField]
"""Makes a patch, in whatever process it is called."""


@dataclass(frozen=True)
class Setup:
    """What is computed of each patch."""

    theta_in: FloatArray
    """[points] incident angle, degrees."""
    theta_out: FloatArray
    """[points] reflected angle, degrees, signed."""
    wavelengths: FloatArray
    """[wavelengths] nm, ascending."""
    coherence: Coherence
    kernel: Kernel
    conductor: Conductor | None
    """None for a perfect mirror."""


@dataclass(frozen=True)
class Patches:
    """Independent patches of one surface."""

    name: str
    origin: dict[str, object]
    """How the first was made, or what was read from which file."""
    make: tuple[Make, ...]
    smooth: tuple[Make, ...]
    """The same without roughness below the wavelength, for rays; at the usual pitch unless one was asked for."""
    symmetric: bool
    """Whether the surface has no preferred sense along the plane of incidence, so that each patch may be looked at from
    either side: the mean of both is known better. True of all that are synthesised."""


@dataclass(frozen=True)
class Spread:
    """The mean of patches and its standard errors, 1/sr, all [points, wavelengths]; see `spread`."""

    mean: FloatArray
    u_level: FloatArray
    u_tilt: FloatArray
    u_spectral: FloatArray


def choose_patches(
    what: str, size: int | None, pitch_um: float | None, seed: int, count: int, *, micro: bool
) -> Patches:
    """`count` patches of the surface `what`, see `simulators.topographies.topography.topography`.

    A synthesised patch is `SIDE_UM` wide unless `size` is given. Raises `InputError` where there is no such surface or
    where there are fewer than `FEWEST` patches.
    """
    if count < FEWEST:
        raise InputError(f"The spread of {count} patches says little; take at least {FEWEST}.")
    for_rays = size, pitch_um
    if not Path(what).is_file():
        coarse = pitch_um or PITCH_UM
        pitch_um = pitch_um or (MICRO_CORRELATION_UM / 2 if micro else STEP_UM)
        size = size or round(SIDE_UM / pitch_um)
        for_rays = round(size * pitch_um / coarse), coarse
    first = topography(what, size, pitch_um, seed, micro=micro)
    if "seed" not in first.origin:
        bare = topography(what, *for_rays, seed, micro=False)
        parts, for_rays_too = (
            tuple(partial(_itself, tile) for tile in tiles(each.field, count)) for each in (first, bare)
        )
        return Patches(first.name, first.origin, parts, for_rays_too, symmetric=False)
    # the roughness below the wavelength takes the seed that follows
    make, smooth = (
        tuple(partial(_synthesised, what, *grid, seed + 2 * i, fine) for i in range(count))
        for grid, fine in (((size, pitch_um), micro), (for_rays, False))
    )
    return Patches(first.name, first.origin, make, smooth, symmetric=True)


def tiles(field: HeightField, count: int) -> list[HeightField]:
    """`count` equal patches of a map, side by side; their shape is as near to square as `count` allows.

    None is periodic. Raises `InputError` where one would have fewer than two heights along a side.
    """
    rows = next(n for n in range(isqrt(count), 0, -1) if count % n == 0)
    columns = count // rows
    ny, nx = field.heights_um.shape[0] // rows, field.heights_um.shape[1] // columns
    if min(ny, nx) < 2:
        raise InputError(f"A topography of {field.heights_um.shape} heights has no {count} patches; ask for fewer.")
    return [
        HeightField(field.heights_um[y * ny : (y + 1) * ny, x * nx : (x + 1) * nx], field.pitch_um, periodic=False)
        for y in range(rows)
        for x in range(columns)
    ]


def fine_enough(field: HeightField, setup: Setup) -> tuple[HeightField, int, Sampling]:
    """`field` refined as `setup` needs it, how many times, and its sampling, which is insufficient only at
    `MOST_POINTS`. Raises `UnfitTopography` where heights are missing and `InputError` as `scattering_vectors`."""
    vectors = scattering_vectors(setup.theta_in, setup.theta_out, setup.wavelengths)
    window = float(setup.coherence.size(setup.wavelengths).min())
    most = max(1, isqrt(MOST_POINTS // field.heights_um.size))
    times, fine, found = 1, field, sampling(field, *vectors, window)
    while not found.sufficient and times < most:
        # a spline is steeper in places than the straight lines whose slopes told how often to refine
        times = min(times * found.times if times == 1 else times + 1, most)
        fine = refined(field, times)
        found = sampling(fine, *vectors, window)
    return fine, times, found


def average(field: HeightField, setup: Setup, reach: tuple[float, float] | None = None) -> Averaged:
    """Of `field` as it is sampled, for `setup` and for kz between the two of `reach`, 1/um, where given.

    Raises `InputError` as `scattering_vectors` and `UnfitTopography` as `power_spectrum`.
    """
    vectors = scattering_vectors(setup.theta_in, setup.theta_out, setup.wavelengths)
    window = float(setup.coherence.size(setup.wavelengths).min())
    kz = np.append(vectors[1], reach or ())
    spectrum = power_spectrum(field, window, float(kz.min()), float(kz.max()))
    return Averaged(spectrum, setup.coherence, sampling(field, *vectors, window))


def seen(mean: Averaged, setup: Setup, *, symmetric: bool) -> FloatArray:
    """[points, wavelengths] BRDF of one patch, 1/sr; see `Patches.symmetric`. Raises as `averaged_brdf`."""
    sides = (1, -1) if symmetric else (1,)
    found = [
        averaged_brdf(
            mean, side * setup.theta_in, side * setup.theta_out, setup.wavelengths, setup.kernel, setup.conductor
        ).brdf
        for side in sides
    ]
    return np.asarray(np.mean(found, axis=0))


def spread(brdf: FloatArray, wavelengths: FloatArray) -> Spread:
    """Mean of `brdf` [patches, points, wavelengths] over the patches, with its standard error in three parts.

    The relative deviation of a patch at a point is a level, a tilt proportional to the wavelength, and a rest; the
    spread of each gives a part of the error. The rest is taken as independent between wavelengths and of the same
    relative size at all. A mean of n patches has Student's distribution of n - 1 degrees of freedom, whose standard
    deviation is sqrt((n - 1) / (n - 3)) s / sqrt(n) (JCGM 101:2008, 6.4.9). Raises `InputError` below `FEWEST` patches.
    """
    count = brdf.shape[0]
    if count < FEWEST:
        raise InputError(f"The spread of {count} patches says little; take at least {FEWEST}.")
    mean = brdf.mean(axis=0)
    relative = np.where(mean > 0, brdf / np.where(mean > 0, mean, 1.0) - 1, 0.0)
    place = wavelengths - wavelengths.mean()
    level = relative.mean(axis=2)
    tilt = (relative @ place) / (place @ place)
    rest = relative - level[..., None] - tilt[..., None] * place
    free = max(wavelengths.size - 2, 1) / wavelengths.size
    factor = 1 / sqrt(count * (count - 3))
    of_level, of_tilt = (factor * np.sqrt((each**2).sum(axis=0))[:, None] for each in (level, tilt))
    of_rest = factor * np.sqrt((rest**2).mean(axis=2).sum(axis=0) / free)[:, None]
    return Spread(mean, mean * of_level, mean * of_tilt * place, np.hypot(mean * of_rest, DARK))


def _synthesised(what: str, size: int | None, pitch_um: float | None, seed: int, micro: bool) -> HeightField:
    return topography(what, size, pitch_um, seed, micro=micro).field


def _itself(field: HeightField) -> HeightField:
    return field
