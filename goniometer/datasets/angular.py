"""How a measured BRDF changes with its angles, estimated from the measurement itself.

Errors of the angles become errors of the BRDF through its slope over theta_out, and the aperture averages over its
curvature. Both come from ln f along theta_out within one incident angle, where lobes are smooth, by differences over
three neighbours (Lagrange's parabola), smoothed over wavelength, over which ln f changes little in shape.
"""

from typing import NamedTuple

import numpy as np
import scipy

from drivers.arrays import FloatArray
from goniometer.uncertainty import Groups

SAME_INCIDENCE = 0.05
"""Incident angles closer than this belong to one position of the sample stage, degrees."""

SAME_PLANNED_INCIDENCE = 0.1
"""Read-back incident angles closer than this were planned as one, degrees, even where the stage came back to it: wider
than `SAME_INCIDENCE`, within which it has not moved at all."""

SMOOTHED_WAVELENGTHS = 21
"""Wavelengths over which the derivatives of ln f are averaged."""


class Derivatives(NamedTuple):
    """Of the BRDF over theta_out, [points, wavelengths]."""

    first: FloatArray
    """1/sr per degree."""
    second: FloatArray
    """1/sr per square degree."""


def incidence_groups(theta_in: FloatArray, apart: float) -> Groups:
    """[points] number, from 0, of the incident angle; angles (degrees) within `apart` of the next are one."""
    order = np.argsort(theta_in, kind="stable")
    groups = np.empty(theta_in.size, dtype=np.intp)
    groups[order] = np.concatenate([[0], np.cumsum(np.diff(theta_in[order]) > apart)])
    return groups


def along_theta_out(theta_out: FloatArray, groups: Groups, brdf: FloatArray, floor: FloatArray) -> Derivatives:
    """Derivatives over theta_out (degrees) at the points of each group, from their neighbours in it.

    A direction that was measured more than once counts as one, with the mean of ln f. Values below `floor` [points,
    wavelengths], the noise, count as `floor`, for they have no logarithm. Between its neighbours a NaN is interpolated.
    In a group of two points the curvature is zero; of a single one nothing is known, and both are zero.
    """
    tiny = np.finfo(float).tiny
    log = np.log(np.maximum(np.maximum(brdf, floor), tiny))  # NaN stays NaN
    first, second = np.zeros_like(log), np.zeros_like(log)
    for group in range(int(groups.max()) + 1):
        members = np.flatnonzero(groups == group)
        members = members[np.argsort(theta_out[members])]
        angles, which = np.unique(theta_out[members], return_inverse=True)
        if angles.size < 2:
            continue
        log[members] = _filled(theta_out[members], log[members])
        again = (np.arange(angles.size)[:, None] == which).astype(float)
        x, y = angles[:, None], again @ log[members] / again.sum(axis=1, keepdims=True)
        slope = np.diff(y, axis=0) / np.diff(x, axis=0)
        if angles.size == 2:
            first[members] = slope
            continue
        bend = np.diff(slope, axis=0) / (x[2:] - x[:-2])  # half the second derivative
        inner = slope[:-1] + bend * (x[1:-1] - x[:-2])
        ends = slope[:1] - bend[:1] * (x[1:2] - x[:1]), slope[-1:] + bend[-1:] * (x[-1:] - x[-2:-1])
        first[members] = np.concatenate([ends[0], inner, ends[1]])[which]
        second[members] = 2 * np.concatenate([bend[:1], bend, bend[-1:]])[which]
    size = min(SMOOTHED_WAVELENGTHS, log.shape[1])
    first, second = (scipy.ndimage.uniform_filter1d(d, size, axis=1, mode="nearest") for d in (first, second))
    value = np.exp(log)
    return Derivatives(value * first, value * (second + first**2))


def _filled(x: FloatArray, y: FloatArray) -> FloatArray:
    """`y` [points, wavelengths] with every NaN interpolated over ascending `x`; a wavelength without values is flat."""
    y = y.copy()
    for column in np.flatnonzero(np.isnan(y).any(axis=0)):
        known = np.isfinite(y[:, column])
        y[:, column] = np.interp(x, x[known], y[known, column]) if known.any() else 0.0
    return y


def aperture_excess(theta_in: FloatArray, theta_out: FloatArray, slopes: Derivatives, aperture: float) -> FloatArray:
    """[points, wavelengths] how much the average over the round aperture exceeds the BRDF at its centre, 1/sr.

    To second order (a / 2)^2 / 8 times the Laplacian of f over the aperture, a its full angle. In plane that is the
    measured second derivative. Sideways an isotropic surface is assumed, on which f depends on the angle theta_h of the
    half vector h alone over so small a region, f = g(theta_h). A step s sideways turns h by s / (2 cos theta_d) out of
    the plane, and within it by -(s^2 / 4) tan theta_d, so that with g' = 2 f_x
    f_yy = f_x / (2 tan theta_h cos^2 theta_d) - f_x tan theta_d, of which the first term tends to f_xx / cos^2 theta_d
    in the mirror direction. All angles in degrees.
    """
    theta_h = np.radians(0.5 * (theta_out - theta_in))[:, None]
    theta_d = np.radians(0.5 * (theta_out + theta_in))[:, None]
    near = np.abs(theta_h) < np.radians(0.5 * aperture)
    tangent = np.degrees(np.tan(np.where(near, 1.0, theta_h)))
    turned = np.where(near, slopes.second, slopes.first / (2 * tangent)) / np.cos(theta_d) ** 2
    sideways = turned - np.radians(slopes.first * np.tan(theta_d))
    return np.asarray((0.5 * aperture) ** 2 / 8 * (slopes.second + sideways))
