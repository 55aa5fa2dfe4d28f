"""The white furnace: how much of the light that falls on a model, or on its file, comes out again.

The albedo A(theta_i) is the integral of f cos(theta_o) over the hemisphere. A Cook-Torrance lobe keeps it below one,
its shift (Eq. 7) does not have to, and neither does diffuse light beside a lobe (Eq. 8). A renderer needs it: light
that grows with every reflection never ends. Where A exceeds one the model is multiplied by

    min(c(theta_i), c(theta_o)),    c(theta) = min(1, 1 / A(theta)),    at each wavelength.

The factor c(theta_i) alone would be the least that does, but then light would no longer go the same way back
(Helmholtz reciprocity). The smaller of both is reciprocal and leaves every pair alone of which neither direction
reflects too much.
"""

from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from analysis.bsdf.fields import unit
from analysis.bsdf.measured_bsdf import MeasuredBsdf, evaluate, sampling_density
from analysis.reflectance.directions import Directions, from_vectors
from analysis.scenes.vertices import Reflectance
from drivers.arrays import FloatArray

HIGHEST_ALBEDO = 1 + 1e-3
"""Of a file, at any angle and wavelength of its tables."""

_UP = np.array([0.0, 0.0, 1.0])
_ANGLES = np.array([0.0, 10, 20, 30, 40, 50, 60, 65, 70, 75, 80, 83, 85, 87, 88, 89, 89.5])
"""Degrees at which c is known."""

STEEPEST = 89.5
"""Degrees up to which the light of a file is summed."""


_SAMPLED_ANGLES = np.array([5.0, 35.0, 65.0])
_RINGS, _SPOKES = 40, 16


class _Hemisphere(NamedTuple):
    """Directions into which light goes, as a sum."""

    incident: FloatArray
    """[nodes, 3]"""
    reflected: FloatArray
    """[nodes, 3]"""
    solid_angle: FloatArray
    """[nodes] sr."""


@dataclass(frozen=True)
class Clamped:
    """A reflectance that reflects no more than all."""

    reflectance: Reflectance
    angles: FloatArray
    """[angles] degrees."""
    wavelengths: FloatArray
    """[wavelengths] nm."""
    factor: FloatArray
    """[angles, wavelengths] c; linear between, constant beyond."""

    def __call__(self, directions: Directions, wavelengths: FloatArray) -> FloatArray:
        """BRDF [directions, wavelengths], 1/sr."""
        at = np.stack([np.interp(wavelengths, self.wavelengths, row) for row in self.factor])
        both = (self._along(at, cosine) for cosine in (directions.cos_i, directions.cos_o))
        return np.asarray(self.reflectance(directions, wavelengths) * np.minimum(*both))

    def _along(self, at: FloatArray, cosine: FloatArray) -> FloatArray:
        theta = np.degrees(np.arccos(np.clip(cosine, 0, 1)))
        place = np.interp(theta, self.angles, np.arange(self.angles.size))
        below = np.minimum(place.astype(int), self.angles.size - 2)
        part = (place - below)[:, None]
        return np.asarray(at[below] * (1 - part) + at[below + 1] * part)


def albedo(reflectance: Reflectance, alpha: float, angles: FloatArray, wavelengths: FloatArray) -> FloatArray:
    """[angles, wavelengths] A of a model whose lobe has about the roughness `alpha`; `angles` in degrees.

    >>> def white(directions, wavelengths):
    ...     return np.full((directions.cos_i.size, wavelengths.size), 1 / np.pi)
    >>> albedo(white, 0.1, np.array([0.0, 70.0]), np.array([550.0])).round(3).tolist()
    [[1.0], [1.0]]
    """
    found = np.empty((angles.size, wavelengths.size))
    for i, angle in enumerate(angles):
        sky = _hemisphere(float(angle), alpha)
        value = reflectance(from_vectors(sky.incident, sky.reflected, _UP), wavelengths)
        found[i] = (sky.reflected[:, 2] * sky.solid_angle) @ value
    return found


