"""Images of a topography in the light that it scatters, speckle included: coherent imaging through a round lens.

In the plane wave of one source point at one wavelength the surface is a phase screen exp(i kz h). Its harmonics

    d_b = mean of exp(i (k_b . r + kz h(r))),    k_b the harmonics of the patch

are plane waves, and those within the pupil of the lens make the image (Goodman, Introduction to Fourier Optics, chapter
6). The field at a place r of the image is

    E(r) = 2 pi / sqrt(A) times the sum over the pupil of d_b exp(-i k_b . r)

in um, A the area of the pupil in wave vectors: the diffraction integral I of `simulators.waves.diffraction` with the
point-spread function of the lens for its window. Points of the source and wavelengths do not interfere, so their |E|^2
are added. The lens is free of aberrations and focused on all of the surface; kz is taken to be the same all over its
pupil.

d_b as a function of kz is band-limited by the range of heights H, so that a grid of spacing pi / H holds all angles and
wavelengths at once.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, cos, floor, pi, radians, sin

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from analysis.reflectance.directions import Aperture
from drivers.arrays import FloatArray
from goniometer.errors import InputError
from simulators.errors import UnfitTopography
from simulators.topographies.heights import HeightField, complete
from simulators.waves.kz_grid import TAPS, grid_for, range_of, taps, transformed_columns

Harmonic = NDArray[np.complex64]

_AT_ONCE = 24_000_000
"""Complex numbers that are transformed together, which bounds the memory."""

_FEWEST = 3.0
"""Harmonics across the radius of the pupil that a patch needs; below, it is not much larger than one speckle."""


@dataclass(frozen=True)
class Lens:
    """A lens that looks at the surface in the plane of incidence."""

    f_number: float
    """As engraved: focal length over diameter of the pupil, at infinity."""
    magnification: float
    """Size in the image over size on the object."""
    theta_out: float
    """Signed angle of its axis to the surface normal, degrees."""

    @property
    def numerical_aperture(self) -> float:
        """Sine of the half angle under which the object sees the pupil: m / (2 N (1 + m)), for a symmetric lens."""
        return self.magnification / (2 * self.f_number * (1 + self.magnification))


@dataclass(frozen=True)
class PhaseScreen:
    """The harmonics d_b of a topography, from which images for all its angles and wavelengths are cheap."""

    harmonics: Harmonic
    """[along, across, kz] d_b; along the plane of incidence from `first_along` upward, across it from
    `first_across` upward."""
    first_along: int
    first_across: int
    step_along: float
    """Spacing of the harmonics along the plane of incidence, 1/um; 2 pi over the size of the patch."""
    step_across: float
    kz_step: float
    """Spacing of the kz grid, 1/um."""
    kz_first: int
    """The grid begins at this multiple of its spacing."""

    def block(self, along: tuple[int, int], across: tuple[int, int], kz: float) -> Harmonic:
        """[along, across] d_b of the harmonics from the first to the last of each, at `kz` in 1/um.

        Raises `InputError` for harmonics or a `kz` beyond those that the screen has.
        """
        first, weight = taps(np.array(kz), self.kz_step)
        rows = slice(along[0] - self.first_along, along[1] + 1 - self.first_along)
        columns = slice(across[0] - self.first_across, across[1] + 1 - self.first_across)
        low = int(first) - self.kz_first
        depth = slice(low, low + TAPS)
        near = self.harmonics[rows, columns, depth]
        if near.shape != (along[1] - along[0] + 1, across[1] - across[0] + 1, TAPS):
            raise InputError("The screen was made for other directions or wavelengths; make it for these.")
        return np.asarray(near @ weight.astype(np.float32))


@dataclass(frozen=True)
class Lighting:
    """Which light falls on the surface."""

    theta_in: float
    """Signed angle of incidence, degrees: the lens is in the mirror direction where it equals `theta_out`."""
    wavelengths: FloatArray
    """[wavelengths] nm."""
    source: Aperture
    """Points of the source as seen from the surface, offsets in degrees."""

    def wave_vectors(self, lens: Lens) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(kx, ky, kz) [points of the source, wavelengths] towards the axis of `lens`, 1/um."""
        theta = np.radians(self.theta_in + self.source.along)[:, None]
        tilt = np.radians(self.source.sideways)[:, None]
        k = 2 * pi / (1e-3 * self.wavelengths)
        out = radians(lens.theta_out)
        kx = (sin(out) - np.sin(theta) * np.cos(tilt)) * k
        ky = np.broadcast_to(-np.sin(tilt) * k, kx.shape)
        return kx, ky, (cos(out) + np.cos(theta) * np.cos(tilt)) * k


