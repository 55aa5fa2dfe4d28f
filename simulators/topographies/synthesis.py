"""Topographies that no microscope measured: sandblasted, Gaussian and brushed ones. All are periodic and seeded.

A sandblasted surface is the polished plane and the dents that spherical beads pressed into it: at each place the
deepest of the spheres that cover it (paper, section 3.2: randomly distributed spherical holes, overlapping). The beads
have the diameters of Table 1; how deep they go follows from the wanted roughness. The area by which such surfaces
exceed the plane is 40 to 70 per cent of what the paper's topographies of Samples 1 to 5 have, where the noise of the
microscope and whatever is finer than dents count, too.

A Gaussian surface is a sum of plane waves of random phase whose powers follow the wanted spectrum.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from drivers.arrays import FloatArray
from simulators.errors import UnfitTopography
from simulators.materials.materials import Material
from simulators.topographies.heights import HeightField, complete

Spectrum = Callable[[FloatArray, FloatArray], FloatArray]
"""Power per area of wave vectors, of k_x and k_y in 1/um (2 pi over the wavelength), in any unit."""

MICRO_RMS_UM, MICRO_CORRELATION_UM = 0.04, 0.2
"""Usual roughness below the wavelength that blasted metal has on its dents, um; below what a microscope resolves."""

_SHALLOWEST = 0.5
"""Depth of the shallowest dent as a fraction of the deepest: beads differ in speed."""

_FULL, _SPARSE = 3.0, 1.0
"""Coverage of the paper's samples, and of its Sample 8."""

_MET, _CLOSE, _TRIES, _PATIENT = 1e-4, 0.02, 30, 6
"""How nearly the wanted roughness is met, and the coverage, in how many steps at most, and after how many less nearly
the coverage."""

_FINE = 1024
"""Points along a side above which the depth is searched on a coarser grid first."""


@dataclass(frozen=True)
class Blasted:
    """A sandblasted surface and what made it."""

    field: HeightField
    depth_um: float
    """Of the deepest dents, um."""
    dents: int
    """How many beads fell on the patch."""
    bare: float
    """Share of the patch that no bead met, where the polished surface is still there."""


