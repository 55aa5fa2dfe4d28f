"""The cosines that a reflectance model needs, for in-plane directions and through a finite aperture."""

from typing import NamedTuple

import numpy as np

from drivers.arrays import FloatArray


class Directions(NamedTuple):
    """Cosines of a set of pairs of directions, all of one shape."""

    cos_i: FloatArray
    """Incident direction to surface normal."""
    cos_o: FloatArray
    """Reflected direction to surface normal."""
    cos_m: FloatArray
    """Half vector to surface normal; theta_m is its angle."""
    cos_d: FloatArray
    """Incident direction to half vector."""


def _from_vectors(incident: FloatArray, reflected: FloatArray) -> Directions:
    """Cosines of unit vectors [..., 3] with the surface normal along z."""
    half = incident + reflected
    half = half / np.linalg.norm(half, axis=-1, keepdims=True)
    return Directions(incident[..., 2], reflected[..., 2], half[..., 2], np.sum(incident * half, axis=-1))


def from_vectors(incident: FloatArray, reflected: FloatArray, normal: FloatArray) -> Directions:
    """Cosines of unit vectors [..., 3] away from a surface with the unit `normal` [..., 3]."""
    half = incident + reflected
    half = half / np.linalg.norm(half, axis=-1, keepdims=True)
    pairs = ((incident, normal), (reflected, normal), (half, normal), (incident, half))
    return Directions(*(np.sum(a * b, axis=-1) for a, b in pairs))


def _unit(theta: FloatArray, sideways: FloatArray | float = 0.0) -> FloatArray:
    """Unit vectors at the signed in-plane angle `theta`, tilted `sideways` out of the plane; both radians."""
    theta, tilt = np.broadcast_arrays(theta, np.asarray(sideways, dtype=float))
    return np.stack([np.sin(theta) * np.cos(tilt), np.sin(tilt), np.cos(theta) * np.cos(tilt)], axis=-1)


def in_plane(theta_in: FloatArray, theta_out: FloatArray) -> Directions:
    """Cosines of in-plane directions; `theta_in`, `theta_out` in degrees, any one shape.

    In plane theta_m = |theta_out - theta_in| / 2 with the signed angles of `goniometer.geometry`.
    """
    return _from_vectors(_unit(-np.radians(theta_in)), _unit(np.radians(theta_out)))


class Aperture(NamedTuple):
    """A quadrature rule over a round detector aperture; weights sum to one."""

    along: FloatArray
    """[nodes] offset within the plane, degrees."""
    sideways: FloatArray
    """[nodes] offset out of the plane, degrees."""
    weights: FloatArray
    """[nodes]"""


def round_aperture(full_angle: float, rings: int = 4, spokes: int = 12) -> Aperture:
    """Product rule over a disc of `full_angle` degrees: Gauss-Legendre in squared radius, even in azimuth.

    Exact for polynomials of degree 2 `rings` - 1 in r^2 (Abramowitz & Stegun, 25.4.61).
    """
    nodes, weights = np.polynomial.legendre.leggauss(rings)
    radius = 0.5 * full_angle * np.sqrt(0.5 * (nodes + 1))
    azimuth = 2 * np.pi * (np.arange(spokes) + 0.5) / spokes
    return Aperture(
        np.outer(radius, np.cos(azimuth)).ravel(),
        np.outer(radius, np.sin(azimuth)).ravel(),
        np.repeat(0.5 * weights / spokes, spokes),
    )


def through_aperture(theta_in: FloatArray, theta_out: FloatArray, aperture: Aperture) -> Directions:
    """Cosines [points, nodes] for every node of the aperture around directions [points], degrees.

    Nodes that fall below the horizon have `cos_o <= 0`; models return zero there.
    """
    incident = _unit(-np.radians(theta_in))[:, None, :]
    reflected = _unit(np.radians(theta_out)[:, None] + np.radians(aperture.along), np.radians(aperture.sideways))
    return _from_vectors(np.broadcast_to(incident, reflected.shape), reflected)