def phase_screen(field: HeightField, lens: Lens, lights: Sequence[Lighting]) -> PhaseScreen:
    """Of `field`, for all that `lens` sees of it in each of `lights`.

    A field that is not periodic is treated as if it were, which spoils its image within one speckle of its edges.
    Whether `field` is fine enough is for `simulators.waves.sampling.sampling` to say.
    Raises `UnfitTopography` where heights are missing, or where the patch is not much larger than one speckle, and
    `InputError` for directions below the surface.
    """
    lamp = max(abs(light.theta_in) + float(np.abs(light.source.along).max()) for light in lights)
    horizon = max(abs(lens.theta_out), lamp)
    if horizon >= 90:
        raise InputError(f"Lamp and camera stand above the surface, but {horizon:g} degrees was given; stay below 90.")
    heights = complete(field) - 0.5 * (np.max(field.heights_um) + np.min(field.heights_um))
    ny, nx = heights.shape
    step_across, step_along = 2 * pi / (ny * field.pitch_um), 2 * pi / (nx * field.pitch_um)
    longest = np.array([max(light.wavelengths.max() for light in lights)])
    fewest = min(float(r[0]) / s for r, s in zip(pupil(lens, longest), (step_along, step_across), strict=True))
    if fewest < _FEWEST:
        raise UnfitTopography(
            f"The topography is {nx * field.pitch_um:.3g} x {ny * field.pitch_um:.3g} um large and would show hardly "
            f"more than one speckle of this lens; make it at least {_FEWEST / fewest:.2g} times as large."
        )
    along, across, kz_step = [], [], pi / range_of(heights)
    up = []
    for light in lights:
        kx, ky, kz = light.wave_vectors(lens)
        radius_along, radius_across = pupil(lens, light.wavelengths)
        along += [float((kx - radius_along).min()), float((kx + radius_along).max())]
        across.append(float((np.abs(ky) + radius_across).max()))
        up += [float(kz.min()), float(kz.max())]
    first_along, last_along = floor(min(along) / step_along) - 1, ceil(max(along) / step_along) + 1
    reach = min(ceil(max(across) / step_across) + 1, ny // 2 - 1)
    kz_first, count = grid_for(min(up), max(up), kz_step)
    wanted = np.arange(first_along, last_along + 1) % nx
    harmonics = np.empty((wanted.size, 2 * reach + 1, count), dtype=np.complex64)
    rows = max(1, _AT_ONCE // (nx * count))
    for low in range(-reach, reach + 1, rows):
        high = min(low + rows - 1, reach)
        columns = transformed_columns(heights, np.ones(ny), (low, high), (kz_first, count), kz_step)
        for index in range(high - low + 1):
            harmonics[:, low + index + reach] = fft.ifft(columns[:, index, :], axis=0)[wanted]
    return PhaseScreen(harmonics, first_along, -reach, step_along, step_across, kz_step, kz_first)


def pupil(lens: Lens, wavelengths: FloatArray) -> tuple[FloatArray, FloatArray]:
    """[wavelengths] semi-axes of the pupil of `lens` along and across the plane of incidence, 1/um."""
    across = 2 * pi / (1e-3 * wavelengths) * lens.numerical_aperture
    return across * cos(radians(lens.theta_out)), across


def image_points(screen: PhaseScreen, lens: Lens, wavelengths: FloatArray) -> tuple[int, int]:
    """(across, along) points of images that hold all of |E|^2: four to the radius of the largest pupil."""
    along, across = pupil(lens, wavelengths)
    needed = [4 * (ceil(r.max() / s) + 2) for r, s in ((across, screen.step_across), (along, screen.step_along))]
    return fft.next_fast_len(needed[0]), fft.next_fast_len(needed[1])


def squared_field(
    screen: PhaseScreen, lens: Lens, lighting: Lighting, wavelength: int, points: tuple[int, int]
) -> FloatArray:
    """[y, x] |E|^2 in um^2, averaged over the points of the source, at lighting's `wavelength` (its number).

    `points` is the number across and along, see `image_points`; they lie evenly on the whole patch, its first point
    among them.
    """
    radius_along, radius_across = (float(r[0]) for r in pupil(lens, lighting.wavelengths[wavelength : wavelength + 1]))
    kx, ky, kz = (k[:, wavelength] for k in lighting.wave_vectors(lens))
    total = np.zeros(points)
    for source, weight in enumerate(lighting.source.weights):
        along = _harmonics_within(float(kx[source]), radius_along, screen.step_along)
        across = _harmonics_within(float(ky[source]), radius_across, screen.step_across)
        waves = screen.block((along[0], along[-1]), (across[0], across[-1]), float(kz[source]))
        passed = _passed(
            (along * screen.step_along - kx[source]) / radius_along,
            (across * screen.step_across - ky[source]) / radius_across,
            screen.step_along / radius_along,
            screen.step_across / radius_across,
        )
        field = fft.fft2((waves * passed).T, points)
        total += weight * (field.real**2 + field.imag**2)
    return np.asarray(total * (2 * pi) ** 2 / (pi * radius_along * radius_across))


def _harmonics_within(centre: float, radius: float, step: float) -> NDArray[np.int64]:
    """Numbers of the harmonics within a pupil and half a step around it."""
    return np.arange(ceil((centre - radius) / step - 0.5), floor((centre + radius) / step + 0.5) + 1)


def _passed(along: FloatArray, across: FloatArray, step_along: float, step_across: float) -> NDArray[np.float32]:
    """[along, across] amplitude that a pupil of radius one lets pass, by the part of each harmonic's cell inside it.

    `along` and `across` are the places of harmonics from its centre, the steps their spacing.
    """
    distance = np.maximum(np.hypot(along[:, None], across), 1e-9)
    width = np.hypot(along[:, None] * step_along, across * step_across) / distance  # of a cell, towards the centre
    inside = np.clip(0.5 + (1 - distance) / np.maximum(width, 1e-9), 0, 1)
    return np.asarray(np.sqrt(inside), dtype=np.float32)