def sandblasted(
    abrasive_um: tuple[float, float], rms_um: float, coverage: float, size: int, pitch_um: float, seed: int
) -> Blasted:
    """A square patch of `size` x `size` points with the root mean square height `rms_um`.

    `abrasive_um` are the smallest and the largest diameter of the beads (Table 1), all in between equally frequent.
    `coverage` is the area of all dents over that of the patch, kept within 2 % (on a small patch within some more):
    exp(-coverage) of it stays bare. Depths are spread evenly from half the largest to the largest, which is searched
    until the roughness is met. Raises
    `UnfitTopography` if such beads cannot make the surface so rough, or if the patch is too small for them.
    """
    radii = abrasive_um[0] / 2, abrasive_um[1] / 2
    if not (0 < radii[0] <= radii[1] and rms_um > 0 and coverage > 0):
        raise UnfitTopography(
            f"Beads of {abrasive_um[0]:g} to {abrasive_um[1]:g} um, a roughness of {rms_um:g} um and a coverage of "
            f"{coverage:g} make no surface; all must be positive, the smaller diameter first."
        )
    if size * pitch_um < abrasive_um[1]:
        raise UnfitTopography(
            f"A patch of {size * pitch_um:g} um is smaller than a bead of {abrasive_um[1]:g} um; make it larger."
        )
    # A dent of depth d has the area pi (2 R d - d^2), here averaged over radii and depths.
    mean, mean_square = (1 + _SHALLOWEST) / 2, (1 + _SHALLOWEST + _SHALLOWEST**2) / 3
    depth, number = 3.5 * rms_um, 0
    if size > _FINE:  # most of the search is cheaper on a coarse grid
        coarse = sandblasted(abrasive_um, rms_um, coverage, size // 4, pitch_um * size / (size // 4), seed)
        depth, number = coarse.depth_um, coarse.dents
    for tried in range(_TRIES):
        if depth > radii[0]:
            break
        dents = coverage * (size * pitch_um) ** 2 / (np.pi * (sum(radii) * mean * depth - mean_square * depth**2))
        # else it stays, so that the roughness follows the depth without jumps; on a small patch these may have no end
        if abs(number / dents - 1) > _CLOSE * max(1, tried - _PATIENT):
            number = round(dents)
        heights = _dents(np.random.default_rng(seed).random((number, 4)), radii, depth, size, pitch_um)
        reached = float(heights.std())
        if reached == 0:
            break
        if abs(reached / rms_um - 1) < _MET:
            bare = float((heights == 0).mean())
            return Blasted(HeightField(heights - heights.mean(), pitch_um, True), depth, number, bare)
        # The number being as it is, the roughness is nearly proportional to the depth.
        depth *= rms_um / reached
    raise UnfitTopography(
        f"Beads of {abrasive_um[0]:g} to {abrasive_um[1]:g} um cannot make a roughness of {rms_um:g} um with a "
        f"coverage of {coverage:g} on a patch of {size * pitch_um:g} um; try a coverage near 2 or a larger patch."
    )


def sandblasted_sample(sample: Material, size: int, pitch_um: float, seed: int) -> Blasted:
    """The topography of one of the paper's samples from its beads and its roughness (Table 1).

    Of Sample 8 a third stays bare, as the paper's Fig. 2 still shows its polished surface; of all others a twentieth.
    The shares are ours. Raises `UnfitTopography` for a sample that was not sandblasted, otherwise as `sandblasted`.
    """
    if sample.abrasive_um is None:
        raise UnfitTopography(f"The sample {sample.name} was polished, not sandblasted; no bead shaped its surface.")
    coverage = _SPARSE if sample.name == "sample-8" else _FULL
    return sandblasted(sample.abrasive_um, sample.roughness_rms_um, coverage, size, pitch_um, seed)


def polished_sample(sample: Material, size: int, pitch_um: float, seed: int) -> HeightField:
    """The topography of a polished sample: a Gaussian waviness with the roughness of Table 1 and facets of its alpha.

    The autocorrelation length 2 rms / alpha gives Beckmann's roughness alpha, sqrt(2) times the rms slope in each
    direction, so that the patch is as much of a mirror as the sample; scratches, which the paper's mirror has, are left
    out. Raises `UnfitTopography` for a patch of less than four such lengths, or for a sample that was sandblasted.
    """
    if sample.abrasive_um is not None:
        raise UnfitTopography(f"The sample {sample.name} was sandblasted; its surface is not that of a polished one.")
    length = 2 * sample.roughness_rms_um / sample.alpha
    if length > size * pitch_um / 4:
        raise UnfitTopography(
            f"The waviness of {sample.name} is {length:.3g} um long; a patch of {size * pitch_um:g} um is too "
            f"small for it, make it {4 * length:.0f} um."
        )
    field = gaussian(sample.roughness_rms_um, gaussian_correlation(length), size, pitch_um, seed)
    return replace(field, heights_um=field.heights_um * (sample.roughness_rms_um / field.heights_um.std()))


def _dents(drawn: FloatArray, radii: tuple[float, float], depth: float, size: int, pitch_um: float) -> FloatArray:
    """[y, x] heights, um, below the polished plane at zero.

    `drawn` [dents, 4] between 0 and 1: x, y, radius and depth of each.
    """
    heights = np.zeros((size, size))
    for x, y, of_radius, of_depth in drawn:
        radius = radii[0] + of_radius * (radii[1] - radii[0])
        here = depth * (_SHALLOWEST + of_depth * (1 - _SHALLOWEST))
        reach = float(np.sqrt(2 * radius * here - here**2))
        rows, columns = (
            np.arange(int(np.ceil(c * size - reach / pitch_um)), int(c * size + reach / pitch_um) + 1) for c in (y, x)
        )
        squared = ((rows - y * size) ** 2)[:, None] + (columns - x * size) ** 2
        sphere = radius - here - np.sqrt(np.maximum(radius**2 - squared * pitch_um**2, 0))
        inside = np.ix_(rows % size, columns % size)
        heights[inside] = np.minimum(heights[inside], sphere)
    return heights


def gaussian_correlation(length_um: float) -> Spectrum:
    """Spectrum of an autocorrelation exp(-r^2 / length^2); its rms slope is sqrt(2) rms / length in each direction."""
    return lambda kx, ky: np.exp(-(kx**2 + ky**2) * length_um**2 / 4)


def brushing(across_um: float, along_um: float) -> Spectrum:
    """Spectrum of an autocorrelation exp(-x^2 / along^2 - y^2 / across^2): strokes along x."""
    return lambda kx, ky: np.exp(-(kx**2 * along_um**2 + ky**2 * across_um**2) / 4)


def gaussian(rms_um: float, spectrum: Spectrum, size: int, pitch_um: float, seed: int) -> HeightField:
    """A square patch of `size` x `size` points of a Gaussian process with this spectrum.

    `rms_um` is that of the process: a patch of few correlation areas departs from it as any sample does. What the
    spectrum has beyond pi / pitch, which the grid cannot carry, is left out before the scale is set.
    """
    k: FloatArray = 2 * np.pi * np.fft.fftfreq(size, pitch_um).astype(float)
    power = spectrum(*np.meshgrid(k, k))
    power[0, 0] = 0.0  # the mean height is zero
    noise = np.fft.fft2(np.random.default_rng(seed).normal(size=(size, size)))
    # White noise of variance one has a mean power of size^2 in each of the size^2 coefficients.
    heights = np.fft.ifft2(noise * np.sqrt(power / power.mean())).real * rms_um
    return HeightField(heights, pitch_um, True)


def brushed(rms_um: float, across_um: float, along_um: float, size: int, pitch_um: float, seed: int) -> HeightField:
    """A brushed patch, strokes along x: correlation lengths `along_um` of a stroke and `across_um` of its width.

    Raises `UnfitTopography` if strokes are longer than a quarter of the patch, which then shows a single one.
    """
    if along_um > size * pitch_um / 4:
        raise UnfitTopography(
            f"Strokes of {along_um:g} um do not fit on a patch of {size * pitch_um:g} um; make it four strokes long."
        )
    return gaussian(rms_um, brushing(across_um, along_um), size, pitch_um, seed)


def with_micro_roughness(
    field: HeightField, seed: int, rms_um: float = MICRO_RMS_UM, correlation_um: float = MICRO_CORRELATION_UM
) -> HeightField:
    """The same square, periodic surface with fine Gaussian roughness on it.

    Raises `UnfitTopography` unless the pitch is at most half the correlation length, or where a surface is neither
    square nor periodic.
    """
    heights = complete(field)
    if field.pitch_um > correlation_um / 2:
        raise UnfitTopography(
            f"Roughness of {correlation_um:g} um correlation does not show on a grid of {field.pitch_um:g} um; "
            f"it needs {correlation_um / 2:g} um or less."
        )
    if not field.periodic or heights.shape[0] != heights.shape[1]:
        raise UnfitTopography("Fine roughness is made for a square patch that is periodic; this one is not.")
    fine = gaussian(rms_um, gaussian_correlation(correlation_um), heights.shape[0], field.pitch_um, seed)
    return replace(field, heights_um=heights + fine.heights_um)
