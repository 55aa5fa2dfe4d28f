"""In-plane spectral BRDF of a height map by scalar wave optics (paper, section 5.1).

One diffraction integral I serves three kernels; each is one in the mirror direction, and each is multiplied by the
Fresnel reflectance at the half vector. There is neither shadowing nor multiple reflection.
"""

import warnings
from dataclasses import dataclass

import numpy as np

from analysis.reflectance.directions import in_plane
from analysis.reflectance.fresnel import Conductor, fresnel_conductor
from drivers.arrays import FloatArray
from goniometer.errors import InputError
from simulators.choices import Kernel
from simulators.topographies.heights import HeightField
from simulators.waves.diffraction import Coherence, diffraction_integral, window
from simulators.waves.power_spectrum import PowerSpectrum, power_spectrum
from simulators.waves.sampling import CoarseSampling, Sampling, sampling


@dataclass(frozen=True)
class WaveBrdf:
    """An in-plane spectral BRDF as wave optics predicts it; points first, wavelengths last."""

    theta_in: FloatArray
    """[points] incident angle, degrees."""
    theta_out: FloatArray
    """[points] reflected angle, degrees, signed; the mirror direction is at `theta_in`."""
    wavelengths: FloatArray
    """[wavelengths] nanometres."""
    brdf: FloatArray
    """[points, wavelengths] 1/sr."""
    sampling: Sampling
    """Whether the topography was fine enough for these directions and wavelengths."""


@dataclass(frozen=True)
class Averaged:
    """What is left of a height map once its places are averaged over; `averaged_brdf` reads spectra from it."""

    spectrum: PowerSpectrum
    coherence: Coherence
    sampling: Sampling


def scattering_vectors(
    theta_in: FloatArray, theta_out: FloatArray, wavelengths: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(kx, kz) [points, wavelengths] in 1/um of directions [points] in degrees at `wavelengths` in nm.

    kx = (2 pi / wavelength) (sin theta_out - sin theta_in), kz = (2 pi / wavelength) (cos theta_in + cos theta_out).
    Raises `InputError` for directions at or below the horizon.
    """
    horizon = max(float(np.abs(theta_in).max()), float(np.abs(theta_out).max()))
    if horizon >= 90:
        raise InputError(
            f"Directions of a BRDF lie above the surface, but {horizon:g} degrees was given; stay below 90."
        )
    k = 2 * np.pi / (1e-3 * wavelengths)
    incident, reflected = np.radians(theta_in), np.radians(theta_out)
    along, up = np.sin(reflected) - np.sin(incident), np.cos(incident) + np.cos(reflected)
    return along[:, None] * k, up[:, None] * k


def obliquity(kernel: Kernel, theta_in: FloatArray, theta_out: FloatArray) -> FloatArray:
    """[points] the factor of `kernel` for directions in degrees, a pure number."""
    cos_i, cos_o = np.cos(np.radians(theta_in)), np.cos(np.radians(theta_out))
    if kernel is Kernel.HARVEY_SHACK:
        return np.asarray(cos_o / cos_i)
    up = cos_i + cos_o
    if kernel is Kernel.RECIPROCAL:
        return np.asarray(up**2 / (4 * cos_i * cos_o))
    along = np.sin(np.radians(theta_out)) - np.sin(np.radians(theta_in))
    return np.asarray(((along**2 + up**2) / up) ** 2 / (4 * cos_i * cos_o))


def patch_brdf(
    field: HeightField,
    theta_in: FloatArray,
    theta_out: FloatArray,
    wavelengths: FloatArray,
    coherence: Coherence,
    kernel: Kernel = Kernel.HARVEY_SHACK,
    conductor: Conductor | None = None,
    centre_um: tuple[float, float] | None = None,
) -> WaveBrdf:
    """What one coherence window at `centre_um` (x, y) sees of `field`, speckle included; by default in its middle.

    Directions [points] in degrees, wavelengths in nm, ascending; without a `conductor` the mirror is perfect. Warns of
    `CoarseSampling`. Raises `UnfitTopography` where heights are missing, `InputError` as `scattering_vectors` and
    `OutOfRange` beyond the conductor's table.
    """
    kx, kz = scattering_vectors(theta_in, theta_out, wavelengths)
    sizes = coherence.size(wavelengths)
    fineness = _sampling(field, kx, kz, float(sizes.min()))
    square = np.empty_like(kx)
    for size in np.unique(sizes):
        same = sizes == size
        integral = diffraction_integral(field, window(field, float(size), centre_um), kx[:, same], kz[:, same])
        square[:, same] = np.abs(integral) ** 2
    brdf = square * _factors(theta_in, theta_out, wavelengths, kernel, conductor)
    return WaveBrdf(theta_in, theta_out, wavelengths, brdf, fineness)


def averaged(
    field: HeightField, theta_in: FloatArray, theta_out: FloatArray, wavelengths: FloatArray, coherence: Coherence
) -> Averaged:
    """Averages `field` over all places of the window, for directions and wavelengths up to those given.

    Directions [points] in degrees, wavelengths in nm; warns of `CoarseSampling`. Raises `UnfitTopography` where heights
    are missing, or where the window is too large for a field that is not periodic, and `InputError` as
    `scattering_vectors`.
    """
    kx, kz = scattering_vectors(theta_in, theta_out, wavelengths)
    smallest = float(coherence.size(wavelengths).min())
    fineness = _sampling(field, kx, kz, smallest)
    return Averaged(power_spectrum(field, smallest, float(kz.min()), float(kz.max())), coherence, fineness)


def averaged_brdf(
    surface: Averaged,
    theta_in: FloatArray,
    theta_out: FloatArray,
    wavelengths: FloatArray,
    kernel: Kernel = Kernel.HARVEY_SHACK,
    conductor: Conductor | None = None,
) -> WaveBrdf:
    """The mean over all places, free of speckle but for what a finite map has.

    Directions [points] in degrees, wavelengths in nm, ascending; without a `conductor` the mirror is perfect. Raises
    `InputError` beyond the directions and wavelengths of `surface` and `OutOfRange` beyond the conductor's table.
    """
    kx, kz = scattering_vectors(theta_in, theta_out, wavelengths)
    sizes = surface.coherence.size(wavelengths)
    square = np.stack(
        [surface.spectrum.mean_square(kx[:, i], kz[:, i], float(size)) for i, size in enumerate(sizes)], axis=1
    )
    brdf = square * _factors(theta_in, theta_out, wavelengths, kernel, conductor)
    return WaveBrdf(theta_in, theta_out, wavelengths, brdf, surface.sampling)


def _factors(
    theta_in: FloatArray, theta_out: FloatArray, wavelengths: FloatArray, kernel: Kernel, conductor: Conductor | None
) -> FloatArray:
    """[points, wavelengths] BRDF over |I|^2, 1/(sr um^2)."""
    factors = obliquity(kernel, theta_in, theta_out)[:, None] / (1e-3 * wavelengths) ** 2
    if conductor is None:
        return np.asarray(factors)
    n, k = conductor.index(wavelengths)
    return np.asarray(factors * fresnel_conductor(in_plane(theta_in, theta_out).cos_d[:, None], n, k))


def _sampling(field: HeightField, kx: FloatArray, kz: FloatArray, s_um: float) -> Sampling:
    """Of `field`, with a warning if it is too coarse."""
    fineness = sampling(field, kx, kz, s_um)
    if not fineness.sufficient:
        warnings.warn(fineness.message, CoarseSampling, stacklevel=3)
    return fineness