def file_albedo(bsdf: MeasuredBsdf, alpha: float) -> tuple[FloatArray, FloatArray]:
    """Angles [angles], degrees, those of the tables among them, and A of a file there [angles, wavelengths]."""
    nodes = np.degrees(bsdf.theta_i)
    angles = np.union1d(nodes[nodes <= STEEPEST], np.append(np.linspace(0, 84, 29), np.linspace(84.5, STEEPEST, 11)))
    found = np.empty((angles.size, bsdf.wavelengths.size))
    for i, angle in enumerate(angles):
        sky = _hemisphere(float(angle), alpha)
        found[i] = sky.solid_angle @ evaluate(bsdf, sky.incident, sky.reflected, bsdf.wavelengths)
    return angles, found


def darkening(bsdf: MeasuredBsdf, alpha: float) -> FloatArray:
    """[theta_i of the file, wavelengths] by what its tables have to be multiplied so that nowhere A exceeds one.

    Tables may lie above the model between their nodes, and with them A. Between two theta_i it is a mean of what both
    reflect, so it is enough that both are darkened by the largest A from one to the other.
    """
    angles, light = file_albedo(bsdf, alpha)
    nodes = np.degrees(bsdf.theta_i)
    between = [light[(angles >= low) & (angles <= high)].max(axis=0, initial=0) for low, high in pairwise(nodes)]
    around = np.pad(between, ((1, 1), (0, 0)))
    return np.asarray(1 / np.maximum(1, np.maximum(around[1:], around[:-1])))


def sampling_noise(bsdf: MeasuredBsdf, alpha: float) -> float:
    """Relative standard deviation of the weight of one sample of the reflected light, the largest of three angles.

    It is zero for ideal sampling; n samples leave the noise / sqrt(n).
    """
    noise = []
    for angle in _SAMPLED_ANGLES:
        sky = _hemisphere(float(angle), alpha)
        value = evaluate(bsdf, sky.incident, sky.reflected, bsdf.wavelengths).mean(axis=1)
        density = np.maximum(sampling_density(bsdf, sky.incident, sky.reflected), 1e-12)
        square = sky.solid_angle @ (value**2 / density) / (sky.solid_angle @ value) ** 2
        noise.append(float(np.sqrt(max(square - 1, 0.0))))
    return max(noise)


def clamp(reflectance: Reflectance, alpha: float, wavelengths: FloatArray) -> Clamped | None:
    """`reflectance` with an albedo of at most one at `wavelengths`, nm; None where it has that by itself."""
    found = albedo(reflectance, alpha, _ANGLES, wavelengths)
    if found.max() <= 1:
        return None
    return Clamped(reflectance, _ANGLES, wavelengths, np.minimum(1.0, 1 / np.maximum(found, 1e-9)))


def _hemisphere(theta_i: float, alpha: float) -> _Hemisphere:
    """Nodes even in azimuth and in asinh(theta_m / alpha) of the half vector, by Gauss and Legendre's rule.

    Where the reflected direction meets the horizon, at tan(2 theta_m) = -cot(theta_i) / cos(phi_m), the rule ends.
    """
    sin_i, cos_i = np.sin(np.radians(theta_i)), np.cos(np.radians(theta_i))
    nodes, weights = _rule()
    phi = np.pi * (np.arange(_SPOKES) + 0.5) / _SPOKES  # one half of a symmetrical whole
    width = max(np.arctan(alpha), 1e-4)
    reach = np.arcsinh(0.5 * np.arctan2(cos_i, -sin_i * np.cos(phi)) / width)
    place = (nodes[:, None] + 1) / 2 * reach
    theta = width * np.sinh(place)
    step = weights[:, None] / 2 * reach * width * np.cosh(place) * np.sin(theta) * (2 * np.pi / _SPOKES)
    normal = unit(theta, phi).reshape(-1, 3)
    incident = np.array([sin_i, 0.0, cos_i])
    cos_d = normal @ incident
    reflected = 2 * cos_d[:, None] * normal - incident
    return _Hemisphere(np.broadcast_to(incident, reflected.shape), reflected, step.ravel() * 4 * cos_d)


@cache
def _rule() -> tuple[FloatArray, FloatArray]:
    nodes, weights = np.polynomial.legendre.leggauss(_RINGS)
    return nodes, weights
